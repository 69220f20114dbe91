# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of lost robots, without false alarms."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.calibration.innovation_windows import InnovationWindows
from fej_slam_ros.core.data_association.failure_detection import (
    LostRobotDetector, ScanMatchStatistics)
from fej_slam_ros.core.ekf.covariance import Slot
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, GatedObservation, ScanGateStatistics
from fej_slam_ros.core.ekf.state import Landmark, Robot
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import NS, Odometry, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.core.snapshot import restore, snapshot
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, estimate
from helpers.moved_landmarks import drive, SECOND_LOOP, with_moved
from helpers.records import without_ids
from helpers.slow import slow

TEAM = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1')


def carried(records, robot, since, until):
    """Carry a robot along a part of its path without a change of its wheel odometry."""
    odometry = {r.stamp: r.pose for r in records if isinstance(r, Odometry) and r.robot == robot}

    def shifted(record):
        on = between(odometry[until], record.pose) if record.stamp > until else np.zeros(3)
        return replace(record, pose=compose(odometry[since], on))

    return [
        shifted(r) if isinstance(r, Odometry) and r.robot == robot and r.stamp > since else r
        for r in records]


def position_error(records, results, robot):
    """Return how far a robot is from where it really is, at the end."""
    truth = {r.stamp: r.pose for r in records if isinstance(r, TruePose) and r.robot == robot}
    last = [pose for result in results for pose in result.poses if pose.robot == robot][-1]
    return np.linalg.norm(last.pose[:2] - truth[last.stamp][:2])


@pytest.mark.parametrize('seed', range(10))
def test_in_a_consistent_run_no_landmark_or_robot_is_suspected(seed):
    estimator, _ = estimate(drive(seed))

    assert estimator.statistics.total(RejectionReason.GATED) > 0
    assert estimator.statistics.total(RejectionReason.MOVED_LANDMARK) == 0
    assert not estimator.innovations.lost_robots.reason('r1')
    assert not estimator.innovations.lost_robots.reason('r2')


def test_a_robot_is_ambiguous_after_five_scans_and_fifteen_observations_until_one_is_used():
    lost, observations = LostRobotDetector(), []
    for doubtful, used in [(4, 0), (4, 0), (4, 1), *[(4, 0)] * 3, (0, 0), (2, 0), (2, 0), (1, 3)]:
        lost.add_matches('r1', ScanMatchStatistics(used, doubtful))
        observations.append(lost.ambiguous('r1'))

    assert observations == [0, 0, 0, 0, 0, 0, 0, 0, 16, 0]


@pytest.mark.parametrize(('scan', 'suspected'), [
    (ScanMatchStatistics(elsewhere=3, expected=3, missed=3), True),
    (ScanMatchStatistics(used=1, elsewhere=4, expected=5, missed=4), True),
    (ScanMatchStatistics(used=2, elsewhere=4, expected=5, missed=3), False),
    # Hidden landmarks: it observes nothing else instead.
    (ScanMatchStatistics(elsewhere=2, expected=9, missed=9), False),
    # Unknown ground.
    (ScanMatchStatistics(elsewhere=9, expected=2, missed=2), False)])
def test_a_robot_that_observes_others_than_it_should_is_suspected(scan, suspected):
    lost = LostRobotDetector()

    lost.add_matches('r1', scan)
    # That it fits the landmarks which it has just started itself does not clear it.
    lost.add({'r1': ScanGateStatistics(known=5, failed=0)})

    assert lost.is_suspected('r1') is suspected


@pytest.mark.parametrize('seed', [0, slow(1), slow(2)])
def test_a_carried_robot_comes_back_by_landmarks_without_ids(seed):
    """Before, it mapped the same landmarks a second time, metres beside the first."""
    records = circles(seed, 1, landmarks=60, loops=4, sensors=SensorSettings(
        (0.1, 0.1, np.radians(1.0)), (0.15, 0.15)))
    stamps = sorted(r.stamp for r in records if isinstance(r, Odometry))
    start = next(r.pose for r in records if isinstance(r, TruePose))
    records = carried(without_ids(records), 'r1', stamps[150], stamps[156])

    estimator, results = estimate(records, ['r1'], anchor_pose=tuple(start.tolist()))

    assert set(estimator.groups.team.robots) == {'r1'}
    # A tenth of what it was carried.
    assert position_error(records, results, 'r1') < 1.6
    assert estimator.statistics.restart_reasons['r1'].startswith('likely lost')


def test_a_robot_is_lost_after_three_failed_scans_until_one_passes():
    lost = LostRobotDetector()
    reasons = []
    for known, failed in [(4, 3), (3, 2), (9, 4), (4, 3), (3, 2), (2, 2), (3, 3), (5, 4), (2, 0),
                          (4, 2)]:
        lost.add({'r1': ScanGateStatistics(known, failed)})
        reasons.append(lost.reason('r1'))

    # Scans of two known landmarks do not count; half a scan has passed.
    assert reasons == [
        *[None] * 6, '8 of 10 observations gated in a row',
        *['9 of 11 observations gated in a row'] * 2,
        None]


