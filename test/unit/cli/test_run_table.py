# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a run prints at its end."""

import pytest

from fej_slam_ros.cli.run_table import format_table, run_table

ROBOT = {'frame': 'map', 'steps': 10, 'received': 20, 'used': 19, 'refused': 1}
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


def test_scores_are_shown_where_there_is_a_truth():
    _, r1, r2, _, landmarks, *_ = lines_of(**SCORES)

    assert r1.split()[3:6] == ['0.123', '0.0068', '1.06']
    assert r2.split()[3:6] == ['-', '-', '-']
    assert landmarks == '12 landmarks in map, RMSE 0.500 m, NEES/2 1.00'


def test_an_exactly_known_pose_has_no_nees():
    _, r1, *_ = lines_of(**SCORES | {'nees': {'r1': None, 'landmarks': 1.0}})

    assert r1.split()[3:6] == ['0.123', '0.0068', '-']


def test_what_was_refused_is_named_and_so_is_who_is_not_in_the_map():
    assert lines_of()[3:] == [
        '', '12 landmarks in map', 'refused: late 2, bad_id 1',
        'r2 is not in map: it sent no odometry', 'the result depended on the order of arrival',
        'state hash ab12']


def test_where_nothing_was_refused_that_is_said():
    counts = {'used': 38, 'late': 0, 'released_without': 3}

    assert 'refused: nothing' in lines_of(counts=counts)


def test_what_was_refused_for_nobody_is_no_row():
    assert len(lines_of(robots={'': ROBOT, 'r1': ROBOT})) == len(lines_of()) - 1


@pytest.mark.parametrize(
    ('rows', 'text'),
    [([['a', 'b']], 'a  b'), ([['name', '1'], ['x', '1000']], 'name     1\nx     1000')])
def test_the_first_column_stands_left_and_the_others_right(rows, text):
    assert format_table(rows) == text
