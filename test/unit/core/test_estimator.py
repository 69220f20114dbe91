# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records in, poses out: the frame of each robot over time, in any order of arrival."""

from dataclasses import replace
from itertools import cycle, permutations
from math import pi

import numpy as np
import pytest

from fej_slam_ros.core.ekf import joint_update
from fej_slam_ros.core.ekf.gating import ScanGateStatistics
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ground_truth import MissingTruthError
from fej_slam_ros.core.new_landmarks import MAX_NEW_WITHOUT_ID, MIN_ROOM
from fej_slam_ros.core.pieces import between_pieces
from fej_slam_ros.core.records import (
    NO_ID, Odometry, PosePrior, RobotScan, Scan, TrueLandmarks)
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, WorldSettings
from helpers.core import bits, frames
from helpers.optional import given, Phase, settings, strategies as st
from helpers.records import MS, odometry, scan, team, true_pose

ANCHOR_POSE = (10.0, 5.0, pi / 2)

#: Two landmarks as the anchor sees them at ANCHOR_POSE, and as r2 sees them at R2_POSE, which the
#: anchor has at (4, 0) with the heading -90 degrees; a third one that only the anchor sees.
BY_ANCHOR = ((1, (2.0, 1.0)), (2, (2.0, -1.0)), (7, (-3.0, 0.0)))
BY_R2 = ((1, (-1.0, -2.0)), (2, (1.0, -2.0)))
R2_POSE = (10.0, 9.0, 0.0)

MAX_DELAY = 100 * MS


def run(options, *records):
    """Take the steps while the records arrive one by one; return the estimator and its steps."""
    estimator, results = Estimator(options), []
    for record in records:
        estimator.add(record)
        results += estimator.take()
    return estimator, [*results, *estimator.close()]


def poses_of(robot, results):
    return {
        pose.stamp // MS: pose for result in results for pose in result.poses
        if pose.robot == robot}


def frames_of(robot, results):
    return {ms: pose.frame for ms, pose in poses_of(robot, results).items()}


def both(ms):
    return odometry('r1', ms), odometry('r2', ms)