def test_a_slip_of_wheels_is_over_after_two_scans_in_a_row():
    lost = LostRobotDetector()

    def may_have_slipped(scans):
        for scan in scans:
            gated = 3 if scan == '1' else 0
            lost.add({'r1': ScanGateStatistics(known=4, gated=gated)})
        return lost.may_have_slipped('r1')

    assert may_have_slipped('11')
    assert not may_have_slipped('1')
    assert not may_have_slipped('0001')
    # Too few landmarks to tell.
    lost.add({'r1': ScanGateStatistics(known=1, gated=1)})
    assert may_have_slipped('0')
    # Two scans that pass make up for one that fails.
    assert lost.is_suspected('r1')
    assert may_have_slipped('0000')
    assert not lost.is_suspected('r1')


def test_after_ten_inconclusive_scans_a_robot_maps_again():
    for scan in ScanGateStatistics(known=4, failed=4, gated=4), ScanGateStatistics(4, gated=4):
        lost = LostRobotDetector()
        lost.add({'r1': scan})

        for _ in range(9):
            lost.add_inconclusive('r1')
        assert lost.is_suspected('r1')
        lost.add_inconclusive('r1')
        assert not lost.is_suspected('r1')


def test_a_robot_on_probation_shows_by_itself_that_its_scans_fit():
    lost = LostRobotDetector()
    lost.mark_lost('r1')

    lost.add({'r1': ScanGateStatistics(known=4, gated=3)})

    assert not lost.may_have_slipped('r1')


def test_a_lost_robot_remains_unjoined_after_100_scans_beyond_its_probation():
    lost = LostRobotDetector()
    lost.mark_lost('r1')
    fits = ScanGateStatistics(known=4)

    for _ in range(20 + 99):
        lost.add({'r1': fits})
    assert not lost.remains_unjoined('r1')
    lost.add({'r1': fits})
    assert lost.remains_unjoined('r1')
    lost.mark_lost('r1')
    assert not lost.remains_unjoined('r1')
    assert not lost.remains_unjoined('r2')


def test_others_contradict_a_pose_only_if_landmarks_confirm_theirs_and_not_this_one():
    confirmed, contradicted = (
        ScanGateStatistics(known=4, trusted=4, gated=k, trusted_gated=k) for k in (0, 3))

    def contradictions(r1, r2, passed=()):
        lost = LostRobotDetector()
        lost.add({'r1': r1} if r2 is None else {'r1': r1, 'r2': r2})
        for k in range(12):
            lost.by_others.add('r1', 'r2', contradicts=k not in passed)
        return lost.by_others.count('r2')

    assert contradictions(confirmed, None) == 12
    assert contradictions(confirmed, contradicted) == 12
    assert contradictions(confirmed, confirmed) == 0
    assert contradictions(contradicted, None) == 0
    # Eight in a row are not enough.
    assert contradictions(confirmed, None, passed=[3]) == 0
    assert contradictions(confirmed, None, passed=[2]) == 9


def test_scans_of_a_pose_that_was_left_neither_confirm_nor_protect_it():
    confirmed = ScanGateStatistics(known=4, trusted=4)
    lost = LostRobotDetector()
    lost.add({'r1': confirmed, 'r2': confirmed})
    lost.reset('r1')

    for _ in range(9):
        lost.by_others.add('r1', 'r2', contradicts=True)
        lost.by_others.add('r2', 'r1', contradicts=True)

    # r1 has seen no landmark since, and may be wrong itself; r2 has.
    assert (lost.by_others.count('r2'), lost.by_others.count('r1')) == (0, 9)


def test_a_lost_robot_that_restarts_begins_its_probation_again():
    lost = LostRobotDetector()
    lost.mark_lost('r1')
    for _ in range(18):
        lost.add({'r1': ScanGateStatistics(known=4)})

    lost.begin_frame('r1')
    lost.begin_frame('r2')

    assert lost.on_probation() == {
        'r1': 'it was lost: 20 more scans must fit the map of its own frame'}


