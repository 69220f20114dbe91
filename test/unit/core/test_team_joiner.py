# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frame groups join by shared landmarks, rendezvous points or a pose prior, or say why not."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.data_association.failure_detection import LostRobotDetector
from fej_slam_ros.core.data_association.landmark_manager import LandmarkManager
from fej_slam_ros.core.frame_groups import FrameGroups
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.map_joining import MapJoiner
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.pose_priors import PosePriors
from fej_slam_ros.core.quarantine import Quarantine
from fej_slam_ros.core.records import (
    NS, PosePrior, RendezvousKey, RobotObservation, RobotScan, UNKNOWN_POSE_COVARIANCE)
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.team_joiner import TeamJoiner
from helpers.core import turn
from helpers.records import team

#: Pose of r2's frame in that of r1, which is ``map``.
G = np.array([3.0, -2.0, 0.7])
POINTS = [(5.0, 1.0), (5.0, -1.0), (3.0, 4.0), (-2.0, 2.0)]


class Joining:
    """
    Robots r1, in ``map``, and r2, in a frame of its own, after step 0.

    Attributes
    ----------
    groups, statistics, pose_priors, joiner : of the team

    """

    def __init__(self, **settings):
        settings = team('r1', 'r2', **settings)
        self.groups, self.statistics = FrameGroups(settings, RecordedTruth()), InputStatistics()
        self.groups.robots = {robot.name: robot for robot in settings.robots}
        for robot in settings.robots:
            self.groups.begin(robot, 5)
        self.groups.is_initialized = True
        self.pose_priors = PosePriors(self.statistics)
        self.joiner = TeamJoiner(
            settings, self.groups, LandmarkManager(), self.statistics, self.pose_priors,
            Quarantine(self.groups, self.statistics, LostRobotDetector()))

    def observe_landmarks(self, robot, points, first_id=0):
        """Let a robot start confirmed landmarks at points of the base frame, numbered on."""
        state = self.groups.of(robot).state
        for number, point in enumerate(points, first_id):
            landmark = state.augment(
                ('', number), state.robots[robot], np.array(point), np.eye(2, 3),
                1e-4 * np.eye(2))
            landmark.tentative = None

    def share_landmarks(self, count):
        """Let both robots start the first landmarks of `POINTS`."""
        self.observe_landmarks('r1', POINTS[:count])
        self.observe_landmarks('r2', in_frame_of_r2(POINTS[:count]))

    def observe_robot(self, stamp, position, error=(0.0, 0.0), suspected=()):
        """Let r1 observe r2 at a position in r2's frame; some robots may be lost."""
        state = self.groups.of('r2').state
        robot = state.robots['r2']
        state.x_hat[robot.slot.indices] = [*position, 0.0]
        z = G[:2] + turn(G[2]) @ position + error
        observation = RobotObservation('r2', z, 1e-4 * np.eye(2))
        self.statistics.observations_used['r1'] += 1
        self.joiner.add_rendezvous_points(
            RobotScan('r1', stamp, (observation,)), suspected.__contains__)

    def pose_of_r2(self):
        state = self.groups.team.state
        return state.estimate(state.robots['r2'])


def in_frame_of_r2(points):
    return [turn(G[2]).T @ (np.array(point) - G[:2]) for point in points]


@pytest.fixture
def joining():
    return Joining(join_min_landmarks=3)


def test_frames_with_enough_shared_landmarks_join(joining):
    joining.share_landmarks(3)

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']
    assert_allclose(joining.pose_of_r2(), G, atol=1e-9)
    assert list(joining.groups.team.state.landmarks) == [('', 0), ('', 1), ('', 2)]
    assert joining.groups.not_in_map == {}


def test_frames_with_too_few_shared_landmarks_stay_apart_with_the_reason(joining):
    joining.share_landmarks(2)

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map', 'r2/map']
    assert joining.groups.not_in_map == {'r2': '2 shared landmarks, needs 3'}


def test_landmarks_that_have_ids_for_one_robot_only_are_a_reason(joining):
    joining.observe_landmarks('r1', POINTS)
    joining.observe_landmarks('r2', in_frame_of_r2(POINTS), first_id=-100)

    joining.joiner.join({})

    assert joining.groups.not_in_map == {'r2': (
        '0 shared landmarks, needs 3; 4 landmarks without ID, compared with others without ID'
        ' only')}


