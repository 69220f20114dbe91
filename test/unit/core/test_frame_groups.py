# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frame groups: which robot is in which frame, through begin, restart, merge and leave."""

import numpy as np
import pytest

from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, RenewedFirstEstimates, Standard)
from fej_slam_ros.core.frame_groups import FrameGroups
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import PriorMap
from helpers.records import team


def groups_of(*names, prior=None, **options):
    """Return the frame groups of a team whose robots have sent their first odometry at 5 ns."""
    settings = team(*names, **options)
    groups = FrameGroups(settings, RecordedTruth(), prior)
    groups.robots = {robot.name: robot for robot in settings.robots}
    groups.not_in_map = dict.fromkeys(groups.robots, 'it sent no odometry')
    for robot in settings.robots:
        groups.begin(robot, 5)
    return groups


def frames(groups):
    return {group.frame: list(group.robots) for group in groups}


def landmark(groups, robot, number):
    """Let a robot start a landmark 1 m ahead."""
    state = groups.of(robot).state
    state.augment(
        ('', number), state.robots[robot], np.array([1.0, 0.0]), np.eye(2, 3), np.eye(2))


def test_a_robot_with_a_known_initial_pose_begins_in_map_and_any_other_in_its_own_frame():
    groups = groups_of('r1', 'r2', anchor_pose=(1.0, 2.0, 4.0), anchor_sigma=(0.1, 0.2, 0.3))

    assert frames(groups) == {'map': ['r1'], 'r2/map': ['r2']}
    anchor = groups.team.robots['r1']
    np.testing.assert_allclose(
        groups.team.state.estimate(anchor), [1.0, 2.0, 4.0 - 2.0 * np.pi], rtol=1e-15)
    np.testing.assert_allclose(
        groups.team.state.marginal([anchor]), np.diag([0.01, 0.04, 0.09]), rtol=1e-15)
    assert list(groups.not_in_map) == ['r2']


@pytest.mark.parametrize(('kind', 'of_known', 'of_unknown'), [
    ('fej', FirstEstimates, RenewedFirstEstimates), ('standard', Standard, Standard)])
def test_first_estimates_are_renewed_only_where_the_start_is_unknown(kind, of_known, of_unknown):
    groups = groups_of('r1', 'r2', filter=kind)

    assert type(groups.team.filter.linearization) is of_known
    assert type(groups.of('r2').filter.linearization) is of_unknown


def test_a_robot_that_restarts_leaves_its_map_behind_in_a_frame_of_its_own():
    groups = groups_of('r1', 'r2')
    landmark(groups, 'r2', 7)

    groups.restart('r2', 9, 'lost')

    assert frames(groups) == {'map': ['r1'], 'r2/before/map': [], 'r2/map': ['r2']}
    assert [list(group.state.landmarks) for group in groups] == [[], [('', 7)], []]
    assert groups.of('r2').robots['r2'].stamp == 9
    assert groups.not_in_map == {'r2': 'lost'}


def test_a_robot_that_comes_back_after_step_0_does_not_wait_for_the_anchor():
    groups = groups_of('r1', 'r2')
    assert groups.not_in_map == {'r2': 'the anchor r1 has observed no landmark'}
    groups.is_initialized = True
    groups.leave('r2')

    groups.begin(groups.robots['r2'], 9)

    assert groups.not_in_map == {'r2': 'it has observed no landmark or robot since it began'}


def test_only_the_last_map_that_a_robot_left_is_kept():
    groups = groups_of('r1', 'r2')
    for number in (7, 8, 9):
        landmark(groups, 'r2', number)
        groups.restart('r2', number, 'lost')

    assert [list(group.state.landmarks) for group in groups] == [[], [('', 9)], []]


def test_a_map_that_a_robot_has_joined_again_is_kept_when_it_restarts():
    groups = groups_of('r1', 'r2')
    landmark(groups, 'r2', 7)
    groups.restart('r2', 9, 'lost')
    landmark(groups, 'r2', 8)
    previous, own = groups.others
    previous.filter.state = own.filter.state  # as joining does
    groups.merge(previous, own)

    groups.restart('r2', 10, 'lost')

    assert frames(groups) == {'map': ['r1'], 'r2/before/map': [], 'r2/map': ['r2']}
    assert [list(group.state.landmarks) for group in groups] == [[], [('', 8)], []]


def test_a_frame_without_robots_and_landmarks_vanishes():
    groups = groups_of('r1', 'r2')

    groups.restart('r2', 9, 'lost')
    assert frames(groups) == {'map': ['r1'], 'r2/map': ['r2']}
    groups.leave('r2')
    assert frames(groups) == {'map': ['r1']}
    assert groups.not_in_map == {}