def test_every_step_of_a_robot_gives_exactly_one_pose():
    _, results = run(
        team(), *both(0), scan('r1', 30), odometry('r1', 50), *both(100), scan('r1', 100),
        scan('r2', 170), *both(200))

    assert [(pose.stamp // MS, pose.robot) for result in results for pose in result.poses] == [
        (0, 'r1'), (0, 'r2'), (30, 'r1'), (50, 'r1'), (100, 'r1'), (100, 'r2'), (170, 'r2'),
        (200, 'r1'), (200, 'r2')]
    assert [result.stamp // MS for result in results] == [0, 30, 50, 100, 170, 200]


def test_a_robot_is_predicted_to_its_scan_between_odometry_stamps():
    _, results = run(
        team('r1', odometry_sigma=(9.0, 9.0, 9.0)), odometry('r1', 0, (5.0, 5.0, pi / 2)),
        scan('r1', 250), odometry('r1', 1000, (5.0, 9.0, pi / 2)))

    poses = poses_of('r1', results)
    np.testing.assert_allclose(poses[250].pose, [1.0, 0.0, 0.0], atol=1e-15)
    # A quarter of a second at the robot's own sigma, 0.05 m and 0.02 rad, and nothing else.
    np.testing.assert_allclose(np.diag(poses[250].P), [6.25e-4, 6.25e-4, 1e-4], rtol=1e-12)
    np.testing.assert_allclose(poses[1000].pose, [4.0, 0.0, 0.0], atol=1e-15)


def test_the_anchor_is_in_the_map_from_its_first_odometry():
    options = team(anchor_pose=ANCHOR_POSE, anchor_sigma=(0.1, 0.2, 0.05))

    estimator, results = run(options, odometry('r1', 0, (3.0, 3.0, 3.0)))

    (pose,) = results[0].poses
    assert (pose.robot, pose.frame) == ('r1', 'map')
    np.testing.assert_array_equal(pose.pose, ANCHOR_POSE)
    np.testing.assert_allclose(pose.P, np.diag([0.01, 0.04, 0.0025]), rtol=1e-15)
    assert 'r1' not in estimator.groups.not_in_map
    assert results[0].joined == (('r1', 0),)


def test_landmarks_that_several_robots_observe_at_step_0_count_as_observed_again():
    estimator, _ = run(
        team(anchor_pose=ANCHOR_POSE), *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    assert {
        key: landmark.is_reobserved
        for (_, key), landmark in estimator.groups.team.state.landmarks.items()
    } == {1: True, 2: True, 7: False}


def test_a_robot_whose_last_scan_failed_maps_again_after_a_gap_in_its_odometry():
    seen = [(k, (4.0 + k % 2, 2.0 * k - 4.0)) for k in range(5)]
    estimator = Estimator(team(
        known=[('r2', R2_POSE, (0.01, 0.01, 0.01))], anchor_pose=R2_POSE))
    lost_robots = estimator.innovations.lost_robots

    def receive(*stamps):
        for ms in stamps:
            for record in (*both(ms), scan('r1', ms, seen), scan('r2', ms, seen)):
                estimator.add(record)
        assert list(estimator.release())

    receive(0, 100, 200)
    lost_robots.add({'r2': ScanGateStatistics(known=5, failed=5)})
    assert lost_robots.is_suspected('r2')
    receive(600_200, 600_300)

    assert estimator.statistics.relocalized['r2'] == 1
    assert not lost_robots.is_suspected('r2')
    assert estimator.statistics.rejection_counts['r2'] == {}


def test_a_robot_with_unknown_initial_pose_starts_at_the_origin_of_its_own_map():
    estimator, results = run(team(anchor_pose=ANCHOR_POSE), *both(0), scan('r2', 0, BY_R2))

    pose = poses_of('r2', results)[0]
    assert pose.frame == 'r2/map'
    np.testing.assert_array_equal(pose.pose, np.zeros(3))
    np.testing.assert_array_equal(pose.P, np.zeros((3, 3)))
    assert len(frames(estimator)['r2/map'].landmarks) == 2
    assert 'anchor r1' in estimator.groups.not_in_map['r2']


def test_a_robot_that_shares_two_landmarks_at_step_0_is_in_the_map_from_then_on():
    estimator, results = run(
        team(anchor_pose=ANCHOR_POSE), odometry('r1', 0, (0.0, 0.0, 0.0)), odometry('r2', 0),
        odometry('r1', 100, (0.0, 0.0, 0.0)), odometry('r2', 100),
        scan('r1', 100, BY_ANCHOR), scan('r2', 100, BY_R2), *both(200))

    assert frames_of('r2', results) == {0: 'r2/map', 100: 'map', 200: 'map'}
    # Gauss-Newton ends below 1e-12.
    np.testing.assert_allclose(poses_of('r2', results)[100].pose, R2_POSE, atol=1e-11)
    assert results[1].joined == (('r1', 100 * MS), ('r2', 100 * MS))
    assert estimator.joint_covariance().shape == (6, 6)
    assert not estimator.groups.not_in_map
    assert list(frames(estimator)) == ['map']


def test_step_0_uses_every_observation_once():
    estimator, results = run(
        team(), *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    # Each robot knows the direction of the baseline of 2 m by 0.1 sqrt(2) m / 2 m.
    assert poses_of('r2', results)[0].P[2, 2] == pytest.approx(0.01, rel=1e-9)
    assert all(nis.dof == 0 for nis in estimator.innovations.nis.values())
    assert estimator.statistics.observations_used == {'r1': 3, 'r2': 2}


def test_landmarks_observed_by_one_robot_at_step_0_are_in_the_map():
    estimator, _ = run(team(), *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    seen = {number for number, _ in [*BY_ANCHOR, *BY_R2]}
    assert {number for _, number in estimator.groups.team.state.landmarks} == seen


def test_step_0_is_the_first_stamp_at_which_the_anchor_observes_a_landmark():
    _, results = run(
        team(), *both(0), scan('r1', 0), scan('r2', 0, BY_R2), *both(100), scan('r2', 100, BY_R2),
        *both(200), scan('r1', 200, BY_ANCHOR), scan('r2', 200, BY_R2))

    assert frames_of('r2', results) == {0: 'r2/map', 100: 'r2/map', 200: 'map'}


def test_two_landmarks_shared_with_different_robots_of_the_team_suffice():
    # All three stand at the origin and look the same way.
    _, results = run(
        team('r1', 'r2', 'r3'), *both(0), odometry('r3', 0), scan('r1', 0, BY_ANCHOR),
        scan('r2', 0, [*BY_ANCHOR[:2], (8, (0.0, 5.0))]),
        scan('r3', 0, [(7, (-3.0, 0.0)), (8, (0.0, 5.0))]))

    pose = poses_of('r3', results)[0]
    assert pose.frame == 'map'
    np.testing.assert_allclose(pose.pose, np.zeros(3), atol=1e-11)


@pytest.mark.parametrize('of_r2', [
    [odometry('r2', 0), odometry('r2', 100)],
    [odometry('r2', 0), scan('r2', 50, BY_R2), odometry('r2', 100)],
    [odometry('r2', 0), odometry('r2', 100), scan('r2', 100)],
    [odometry('r2', 100), scan('r2', 100, BY_R2[:1])],
    [odometry('r2', 100), scan('r2', 100, [(8, (1.0, 1.0))])],
    [odometry('r2', 150), scan('r2', 150, BY_R2)],
])
def test_a_robot_not_determined_at_step_0_stays_in_its_own_map_with_a_reason(of_r2):
    estimator, results = run(
        team(), odometry('r1', 0), odometry('r1', 100), scan('r1', 100, BY_ANCHOR), *of_r2,
        *both(300), scan('r1', 300, BY_ANCHOR), scan('r2', 300, BY_R2))

    assert set(frames_of('r2', results).values()) == {'r2/map'}
    assert estimator.groups.not_in_map['r2'] == '2 shared landmarks, needs 3'
    assert results[-1].joined == (('r1', 300 * MS),)


def test_a_robot_without_odometry_is_reported():
    estimator, _ = run(
        team(), odometry('r1', 0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    assert estimator.groups.not_in_map == {'r2': 'it sent no usable odometry'}


@pytest.mark.parametrize('first', [0, 200])
def test_a_robot_with_known_initial_pose_is_in_the_map_from_its_first_odometry(first):
    options = team(known=[('r2', R2_POSE, (0.1, 0.2, 0.05))])

    estimator, results = run(
        options, odometry('r1', 0), odometry('r1', 100), scan('r1', 100, BY_ANCHOR),
        odometry('r2', first), *both(300))

    pose = poses_of('r2', results)[first]
    assert set(frames_of('r2', results).values()) == {'map'}
    np.testing.assert_array_equal(pose.pose, R2_POSE)
    np.testing.assert_allclose(pose.P, np.diag([0.01, 0.04, 0.0025]), rtol=1e-15)
    assert not estimator.groups.not_in_map


@pytest.mark.parametrize(('seen', 'frame'), [(BY_R2, 'map'), ([], 'r2/map')])
def test_step_0_solves_for_an_uncertain_start_or_the_robot_is_not_in_map(seen, frame):
    # A heading sigma of 1 rad is too large to linearise, but step 0 iterates.
    options = team(known=[('r2', R2_POSE, (0.1, 0.1, 1.0))], anchor_pose=ANCHOR_POSE)

    estimator, results = run(options, *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, seen))

    assert frames_of('r2', results)[0] == frame
    assert estimator.pose('r2').frame == frame
    assert ('r2' in estimator.statistics.restart_reasons) is (frame != 'map')


def test_step_0_updates_what_a_robot_mapped_before():
    # r2 has mapped landmark 9 in a frame of its own; step 0 aligns it by landmarks 1 and 2.
    def after(nine):
        estimator, _ = run(
            team(anchor_pose=ANCHOR_POSE), *both(0), scan('r2', 0, [(9, (2.0, 1.0))]), *both(100),
            scan('r1', 100, BY_ANCHOR), scan('r2', 100, [*BY_R2, (9, nine)]))
        return estimator.pose('r2').frame, estimator.state_hash()

    (frame, as_before), (_, moved) = after((2.0, 1.0)), after((2.05, 1.0))

    assert frame == 'map'
    assert moved != as_before


def test_step_0_starts_no_more_landmarks_than_allowed():
    seen = [(number, (3.0 + number, (-1.0) ** number)) for number in range(20)]
    estimator, _ = run(
        team(max_landmarks=4), *both(0), scan('r1', 0, seen), scan('r2', 0, seen))

    assert len(estimator.landmarks()) == 4
    assert estimator.statistics.total(RejectionReason.MAP_FULL) == 2 * 16
    assert estimator.pose('r2').frame == 'map'


def test_shared_ids_are_one_landmark():
    options = team(known=[('r2', R2_POSE, (0.1, 0.1, 0.1))], anchor_pose=ANCHOR_POSE)

    estimator, _ = run(options, *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    assert sorted(frames(estimator)['map'].landmarks) == [('', 1), ('', 2), ('', 7)]


def test_ids_that_are_not_shared_belong_to_each_robot():
    options = team(
        known=[('r2', R2_POSE, (0.1, 0.1, 0.1))], anchor_pose=ANCHOR_POSE,
        shared_landmark_ids=False)

    estimator, _ = run(options, *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    assert sorted(frames(estimator)['map'].landmarks) == [
        ('r1', 1), ('r1', 2), ('r1', 7), ('r2', 1), ('r2', 2)]


def test_ids_that_are_not_shared_start_no_other_robot():
    _, results = run(
        team(shared_landmark_ids=False), *both(0), scan('r1', 0, BY_ANCHOR),
        scan('r2', 0, BY_R2))

    assert frames_of('r2', results) == {0: 'r2/map'}


TEAM = 'r1', 'r2', 'r3'
STEPS = 30
#: Who lags is waited for: this is longer than lag, delay and period of odometry together.
STALE_AFTER, LAG = 0.6, 4 * MAX_DELAY

#: To shrink a failing run of 200 records takes longer than a test may.
PHASES = [Phase.explicit, Phase.reuse, Phase.generate]


def later(record, ms):
    return replace(record, stamp=record.stamp + ms * MS)


def recorded(seed, rate, scans_later=(0,), r2_later=0):
    """
    Return what three robots measure, of each other too, in the order of stamps.

    Scans lie behind odometry by one of some numbers of ms, all of r2 behind the others. Every
    third scan of two or more comes in two messages.

    """
    world = make_world(
        WorldSettings('circles', (30.0, 25.0), STEPS, TEAM, landmarks=8, loops=1, rate=rate),
        np.random.default_rng(seed))
    sensors = SensorSettings(
        (0.02, 0.02, 0.01), (0.1, 0.1), range=6.0, robot_sigma=(0.1, 0.1))
    measured = [*measure(world, sensors, np.random.default_rng(seed))]
    records = [record for record in measured if isinstance(record, Odometry)]
    scans = (record for record in measured if isinstance(record, (Scan, RobotScan)))
    for number, (record, ms) in enumerate(zip(scans, cycle(scans_later))):
        seen = record.observations
        parts = [seen[:1], seen[1:]] if number % 3 == 0 and len(seen) > 1 else [seen]
        records += [later(replace(record, observations=part), ms) for part in parts]
    return sorted(
        (later(record, r2_later * (record.robot == 'r2')) for record in records),
        key=lambda record: record.stamp)


def without_silence(records, silence):
    """Leave out what r3 would have sent while it was silent, from one odometry to another."""
    of_r3 = [r.stamp for r in records if isinstance(r, Odometry) and r.robot == 'r3']
    last, next_one = silence
    return [
        r for r in records if r.robot != 'r3' or r.stamp <= of_r3[last]
        or (next_one is not None and r.stamp >= of_r3[next_one])]


@st.composite
def arrivals(draw):
    """Draw the records of a run in order of stamps, the same as they arrive, and duplicates."""
    # Odometry that comes every 50 ms or 67 ms: max_delay is a whole number of the first only.
    records = recorded(
        draw(st.integers(0, 9)), draw(st.sampled_from([20.0, 15.0])),
        draw(st.sampled_from([(0,), (17,), (0, 17, 31, 5)])), draw(st.sampled_from([0, 13])))
    # One robot is silent for less or more than stale_after, or for good.
    silence = draw(st.sampled_from([None, (8, 12), (5, 25), (10, None)]))
    records = records if silence is None else without_silence(records, silence)
    shuffled = draw(st.permutations(records))
    delays = draw(st.lists(
        st.integers(0, MAX_DELAY - 1), min_size=len(records), max_size=len(records)))
    duplicates = draw(st.lists(
        st.tuples(st.sampled_from(records), st.integers(0, 10 * MAX_DELAY)), max_size=10))
    lag = {'r1': 0, 'r2': draw(st.sampled_from([0, LAG])), 'r3': 0}
    arrived = sorted(
        [*zip(shuffled, delays), *duplicates],
        key=lambda sent: sent[0].stamp + sent[1] + lag[sent[0].robot])
    return records, [record for record, _ in arrived], len(duplicates)


def assert_nothing_is_lost(estimator, arrived, results):
    """
    All that odometry reached was used, once, and made steps; what came again was refused.

    Steps of a robot are also where others see it.

    """
    for robot in TEAM:
        messages = [record for record in arrived if record.robot == robot]
        newest = max(record.stamp for record in messages if isinstance(record, Odometry))
        reached = {record for record in messages if record.stamp <= newest}
        assert estimator.statistics.received[robot] == len(messages)
        assert estimator.used(robot) == len(reached)
        steps, own = poses_of(robot, results), {record.stamp // MS for record in reached}
        seen = {
            record.stamp // MS for record in arrived if isinstance(record, RobotScan)
            and any(observation.observed == robot for observation in record.observations)}
        assert [*steps] == sorted(steps)
        assert own <= steps.keys() <= own | seen


def assert_same_bits_in_any_order(arrival, known):
    options = team(
        *TEAM, known=[('r2', (0.0, -3.0, 0.0), (0.1, 0.1, 0.1))] if known else (),
        stale_after=STALE_AFTER)
    in_order, arrived, duplicates = arrival

    expected, in_order_results = run(options, *in_order)
    estimator, results = run(options, *arrived)

    assert bits(results) == bits(in_order_results)
    assert estimator.state_hash() == expected.state_hash()
    assert not estimator.statistics.depends_on_arrival()
    assert estimator.statistics.total(RejectionReason.DUPLICATE) == duplicates
    assert_nothing_is_lost(estimator, arrived, results)


@settings(max_examples=40, deadline=None, phases=PHASES, derandomize=True)
@given(arrivals(), st.booleans())
def test_arrival_orders_within_max_delay_give_the_same_bits(arrival, known):
    assert_same_bits_in_any_order(arrival, known)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@settings(max_examples=500, deadline=None, phases=PHASES)
@given(arrivals(), st.booleans())
def test_five_hundred_orders_of_arrival_give_the_same_bits(arrival, known):
    assert_same_bits_in_any_order(arrival, known)


def test_the_tested_arrival_orders_include_robots_that_join():
    # Where r2 is 13 ms later than r1 it has no part in step 0.
    estimator, results = run(team(*TEAM), *recorded(1, 20.0, r2_later=13))

    step_0 = next(iter(poses_of('r1', results)))
    assert step_0 not in poses_of('r2', results)
    assert set(frames_of('r2', results).values()) == {'map'}
    assert estimator.groups.not_in_map == {}


def test_scans_may_come_after_the_odometry_of_all_robots_at_their_stamp():
    at_start = [*both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2)]
    at_200 = [*both(200), scan('r1', 200, BY_ANCHOR), scan('r2', 200, BY_R2)]

    runs = [run(team(), *a, *b, *both(400))
            for a, b in zip(permutations(at_start), reversed([*permutations(at_200)]))]

    assert len({estimator.state_hash() for estimator, _ in runs}) == 1
    assert all(len(results) == 3 for _, results in runs)
    assert all(estimator.statistics.rejected.total() == 0 for estimator, _ in runs)


def test_every_message_is_used_or_rejected_or_waits():
    estimator = Estimator(team('r1'))
    for record in (
            scan('r1', 0), odometry('r1', 10), odometry('r1', 100), scan('r1', 50),
            scan('r1', 50), odometry('r1', 100, (9.0, 9.0, 0.0)), odometry('r1', 300)):
        estimator.add(record)
        list(estimator.take())
    for record in (
            odometry('r1', 20), scan('r1', 20), scan('r1', 400), true_pose('r1', 0, np.zeros(3)),
            odometry('r9', 0), true_pose('r9', 0, np.zeros(3))):
        estimator.add(record)
    estimator.add(odometry('r1', 9000), received=0)

    assert estimator.statistics.received == {'r1': 12, 'r9': 2}
    assert estimator.statistics.rejected == {'r1': 6, 'r9': 2}
    assert estimator.used('r1') == 4  # at 10, 50 and 100 ms, and the truth; 300 and 400 wait

    list(estimator.close())

    assert estimator.statistics.rejection_counts['r1'] == {
        RejectionReason.BEFORE_ODOMETRY: 1, RejectionReason.DUPLICATE: 1,
        RejectionReason.CONFLICTING: 1, RejectionReason.LATE: 2,
        RejectionReason.FUTURE: 1, RejectionReason.AFTER_ODOMETRY: 1}
    assert (estimator.used('r1'), estimator.used('r9')) == (5, 0)


def test_the_ideal_filter_reports_missing_true_poses_in_one_sentence():
    with pytest.raises(MissingTruthError, match=r'^[^.\n]*r1/ground_truth[^.\n]*$'):
        run(team('r1', filter='ideal'), odometry('r1', 0), odometry('r1', 100))


def test_the_ideal_filter_reports_missing_true_landmarks_in_one_sentence():
    with pytest.raises(MissingTruthError, match=r'^[^.\n]*landmark 1\b[^.\n]*$'):
        run(team('r1', filter='ideal'), true_pose('r1', 0, np.zeros(3)), odometry('r1', 0),
            scan('r1', 0, BY_ANCHOR))


def test_the_ideal_filter_runs_on_ground_truth_in_every_frame():
    landmarks = TrueLandmarks({1: np.array([9.0, 7.0]), 2: np.array([11.0, 7.0])})
    truth = [true_pose(*x) for ms in (0, 300) for x in (
        ('r1', ms, ANCHOR_POSE), ('r2', ms, R2_POSE))]

    _, results = run(
        team(filter='ideal'), landmarks, *truth, *both(0), scan('r2', 0, BY_R2), *both(200),
        scan('r1', 200, BY_ANCHOR[:2]), *both(300))

    assert frames_of('r2', results) == {0: 'r2/map', 200: 'r2/map', 300: 'r2/map'}


@pytest.mark.slow
def test_a_long_run_drops_ground_truth_that_it_has_used():
    estimator = Estimator(team())
    steps = 0
    for ms in range(0, 100_000, 20):
        for record in (
                *both(ms), scan('r1', ms + 7, BY_ANCHOR), scan('r2', ms + 7),
                true_pose('r1', ms, np.zeros(3)), true_pose('r2', ms, np.zeros(3))):
            estimator.add(record)
        steps += sum(len(result.poses) for result in estimator.take())

    # What waits: events of the last max_delay and of the increment that a scan divides there,
    # 6 periods of 4, and those of the present period.
    assert steps >= 20_000 - 28
    for robot in ('r1', 'r2'):
        assert estimator.truth.newest(robot) == 99_980 * MS
        # Poses are scored a hundred, or a second, at a time.
        assert not estimator.truth.covers(robot, 98_700 * MS)


def test_poses_landmarks_and_covariances_are_those_of_the_last_step():
    estimator, results = run(
        team(anchor_pose=ANCHOR_POSE), *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2),
        *both(100))

    last = {pose.robot: pose for pose in results[-1].poses}
    for name, pose in last.items():
        now = estimator.pose(name)
        assert (now.robot, now.stamp, now.frame) == (name, pose.stamp, 'map')
        assert now.pose.tobytes() == pose.pose.tobytes()
    P = estimator.joint_covariance()
    np.testing.assert_array_equal(P[:3, :3], last['r1'].P)
    np.testing.assert_array_equal(P[3:, 3:], last['r2'].P)
    # The anchor, exactly at (10, 5) and facing +y, observes them at BY_ANCHOR.
    assert [landmark.id for landmark in estimator.landmarks()] == [1, 2, 7]
    np.testing.assert_allclose(
        [landmark.position for landmark in estimator.landmarks()],
        [[9.0, 7.0], [11.0, 7.0], [10.0, 2.0]], atol=1e-12)
    assert [(m.frame, m.robots, len(m)) for m in estimator.maps()] == [('map', ('r1', 'r2'), 3)]


def test_the_joint_covariance_of_no_robots_is_empty():
    assert Estimator(team()).joint_covariance().shape == (0, 0)


def test_a_relative_pose_needs_both_robots_in_map():
    estimator, _ = run(team(), *both(0), scan('r1', 0, BY_ANCHOR), *both(100))

    assert estimator.relative_pose('r1', 'r2') is None


def test_an_anchor_that_is_placed_before_it_observes_a_landmark_defines_map_there():
    placed = PosePrior('r1', 100 * MS, np.array([5.0, 1.0, pi / 2]), 0.01 * np.eye(3))
    estimator, steps = run(
        team(), placed, *(odometry('r1', ms) for ms in (0, 100, 200)),
        scan('r1', 200, [(1, (2.0, 0.0))]), odometry('r1', 400))

    poses = {step.stamp // MS: step.poses[0].pose for step in steps}
    np.testing.assert_allclose(poses[100], [5.0, 1.0, pi / 2])
    np.testing.assert_allclose(poses[200], [5.0, 1.1, pi / 2], atol=1e-12)
    np.testing.assert_allclose(estimator.landmarks()[0].position, [5.0, 3.1], atol=1e-12)


def test_a_pose_at_the_first_odometry_is_used_as_a_start_pose_is():
    pose, sigma = (4.0, 1.0, 0.5), (0.3, 0.2, 0.1)
    records = [
        *(odometry(name, ms, (0.001 * ms, 0.0, 0.0))
          for ms in range(0, 600, 100) for name in ('r1', 'r2')),
        scan('r1', 0, [(1, (2.0, 0.0))]), scan('r2', 200, [(2, (1.0, 1.0))])]
    given = PosePrior('r2', 0, np.array(pose), np.diag(np.square(sigma)))

    _, placed = run(team('r1', 'r2'), given, *records)
    _, started = run(team('r1', 'r2', known=[('r2', pose, sigma)]), *records)

    for one, other in zip(placed, started, strict=True):
        of_one, of_other = (
            next(p for p in step.poses if p.robot == 'r2') for step in (one, other))
        assert (of_one.frame, of_other.frame) == ('map', 'map')
        np.testing.assert_allclose(of_one.pose, of_other.pose, atol=1e-12)
        np.testing.assert_allclose(of_one.P, of_other.P, atol=1e-12)


def row_of(count, first=0):
    """Return observations of landmarks in a row."""
    return [(number, (1.0 + number, 2.0)) for number in range(first, first + count)]


def test_a_full_map_starts_no_landmark_and_still_uses_its_own():
    estimator = Estimator(team('r1', max_landmarks=5))
    for ms, seen in ((0, row_of(3)), (100, row_of(4, 1)), (200, row_of(9))):
        estimator.add(odometry('r1', ms, (0.0, 0.0, 0.0)))
        estimator.add(scan('r1', ms, seen))
    list(estimator.close())

    assert [landmark.id for landmark in estimator.landmarks()] == [0, 1, 2, 3, 4]
    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.MAP_FULL: 4}
    assert estimator.statistics.observations_used['r1'] == 3 + 4 + 5


def test_a_robot_outside_map_has_room_for_the_landmarks_by_which_it_joins_a_full_map():
    estimator = Estimator(team(max_landmarks=5))
    for ms in range(0, 500, 100):
        # Before r2, which is where r1 is, maps in a frame of its own.
        for name in ('r1', 'r2') if ms else ('r1',):
            estimator.add(odometry(name, ms, (0.0, 0.0, 0.0)))
            estimator.add(scan(name, ms, row_of(9)))
    list(estimator.close())

    assert estimator.groups.not_in_map == {}
    # Five and, from before the join, the other four of r2.
    assert len(estimator.landmarks()) == 9


def test_the_room_of_a_robot_outside_map_is_limited_too():
    estimator = Estimator(team(max_landmarks=2))
    for name in ('r1', 'r2'):
        estimator.add(odometry(name, 0, (0.0, 0.0, 0.0)))
        estimator.add(scan(name, 0, row_of(2, first=0 if name == 'r1' else 100)))
    estimator.add(odometry('r2', 100, (0.0, 0.0, 0.0)))
    estimator.add(scan('r2', 100, row_of(MIN_ROOM + 7, first=100)))
    list(estimator.close())

    assert len(estimator.groups.of('r2').state.landmarks) == MIN_ROOM
    assert estimator.statistics.rejection_counts['r2'] == {RejectionReason.MAP_FULL: 7}


def test_a_pose_within_a_gap_that_cannot_be_predicted_is_rejected():
    """Driven on by a motion of unknown heading, the robot may be anywhere around."""
    estimator = Estimator(team(known=[('r2', (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))]))
    turning = np.diag([1e-4, 1e-4, 0.01])
    given = PosePrior('r2', 200 * MS, np.array([5.0, 5.0, 0.0]), 0.01 * np.eye(3))
    for ms in (0, 100, 40_100, 40_200):
        for name in ('r1', 'r2'):
            estimator.add(odometry(name, ms, None, turning))
    estimator.add(given)
    list(estimator.close())

    assert [(r.robot, r.reason) for r in estimator.statistics.rejections] == [
        ('r2', RejectionReason.DOES_NOT_FIT)]
    assert 'r2' not in estimator.groups.team.robots


def test_the_last_place_of_a_map_takes_all_observations_of_one_landmark():
    estimator = Estimator(team('r1', max_landmarks=1))
    for ms in (0, 100):
        estimator.add(odometry('r1', ms, (0.0, 0.0, 0.0)))
    # Scans of one stamp from two sensors, which are one scan of the step.
    for seen in ([(5, (3.0, 3.0))], [(5, (3.01, 3.0)), (6, (2.0, 2.0))]):
        estimator.add(scan('r1', 100, seen))
    list(estimator.close())

    assert [landmark.id for landmark in estimator.landmarks()] == [5]
    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.MAP_FULL: 1}
    assert estimator.statistics.observations_used['r1'] == 2


def test_a_scan_without_ids_starts_a_limited_number_of_landmarks():
    estimator = Estimator(team('r1'))
    seen = [(NO_ID, (float(k % 20), float(k // 20))) for k in range(120)]
    for ms, some in ((0, [(7, (1.0, -9.0))]), (100, seen)):
        estimator.add(odometry('r1', ms, (0.0, 0.0, 0.0)))
        estimator.add(scan('r1', ms, some))
    list(estimator.close())

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.TOO_MANY_NEW: 20}
    assert len(estimator.groups.team.state.landmarks) == 1 + MAX_NEW_WITHOUT_ID, MIN_ROOM


def test_landmarks_that_an_ending_process_does_not_start_are_counted():
    estimator = Estimator(team('r1'))
    for ms, seen in ((0, row_of(2)), (100, row_of(6))):
        estimator.add(odometry('r1', ms, (0.0, 0.0, 0.0)))
        estimator.add(scan('r1', ms, seen))
    steps = estimator.release()
    next(steps)

    with between_pieces(lambda: None, lambda: len(estimator.groups.team.state.landmarks) == 4):
        next(steps)

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.INTERRUPTED: 2}
    assert [r.id for r in estimator.statistics.rejections] == [4, 5]
    assert estimator.statistics.observations_used['r1'] == 2 + 4


def test_a_pose_that_arrives_after_its_step_depends_on_arrival_and_says_so():
    hashes, depends = set(), []
    for is_late in (False, True):
        estimator = Estimator(team('r1', anchor_sigma=(0.1, 0.1, 0.1)))
        for ms in range(0, 600, 100):
            estimator.add(odometry('r1', ms))
        if is_late:
            assert [result.stamp // MS for result in estimator.take()] == [0, 100, 200, 300]
        estimator.add(PosePrior('r1', 300 * MS, np.array([5.0, 1.0, 0.0]), 0.01 * np.eye(3)))
        list(estimator.close())
        hashes.add(estimator.state_hash())
        depends.append(estimator.statistics.depends_on_arrival())

    assert len(hashes) == 2
    assert depends == [False, True]


def test_a_pose_of_a_step_that_is_still_to_come_depends_on_no_arrival():
    estimator = Estimator(team('r1'))
    for ms in range(0, 600, 100):
        estimator.add(odometry('r1', ms))
    list(estimator.take())
    for _ in range(2):
        estimator.add(PosePrior('r1', 300 * MS + 1, np.zeros(3), np.eye(3)))

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.DUPLICATE: 1}
    assert not estimator.statistics.depends_on_arrival()


def test_observations_that_an_ending_process_leaves_out_are_counted(monkeypatch):
    for name in ('MAX_JOINT_OBSERVATIONS', 'MAX_BLOCK_OBSERVATIONS', 'MIN_BLOCK_OBSERVATIONS'):
        monkeypatch.setattr(joint_update, name, 2)
    estimator = Estimator(team('r1'))
    for ms in (0, 100):
        estimator.add(odometry('r1', ms, (0.0, 0.0, 0.0)))
        estimator.add(scan('r1', ms, row_of(6)))
    steps = estimator.release()
    next(steps)

    # The step begins before the end of the process is due.
    ends = iter([False])
    with between_pieces(lambda: None, lambda: next(ends, True)):
        next(steps)

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.INTERRUPTED: 4}
    assert [r.id for r in estimator.statistics.rejections] == [2, 3, 4, 5]
    assert estimator.statistics.observations_used['r1'] == 6 + 2


def test_a_robot_that_step_0_restarts_maps_at_once_whatever_its_former_pose_contradicted():
    points = {11: (3.0, 1.0), 12: (4.0, -1.0), 13: (2.0, 3.0), 14: (5.0, 2.0), 15: (-3.0, 1.0)}
    # r2 starts with a heading that is too uncertain to be linearised.
    estimator = Estimator(team(known=[('r2', (0.0, 5.0, 0.0), (0.1, 0.1, 1.5))]))
    for k in range(12):
        for robot in 'r1', 'r2':
            estimator.add(odometry(robot, 100 * k, pose=[0.0, 0.0, 0.0]))
        if 1 <= k <= 6:
            estimator.add(scan('r2', 100 * k, [*points.items()]))
        if 7 <= k <= 8:  # scans that fail the gate
            estimator.add(scan('r2', 100 * k, [
                (landmark, (x + 3.0, y - 4.0)) for landmark, (x, y) in points.items()]))
        if k == 9:  # step 0
            estimator.add(scan('r1', 900, [(50, (1.0, 1.0))]))
        if k == 10:
            estimator.add(scan('r2', 1000, [
                (landmark + 20, point) for landmark, point in points.items()]))
    for _ in estimator.close():
        pass

    assert estimator.groups.of('r2') is not estimator.groups.team
    mapped = {landmark for _, landmark in estimator.groups.of('r2').state.landmarks}
    assert mapped == {landmark + 20 for landmark in points}
    assert estimator.statistics.total(RejectionReason.LOST_ROBOT) == 0


def test_the_nis_of_a_robot_that_returns_to_the_team_goes_on():
    options = team()
    estimator = Estimator(options)
    for ms in (0, 100):
        for name in ('r1', 'r2'):
            estimator.add(odometry(name, ms, (0.0, 0.0, 0.0)))
            estimator.add(scan(name, ms, BY_ANCHOR))
    list(estimator.close())
    dof = estimator.innovations.nis['r2'].dof

    estimator.change_team(options.robots[:1])
    estimator.change_team(options.robots)

    assert dof > 0
    assert estimator.innovations.nis['r2'].dof == dof


def test_a_robot_that_step_0_leaves_as_uncertain_as_the_anchor_stays_in_map():
    options = team(
        known=[('r2', R2_POSE, (5.0, 5.0, 1.0))], anchor_pose=ANCHOR_POSE,
        anchor_sigma=(0.1, 0.1, 1.0))

    estimator, results = run(
        options, *both(0), scan('r1', 0, BY_ANCHOR), scan('r2', 0, BY_R2))

    # Beyond the 0.3 rad that are linearised.
    assert estimator.pose('r2').P[2, 2] > 0.3**2
    assert frames_of('r2', results) == {0: 'map'}
    assert not estimator.statistics.restart_reasons