@pytest.mark.parametrize(('shared', 'attempts'), [(20, 10), (200, 1)])
def test_joins_of_many_landmarks_that_do_not_fit_are_not_attempted_at_every_step(
    joining, monkeypatch, shared, attempts
):
    rng = np.random.default_rng(1)
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, rng.uniform(-20.0, 20.0, (shared, 2)))
    made, join = [], MapJoiner.join
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: made.append(1) or join(*args))

    for stamp in range(NS, 2 * NS, NS // 10):
        joining.groups.of('r2').robots['r2'].stamp = stamp
        joining.joiner.join({})
        assert 'do not fit' in joining.groups.not_in_map['r2']

    assert len(made) == attempts
    joining.groups.of('r2').robots['r2'].stamp = 2 * NS
    joining.joiner.join({})
    assert len(made) == attempts + 1


def test_attempts_with_many_rendezvous_points_that_do_not_fit_are_rare(joining, monkeypatch):
    rng = np.random.default_rng(1)
    # 20 points at most.
    for k in range(30):
        joining.observe_robot(k, rng.uniform(-20.0, 20.0, 2), rng.uniform(-20.0, 20.0, 2))
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, rng.uniform(-20.0, 20.0, (180, 2)))
    made, join = [], MapJoiner.join
    failed = JoinFailure('do not fit')
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: made.append(join) or failed)

    for stamp in range(NS, 2 * NS, NS // 10):
        joining.groups.of('r2').robots['r2'].stamp = stamp
        joining.joiner.join({})

    # As of 200 landmarks; 180 are worth 0.73 s.
    assert len(made) == 1


def test_joins_that_keep_failing_are_attempted_less_and_less(joining, monkeypatch):
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, np.random.default_rng(1).uniform(-20.0, 20.0, (200, 2)))
    times, failed = [], JoinFailure('do not fit')
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: times.append(stamp) or failed)

    for stamp in range(NS, 100 * NS, NS):
        joining.groups.of('r2').robots['r2'].stamp = stamp
        joining.joiner.join({})

    # One second later after the first failure, two after the second, and ten after each from then.
    assert (np.diff(times) // NS).tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 10, 10, 10, 10]


def test_a_robot_that_no_longer_sends_is_joined_once_enough_is_shared(joining):
    joining.share_landmarks(2)
    joining.joiner.join({})
    assert joining.groups.not_in_map == {'r2': '2 shared landmarks, needs 3'}

    # r1 goes on and finds what r2 has mapped; the stamp of r2 stands still.
    state = joining.groups.of('r1').state
    state.robots['r1'].stamp += NS
    for number in (2, 3):
        for robot, point in (
                ('r1', np.array(POINTS[number])), ('r2', in_frame_of_r2(POINTS[number:])[0])):
            of_robot = joining.groups.of(robot).state
            of_robot.augment(
                ('', number), of_robot.robots[robot], point, np.eye(2, 3), 1e-4 * np.eye(2))
    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']


def test_a_robot_that_no_longer_sends_is_found_among_the_landmarks_without_id_of_others(joining):
    points = np.random.default_rng(2).uniform(-8.0, 8.0, (6, 2))
    joining.observe_landmarks('r2', in_frame_of_r2(points), first_id=-100)
    joining.observe_landmarks('r1', points[:3], first_id=-200)
    joining.joiner.join({})
    assert 'without ID' in joining.groups.not_in_map['r2']

    # r1 goes on and finds what r2 has mapped; the stamp of r2 stands still.
    joining.groups.of('r1').robots['r1'].stamp += NS
    joining.observe_landmarks('r1', points[3:], first_id=-197)
    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']


def test_the_map_that_a_robot_has_left_does_not_delay_the_join_of_its_present_one(joining):
    points, elsewhere = np.random.default_rng(2).uniform(-8.0, 8.0, (2, 6, 2))
    joining.observe_landmarks('r1', points, first_id=-200)
    joining.observe_landmarks('r2', elsewhere, first_id=-100)
    joining.groups.restart('r2', 9, 'lost')
    joining.observe_landmarks('r2', in_frame_of_r2(points), first_id=-300)

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map', 'r2/before/map']


def test_two_maps_without_robots_wait_for_one(joining):
    joining.share_landmarks(4)
    joining.groups.restart('r2', 9, 'lost')
    joining.groups.leave('r1')

    joining.joiner.join({})
    assert [group.frame for group in joining.groups] == ['map', 'r2/before/map', 'r2/map']

    joining.observe_landmarks('r2', in_frame_of_r2(POINTS))
    for _ in range(2):
        joining.joiner.join({})
    assert [group.frame for group in joining.groups] == ['map']


def test_shared_landmarks_alone_join_nothing_before_step_0(joining):
    joining.groups.is_initialized = False
    joining.share_landmarks(3)

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map', 'r2/map']


@pytest.mark.parametrize('is_initialized', [False, True])
def test_frames_join_by_rendezvous_points(joining, is_initialized):
    joining.groups.is_initialized = is_initialized
    for stamp, x in enumerate((0.0, 2.0, 4.0)):
        joining.observe_robot(stamp, (x, x**2 / 4.0))

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']
    position = G[:2] + turn(G[2]) @ [4.0, 4.0]
    assert_allclose(joining.pose_of_r2(), [*position, G[2]], atol=1e-9)
    assert joining.statistics.observations_used == {'r1': 3}


def test_a_robot_that_has_not_moved_gives_no_second_rendezvous_point(joining):
    for stamp in (0, 1):
        joining.observe_robot(stamp, (1.0, 2.0))

    assert list(joining.groups.team.state.rendezvous_points) == [RendezvousKey('r1', 'r2', 0)]
    assert joining.statistics.total(RejectionReason.NOT_JOINED) == 1
    assert joining.statistics.observations_used == {'r1': 1}


@pytest.mark.parametrize('suspected', ['r1', 'r2'])
def test_an_observation_by_or_of_a_robot_that_may_be_lost_gives_no_rendezvous_point(
        joining, suspected):
    joining.observe_robot(7, (1.0, 2.0), suspected=[suspected])

    assert not any(group.state.rendezvous_points for group in joining.groups)
    (rejection,) = joining.statistics.rejections
    assert (rejection.reason, rejection.robot, rejection.observed, rejection.stamp) == (
        RejectionReason.LOST_ROBOT, 'r1', 'r2', 7)
    assert joining.statistics.observations_used == {'r1': 0}


@pytest.mark.parametrize('reobserved_by', [[], ['r1'], ['r2']])
def test_a_landmark_that_contradicts_the_others_is_removed_and_rejected_if_observed_once(
        joining, reobserved_by):
    joining.share_landmarks(4)
    joining.observe_landmarks('r1', [(-4.0, -3.0)], first_id=4)
    joining.observe_landmarks('r2', in_frame_of_r2([(-4.0, -6.0)]), first_id=4)
    for robot in reobserved_by:
        joining.groups.of(robot).state.landmarks['', 4].is_reobserved = True

    joining.joiner.join({})

    assert joining.groups.not_in_map == {'r2': '1 of 5 shared landmarks contradict the others'}
    assert all(('', 4) not in group.state.landmarks for group in joining.groups)
    # Both robots began at the stamp 5.
    assert [(r.robot, r.reason, r.stamp, r.id) for r in joining.statistics.rejections] == [
        (robot, RejectionReason.GATED, 5, 4)
        for robot in ('r1', 'r2') if robot not in reobserved_by]

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']


def test_an_outlier_among_rendezvous_points_is_dropped_and_the_rest_joins(joining):
    for stamp, x in enumerate((0.0, 2.0, 4.0, 6.0, 8.0)):
        joining.observe_robot(
            stamp, (x, x**2 / 4.0), error=(0.0, 3.0) if stamp == 2 else (0.0, 0.0))

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map', 'r2/map']
    assert joining.groups.not_in_map['r2'].startswith('0 shared landmarks and 5 observations')
    (rejection,) = joining.statistics.rejections
    assert (rejection.reason, rejection.robot, rejection.observed, rejection.stamp) == (
        RejectionReason.GATED, 'r1', 'r2', 2)
    assert rejection.d2 > rejection.threshold
    assert joining.statistics.observations_used == {'r1': 4}

    joining.joiner.join({})

    assert [group.frame for group in joining.groups] == ['map']
    assert_allclose(joining.pose_of_r2()[2], G[2], atol=1e-9)


def test_a_pose_prior_joins_the_frame_of_its_robot_at_its_next_step(joining):
    joining.pose_priors.add(PosePrior('r2', 7, G, 0.01 * np.eye(3)))

    joining.joiner.apply_pose_priors('r2', 6)
    assert [group.frame for group in joining.groups] == ['map', 'r2/map']
    joining.joiner.apply_pose_priors('r2', 7)

    assert [group.frame for group in joining.groups] == ['map']
    assert_allclose(joining.pose_of_r2(), G, atol=1e-12)


def test_a_map_of_rendezvous_points_alone_is_dropped_if_its_robot_joins_without_it(joining):
    joining.observe_robot(6, (0.0, 0.0))
    # The heading may be linearised, but is too uncertain to join frames.
    joining.pose_priors.add(PosePrior('r2', 7, G, np.diag([0.01, 0.01, 0.04])))

    joining.joiner.apply_pose_priors('r2', 7)

    assert [group.frame for group in joining.groups] == ['map']
    assert_allclose(joining.pose_of_r2(), G)
    assert not joining.groups.team.state.rendezvous_points


def test_a_pose_prior_that_contradicts_shared_landmarks_is_rejected(joining):
    joining.share_landmarks(2)
    pose = G + np.array([5.0, 0.0, 0.0])
    joining.pose_priors.add(PosePrior('r2', 7, pose, 0.01 * np.eye(3)))

    joining.joiner.apply_pose_priors('r2', 7)

    assert [group.frame for group in joining.groups] == ['map', 'r2/map']
    assert joining.statistics.total(RejectionReason.DOES_NOT_FIT) == 1


def test_a_pose_places_a_robot_of_the_map_independently_of_the_map(joining):
    state = joining.groups.team.state
    joining.share_landmarks(2)
    joining.pose_priors.add(PosePrior('r1', 7, G, 0.01 * np.eye(3)))

    assert not joining.joiner.relocate('r1', 6)
    assert joining.joiner.relocate('r1', 7)

    robot = state.robots['r1']
    others = [*state.landmarks.values()]
    P = state.marginal([robot, *others])
    assert_allclose(state.estimate(robot), G)
    assert_allclose(P[:3, :3], 0.01 * np.eye(3))
    assert_allclose(P[:3, 3:], 0.0)
    assert len(others) == 2
    assert joining.statistics.pose_priors_used == {'r1': 1}


def test_a_pose_too_uncertain_to_linearise_restarts_its_robot_in_its_own_frame(joining):
    P = np.diag([1.0, 1.0, 3.0])
    joining.pose_priors.add(PosePrior('r1', 7, G, P))

    assert joining.joiner.relocate('r1', 7)

    assert [group.frame for group in joining.groups if 'r1' in group.robots] == ['r1/map']
    assert joining.statistics.relocalized == {'r1': 1}


def test_a_pose_too_uncertain_to_linearise_leaves_a_robot_outside_map(joining):
    joining.pose_priors.add(PosePrior('r2', 7, G, UNKNOWN_POSE_COVARIANCE))

    joining.joiner.apply_pose_priors('r2', 7)

    assert joining.groups.of('r2').frame == 'r2/map'
    assert joining.statistics.total(RejectionReason.DOES_NOT_FIT) == 1


def test_a_pose_of_a_robot_that_joined_at_the_same_step_is_rejected(joining):
    joining.pose_priors.add(PosePrior('r1', 7, G, 0.01 * np.eye(3)))

    joining.joiner.apply_pose_priors('r1', 7)

    assert joining.statistics.total(RejectionReason.ALREADY_LOCATED) == 1


def test_the_time_between_attempts_grows_with_the_cube_of_the_number_of_landmarks(
        joining, monkeypatch):
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, np.random.default_rng(1).uniform(-20.0, 20.0, (100, 2)))
    times, failed = [], JoinFailure('do not fit')
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: times.append(stamp) or failed)

    for stamp in range(NS, 2 * NS, NS // 16):
        joining.groups.of('r2').robots['r2'].stamp = stamp
        joining.joiner.join({})

    # An eighth of the second of 200 landmarks, then two and three eighths.
    assert (np.diff(times) / NS).tolist() == [0.125, 0.25, 0.375]


def test_joins_of_any_number_of_landmarks_are_attempted_each_minute(joining, monkeypatch):
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, np.random.default_rng(1).uniform(-20.0, 20.0, (800, 2)))
    times, failed = [], JoinFailure('do not fit')
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: times.append(stamp) or failed)

    for stamp in range(NS, 150 * NS, 5 * NS):
        joining.groups.of('r2').robots['r2'].stamp = stamp
        joining.joiner.join({})

    assert (np.diff(times) // NS).tolist() == [60, 60]


def test_other_conditions_of_joining_are_tried_at_once(joining, monkeypatch):
    for robot in ('r1', 'r2'):
        joining.observe_landmarks(robot, np.random.default_rng(1).uniform(-20.0, 20.0, (200, 2)))
    made, failed = [], JoinFailure('do not fit')
    monkeypatch.setattr(MapJoiner, 'join', lambda *args: made.append(1) or failed)
    joining.joiner.join({})

    joining.joiner.change_settings(team('r1', 'r2', join_probability=0.9999))
    joining.joiner.join({})

    assert len(made) == 2