def test_merged_groups_are_one_and_a_group_is_renamed_after_a_robot_that_is_in_it():
    groups = groups_of('r1', 'r2', 'r3')
    of_r2, of_r3 = groups.others
    of_r2.filter.state = of_r3.filter.state  # as joining does
    groups.merge(of_r2, of_r3)

    assert frames(groups) == {'map': ['r1'], 'r3/map': ['r3']}
    assert groups.of('r3') is of_r2


def test_robots_that_join_the_team_are_no_longer_listed_as_missing():
    groups = groups_of('r1', 'r2')

    groups.merge(groups.team, groups.of('r2'))

    assert groups.not_in_map == {}
    assert not groups.others


@pytest.mark.parametrize(('is_initialized', 'frame'), [(False, 'map'), (True, 'r1/map')])
def test_a_lost_anchor_restarts_at_its_initial_pose_only_before_step_0(is_initialized, frame):
    groups = groups_of('r1', 'r2')
    groups.is_initialized = is_initialized

    groups.restart('r1', 9, 'lost')

    assert groups.of('r1').frame == frame
    assert groups.may_leave('r1') is is_initialized
    assert groups.may_leave('r2')


@pytest.mark.parametrize('given', [
    {'prior': PriorMap((1,), np.ones((1, 2)), np.eye(2))}, {'anchor_pose': (1.0, 0.0, 0.0)},
    {'known': [('r2', (4.0, 0.0, 0.0), (0.1, 0.1, 0.1))]}])
def test_a_lost_anchor_does_not_return_to_its_initial_pose_in_a_map_that_is_given(given):
    groups = groups_of('r1', 'r2', **given)

    groups.restart('r1', 9, 'its odometry jumped')

    assert groups.of('r1').frame == 'r1/map'
    assert groups.not_in_map['r1'] == 'its odometry jumped'
    # Nobody waits for its step 0.
    assert groups.is_initialized


@pytest.mark.parametrize(('sigma', 'frame'), [(0.3, 'map'), (0.5, 'r1/map')])
@pytest.mark.parametrize('options_of', [
    lambda sigma: {'anchor_sigma': sigma, 'prior': PriorMap((1,), np.ones((1, 2)), np.eye(2))},
    lambda sigma: {'anchor': '', 'known': [('r1', (4.0, 0.0, 0.0), sigma)]}])
def test_a_start_that_is_too_uncertain_to_linearise_counts_as_unknown(sigma, frame, options_of):
    # The limit is that of motions and of poses on set_pose, 0.3 rad.
    groups = groups_of('r1', 'r2', **options_of((0.1, 0.1, sigma)))

    assert groups.of('r1').frame == frame
    assert ('too uncertain' in groups.not_in_map.get('r1', '')) is (sigma > 0.3)


def test_an_anchor_that_alone_defines_map_does_so_however_uncertain_its_pose():
    groups = groups_of('r1', 'r2', anchor_pose=(5.0, 5.0, 1.0), anchor_sigma=(9.0, 9.0, 3.0))

    assert groups.of('r1').frame == 'map'


def test_a_map_lists_landmarks_by_id_with_positions_and_covariances():
    groups = groups_of('r1')
    for number in (9, 4):
        landmark(groups, 'r1', number)

    of_team = groups.team.map()

    assert (of_team.frame, of_team.robots, of_team.tentative) == ('map', ('r1',), 0)
    assert [(f.id, f.robot, f.position.tolist(), f.P.tolist()) for f in of_team] == [
        (number, '', [1.0, 0.0], np.eye(2).tolist()) for number in (4, 9)]
    assert of_team.has_shared_ids()
    assert groups.team.state.covariance.dimension == 7


def test_the_map_of_a_run_is_the_prior_map_of_another_one():
    prior = PriorMap((3, 8), np.array([[1.0, 2.0], [3.0, 4.0]]), np.diag([1.0, 2.0, 3.0, 4.0]))

    again = groups_of('r1', prior=prior).team.prior_map()

    assert again.ids == (3, 8)
    np.testing.assert_array_equal(again.points, prior.points)
    np.testing.assert_array_equal(again.P, prior.P)


def test_a_robot_may_begin_at_a_motion_from_its_initial_pose():
    groups = groups_of('r1')
    groups.leave('r1')
    fresh = FrameGroups(
        team('r1', anchor_pose=(1.0, 2.0, np.pi / 2), anchor_sigma=(0.1, 0.2, 0.0)),
        RecordedTruth())
    fresh.robots = groups.robots
    fresh.start_after('r1', np.array([3.0, 0.0, 0.5]), np.diag([0.04, 0.01, 0.09]))

    fresh.begin(groups.robots['r1'], 5)

    # Ahead is +y of map: the noise along the motion adds to y, that across to x.
    robot = fresh.team.robots['r1']
    np.testing.assert_allclose(
        fresh.team.state.estimate(robot), [1.0, 5.0, np.pi / 2 + 0.5], atol=1e-15)
    np.testing.assert_allclose(
        fresh.team.state.marginal([robot]), np.diag([0.02, 0.08, 0.09]), atol=1e-15)
    assert robot.stamp == 5