@pytest.fixture(scope='module')
def kidnapping():
    """Return a run in which r1 is carried three metres on its second loop."""
    return carried(drive(3), 'r1', 22 * NS, 22 * NS + 8 * NS // 10)


def test_a_kidnapped_robot_is_reported_lost_and_restarts_in_its_own_frame(kidnapping):
    upto = [record for record in kidnapping if record.stamp <= 24 * NS]

    estimator, results = estimate(upto)

    assert 'gated in a row' in estimator.innovations.lost_robots.reason('r1')
    assert not estimator.innovations.lost_robots.reason('r2')
    assert {pose.robot: pose.frame for pose in results[-1].poses} == {'r1': 'r1/map', 'r2': 'map'}
    assert estimator.statistics.restart_reasons['r1'].startswith('likely lost, ')
    assert 'more scans must fit the map of its own frame' in estimator.groups.not_in_map['r1']


def test_a_kidnapped_robot_restarts_also_where_innovations_are_summed_over_windows(kidnapping):
    estimator = Estimator(TEAM, innovations=InnovationWindows())

    steps = [*estimator.run(record for record in kidnapping if record.stamp <= 24 * NS)]

    assert steps[-1].stamp == 24 * NS
    assert estimator.statistics.restart_reasons['r1'].startswith('likely lost, ')


def test_a_kidnapped_robot_joins_again(kidnapping):
    estimator, results = estimate([r for r in kidnapping if r.stamp <= 32 * NS])

    assert estimator.innovations.lost_robots.reason('r1') is None
    assert estimator.groups.team.robots.keys() == {'r1', 'r2'}
    assert position_error(kidnapping, results, 'r1') < 0.5


def test_a_robot_that_was_lost_is_on_probation_until_20_scans_in_a_row_fit():
    lost = LostRobotDetector()

    def add(failed, count=1):
        for _ in range(count):
            lost.add({'r1': ScanGateStatistics(4, failed)})

    add(4, 3)
    assert lost.must_restart('r1')
    lost.mark_lost('r1')
    lost.begin_frame('r1')
    add(0, 19)
    assert lost.on_probation() == {
        'r1': 'it was lost: 1 more scans must fit the map of its own frame'}
    add(4)
    add(0, 19)
    # Neither of these fits: without known landmarks, and of too few to tell a wrong pose.
    lost.add({'r1': ScanGateStatistics()})
    lost.add({'r1': ScanGateStatistics(2, 2, gated=2)})
    assert lost.on_probation()
    add(0)

    assert not lost.on_probation()
    assert lost.reason('r1') == '12 of 12 observations gated in a row'
    lost.mark_found({'r1'})
    assert lost.reason('r1') is None


def test_a_kidnapped_robot_recovers_by_inflated_scans(kidnapping):
    upto = [record for record in kidnapping if record.stamp <= 32 * NS]

    estimator, results = estimate(upto, inflate_rejected_scans=True)

    assert not estimator.innovations.lost_robots.reason('r1')
    assert estimator.groups.moved_landmarks() == []
    assert estimator.statistics.observations_inflated.keys() == {'r1'}
    error = position_error(upto, results, 'r1')
    last = [pose for result in results for pose in result.poses if pose.robot == 'r1'][-1]
    assert error < 0.5
    # Four sigma.
    assert error < 4.0 * np.sqrt(np.linalg.eigvalsh(last.P[:2, :2])[-1])


def test_inflation_that_is_not_needed_changes_no_bit():
    records = drive(4)

    plain, _ = estimate(records)
    estimator, _ = estimate(records, inflate_rejected_scans=True, moved_landmarks='forget')

    assert plain.statistics.total(RejectionReason.GATED) > 0
    assert estimator.statistics.observations_inflated.total() == 0
    assert estimator.state_hash() == plain.state_hash()


def test_failure_evidence_survives_a_checkpoint(kidnapping):
    records = with_moved(kidnapping, 5, SECOND_LOOP)
    settings = replace(TEAM, moved_landmarks='forget', inflate_rejected_scans=True)
    expected, _ = estimate(records, moved_landmarks='forget', inflate_rejected_scans=True)
    estimator = Estimator(settings)

    for k, record in enumerate(records):
        estimator.add(record)
        list(estimator.take())
        if k % 97 == 0:
            estimator = restore(snapshot(estimator), settings, Estimator)
    list(estimator.close())

    assert expected.statistics.total(RejectionReason.MOVED_LANDMARK) > 0
    assert estimator.state_hash() == expected.state_hash()
    assert estimator.statistics.rejection_counts == expected.statistics.rejection_counts


def test_inconclusive_scans_count_from_the_last_one_that_failed():
    lost = LostRobotDetector()
    for _ in range(2):
        lost.add({'r1': ScanGateStatistics(known=4, failed=4)})
        for _ in range(9):
            lost.add_inconclusive('r1')

    assert lost.is_suspected('r1')


def test_observations_that_failed_do_not_concern_the_pose_of_a_robot_that_restarts():
    lost, robot = LostRobotDetector(), Robot('r1', Slot(0, 3), 0)
    for k in (0, 1, 0):
        association = Association(robot, Landmark(('', k), Slot(0, 2), 'r2', 0), None)
        lost.rejections.add(
            Innovation((), np.empty(0), [GatedObservation(association, 20.0, 13.8, np.inf)]),
            {'r1': ScanGateStatistics(known=1, gated=1)})
    assert lost.rejections.count('r1') == 3

    lost.begin_frame('r1')

    assert lost.rejections.count('r1') == 0
