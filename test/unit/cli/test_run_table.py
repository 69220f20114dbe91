# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table that a run prints at its end."""

import pytest

from fej_slam_ros.cli.run_table import run_table

ROBOT = {
    'frame': 'map', 'steps': 10, 'received': 20, 'used': 19, 'refused': 1, 'sightings_used': 30,
    'refusals': {'late': 1}}
SUMMARY = {
    'robots': {'r1': ROBOT, 'r2': ROBOT | {'frame': 'r2/map', 'steps': 7}},
    'counts': {'used': 38, 'late': 2, 'gated': 0, 'bad_id': 1, 'released_without': 0},
    'not_in_map': {'r2': 'it sent no odometry'}, 'landmarks': 12, 'depends_on_arrival': True,
    'state_hash': 'ab12'}
SCORES = {
    'rmse': {'r1': {'position': 0.12345, 'heading': 0.00678}, 'landmarks': 0.5},
    'nees': {'r1': 1.0625, 'landmarks': 0.996}}


def lines_of(**changes):
    return run_table(SUMMARY | changes).splitlines()


def test_every_robot_is_a_row():
    heading, *rows = (line.split() for line in lines_of()[:3])

    assert heading[:3] == ['robot', 'frame', 'steps']
    assert rows == [
        ['r1', 'map', '10', '-', '-', '-', '20', '19', '1'],
        ['r2', 'r2/map', '7', '-', '-', '-', '20', '19', '1']]


def test_rmse_and_nees_are_shown_with_ground_truth():
    _, r1, r2, _, landmarks, *_ = lines_of(**SCORES)

    assert r1.split()[3:6] == ['0.123', '0.0068', '1.06']
    assert r2.split()[3:6] == ['-', '-', '-']
    assert landmarks == '12 landmarks in map, RMSE 0.500 m, NEES/2 1.00'


@pytest.mark.parametrize(('nees', 'nis', 'is_said'), [
    ({'r1': 300.0, 'r2': 200.0}, 1.0, True), ({'r1': 300.0, 'r2': 1.0}, 1.0, False),
    ({'r1': 300.0, 'r2': None}, 1.0, True), ({'r1': 300.0, 'r2': 200.0}, 5.0, False),
    ({}, 1.0, False)])
def test_ground_truth_in_another_frame_is_said(nees, nis, is_said):
    lines = lines_of(nees=nees, nis={'r1': {'per_dof': nis}, 'r2': {'per_dof': 1.0}})

    assert any('another frame than map' in line for line in lines) == is_said


def test_an_exactly_known_pose_has_no_nees():
    _, r1, *_ = lines_of(**SCORES | {'nees': {'r1': None, 'landmarks': 1.0}})

    assert r1.split()[3:6] == ['0.123', '0.0068', '-']


def test_rejections_and_robots_outside_the_map_are_listed():
    assert lines_of()[3:] == [
        '', '12 landmarks in map', 'rejected messages and single observations: late 2, bad_id 1',
        'r2 is not in map: it sent no odometry', 'the result depends on the order of arrival',
        'state hash ab12']


def test_a_run_without_rejections_says_so():
    counts = {'used': 38, 'late': 0, 'released_without': 3}

    assert 'rejected messages and single observations: none' in lines_of(counts=counts)


@pytest.mark.parametrize(('gated', 'is_named'), [(57, False), (58, True)])
def test_where_more_is_rejected_than_used_doctor_is_named(gated, is_named):
    # 60 observations are used, 3 others rejected.
    lines = lines_of(counts=SUMMARY['counts'] | {'gated': gated})

    assert any('doctor' in line for line in lines) == is_named


def test_a_robot_that_was_never_in_the_team_has_no_row_but_a_reason():
    stranger = {
        'frame': 'r9/map', 'steps': 0, 'received': 5, 'used': 0, 'refused': 5,
        'sightings_used': 0, 'refusals': {'unknown_robot': 5}}
    left = stranger | {'refusals': {'unknown_robot': 3, 'left': 2}}

    lines = lines_of(robots={'r1': ROBOT, 'r8': left, 'r9': stranger})

    assert [line.split()[0] for line in lines[1:3]] == ['r1', 'r8']
    assert 'r9 is not in robots: its 5 messages are rejected' in lines


def test_rejections_without_a_robot_have_no_row():
    assert len(lines_of(robots={'': ROBOT, 'r1': ROBOT})) == len(lines_of()) - 1