def test_a_robot_whose_start_is_void_begins_in_its_own_frame_with_the_reason():
    settings = team('r1', 'r2', known=[('r2', (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
    groups = FrameGroups(settings, RecordedTruth())
    groups.robots = {robot.name: robot for robot in settings.robots}

    groups.void_start('r1', 'it had moved')
    for robot in settings.robots:
        groups.begin(robot, 5)

    assert frames(groups) == {'map': ['r2'], 'r1/map': ['r1']}
    assert groups.not_in_map == {'r1': 'it had moved'}
    # Nobody waits for step 0 of an anchor that is not in map.
    assert groups.is_initialized


@pytest.mark.parametrize('end', ['void', 'left'])
def test_a_start_that_no_longer_counts_does_not_keep_the_anchor_from_defining_map_anew(end):
    settings = team('r1', 'r2', known=[('r2', (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))])
    groups = FrameGroups(settings, RecordedTruth())
    groups.robots = {robot.name: robot for robot in settings.robots}
    groups.begin(settings.robots[0], 5)

    if end == 'void':
        groups.void_start('r2', 'it had moved')
    else:
        del groups.robots['r2']
    groups.restart('r1', 9, 'its odometry began again')

    assert frames(groups) == {'map': ['r1']}


def test_a_robot_that_is_placed_in_map_no_longer_has_a_reason_not_to_be_there():
    groups = groups_of('r1', 'r2')

    groups.place('r2', 7, np.array([1.0, 2.0, 0.5]), 0.01 * np.eye(3))

    assert frames(groups) == {'map': ['r1', 'r2']}
    assert groups.not_in_map == {}


def test_a_robot_that_had_joined_its_previous_map_again_may_leave_it_to_others():
    groups = groups_of('r1', 'r2', 'r3')
    landmark(groups, 'r2', 7)
    groups.restart('r2', 9, 'lost')
    previous = next(group for group in groups.others if group.is_previous)
    for robot in ('r2', 'r3'):
        own = groups.of(robot)
        own.state.remove(own.robots[robot])
        previous.state.insert_robot(robot, 9, np.zeros(3), np.eye(3))
        groups.merge(previous, own)

    groups.leave('r2')

    assert frames(groups) == {'map': ['r1'], 'r3/map': ['r3']}


def test_an_anchor_that_comes_after_a_robot_was_placed_in_map_begins_at_its_pose():
    settings = team('r1', 'r2', anchor_pose=(1.0, 2.0, 0.5))
    groups = FrameGroups(settings, RecordedTruth())
    groups.robots = {robot.name: robot for robot in settings.robots}
    groups.not_in_map = dict.fromkeys(groups.robots, 'it sent no odometry')
    groups.begin(groups.robots['r2'], 5)
    own = groups.of('r2')
    own.state.remove(own.robots['r2'])
    groups.team.state.insert_robot('r2', 5, np.zeros(3), np.eye(3))
    groups.mark_joined(['r2'])
    groups.leave('r2')

    groups.begin(groups.robots['r1'], 9)

    assert groups.team.state.estimate(groups.team.robots['r1']).tolist() == [1.0, 2.0, 0.5]
    assert not groups.is_initialized


def test_a_robot_that_left_before_its_first_odometry_still_has_its_start_pose():
    settings = team('r1', 'r2', known=[('r2', (1.0, 2.0, 0.5), (0.1, 0.1, 0.1))])
    groups = FrameGroups(settings, RecordedTruth())
    groups.robots = {robot.name: robot for robot in settings.robots}
    groups.leave('r2')

    groups.begin(groups.robots['r2'], 9)

    assert groups.team.state.estimate(groups.team.robots['r2']).tolist() == [1.0, 2.0, 0.5]


def test_a_motion_before_the_first_odometry_is_used_once():
    groups = FrameGroups(team('r1'), RecordedTruth())
    groups.robots = {robot.name: robot for robot in team('r1').robots}
    groups.start_after('r1', np.array([3.0, 0.0, 0.5]), 0.01 * np.eye(3))
    groups.begin(groups.robots['r1'], 5)

    groups.restart('r1', 9, 'its odometry began again')

    assert groups.team.state.estimate(groups.team.robots['r1']).tolist() == [0.0, 0.0, 0.0]


def test_a_lost_anchor_does_not_define_map_anew_for_a_robot_that_had_joined_it():
    groups = groups_of('r1', 'r2')
    groups.merge(groups.team, groups.of('r2'))
    groups.leave('r2')

    groups.restart('r1', 9, 'lost')

    assert frames(groups) == {'map': [], 'r1/map': ['r1']}
