# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that may be lost changes nothing that it shares, and comes back by itself."""

import numpy as np
import pytest

from fej_slam_ros.core.records import Odometry, PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from helpers.core import estimate
from helpers.records import MS, odometry, robot_scan, scan

VIEW = [(1, (5.0, 1.0)), (2, (4.0, -3.0)), (3, (-2.0, 3.0)), (4, (3.0, 4.0))]
#: What r2 observes 20 m ahead, and a landmark that was not observed before.
SHIFTED = [(k, (x - 20.0, y)) for k, (x, y) in VIEW]
NEW = (9, (1.0, 1.0))
AT_REST = np.diag([1e-4, 1e-4, 1e-4])
#: Twist covariance of a poor gyroscope: 0.05 rad in each 0.1 s.
DRIFTING = np.diag([1e-4, 1e-4, 0.25])


def standing(views, jumps=(), others=(), twist_covariance=AT_REST):
    """Return the records of r1 and r2, which stand; r2 has a view and odometry at each 0.1 s."""
    records = []
    for k, view in enumerate(views):
        x = sum(jump for when, jump in jumps if when <= k)
        records += [
            odometry('r1', 100 * k, (0.0, 0.0, 0.0), AT_REST), scan('r1', 100 * k, VIEW),
            odometry('r2', 100 * k, (x, 0.0, 0.0), twist_covariance), scan('r2', 100 * k, view)]
        records += [robot_scan('r2', 100 * k, [('r1', (0.0, 0.0))])] if k in others else []
    return records


def frames(results):
    """Return the frames of r2 at all stamps."""
    return [pose.frame for result in results for pose in result.poses if pose.robot == 'r2']


def test_a_lost_robot_starts_no_landmarks_and_joins_again_after_its_probation():
    estimator, results = estimate(standing([*[VIEW] * 5, *[[*SHIFTED, NEW]] * 30]))

    assert frames(results) == [*['map'] * 7, *['r2/map'] * 21, *['map'] * 7]
    x, y, _ = estimator.pose('r2').pose
    assert (x, y) == pytest.approx((20.0, 0.0), abs=0.1)
    # Started by its own map, where it really is.
    positions = {f.id: f.position for f in estimator.landmarks()}
    np.testing.assert_allclose(positions[9], [21.0, 1.0], atol=0.2)
    for k, z in VIEW:
        np.testing.assert_allclose(positions[k], z, atol=0.1)
    # Of the landmark that it was not to start, too.
    assert estimator.statistics.rejection_counts['r2'] == {
        RejectionReason.GATED: 3 * len(VIEW), RejectionReason.LOST_ROBOT: 3}


def test_a_robot_whose_observations_fit_again_stays_in_map():
    estimator, results = estimate(standing([*[VIEW] * 5, *[SHIFTED] * 2, *[VIEW] * 5]))

    assert set(frames(results)) == {'map'}
    assert not estimator.statistics.relocalized


def test_two_trusted_landmarks_that_fit_end_a_suspicion():
    few = VIEW[:2]

    estimator, _ = estimate(standing([*[VIEW] * 5, SHIFTED, [*few, NEW], [*few, NEW]]))

    assert estimator.statistics.rejection_counts['r2'] == {
        RejectionReason.GATED: len(SHIFTED), RejectionReason.LOST_ROBOT: 1}
    assert 9 in {f.id for f in estimator.landmarks()}


def one_by_one(landmarks, distance):
    """Return what r2 sees from a distance ahead, one landmark at a time, in turn."""
    return [[(k, (x - distance, y))] for k, (x, y) in landmarks] * (15 // len(landmarks))


def test_single_landmarks_correct_a_robot_a_few_standard_deviations_off():
    estimator, results = estimate(standing([*[VIEW] * 5, *one_by_one(VIEW[:3], 0.5)]))

    assert set(frames(results)) == {'map'}
    # The third is as far off as the first two, and shows that.
    assert estimator.statistics.rejection_counts['r2'] == {RejectionReason.GATED: 3}
    # Twelve observations of 0.1 m, and odometry of 1 cm in each step.
    assert estimator.pose('r2').pose[:2] == pytest.approx([0.5, 0.0], abs=0.1)


def test_single_landmarks_that_contradict_the_pose_let_a_robot_restart():
    estimator, results = estimate(standing([*[VIEW] * 5, *one_by_one(VIEW[:3], 3.0)]))

    # Nine are needed; three more start its own map with all three landmarks, by which it joins.
    assert frames(results) == [*['map'] * 13, *['r2/map'] * 3, *['map'] * 4]
    assert estimator.pose('r2').pose[:2] == pytest.approx([3.0, 0.0], abs=0.1)


def test_two_landmarks_that_contradict_a_pose_may_have_been_moved():
    _, results = estimate(standing([*[VIEW] * 5, *one_by_one(VIEW[:2], 3.0)]))

    assert set(frames(results)) == {'map'}


@pytest.mark.parametrize('known', [[], VIEW[:1]])
def test_a_suspected_robot_on_unknown_ground_maps_again_after_ten_scans(known):
    estimator, _ = estimate(standing([*[VIEW] * 5, SHIFTED, *[[*known, NEW]] * 12]))

    assert estimator.statistics.rejection_counts['r2'] == {
        RejectionReason.GATED: len(SHIFTED), RejectionReason.LOST_ROBOT: 10 * (len(known) + 1)}
    assert not estimator.innovations.lost_robots.is_suspected('r2')
    positions = {f.id: f.position for f in estimator.landmarks()}
    # Odometry between the scans, of 1 cm each, and noise of observations.
    np.testing.assert_allclose(positions[9], NEW[1], atol=0.2)


def test_scans_of_nothing_do_not_end_a_suspicion():
    estimator, _ = estimate(standing([*[VIEW] * 5, SHIFTED, *[[]] * 20]))

    assert estimator.innovations.lost_robots.is_suspected('r2')


def test_robot_observations_of_a_robot_that_may_be_lost_are_rejected():
    # Too few landmarks to tell whether it is found.
    few = SHIFTED[:2]

    estimator, _ = estimate(
        standing([*[VIEW] * 5, SHIFTED, few, few], others=[5, 6, 7]))

    rejected = {
        (r.stamp, r.observed) for r in estimator.statistics.rejections
        if r.reason is RejectionReason.LOST_ROBOT and r.observed}
    assert rejected == {(500_000_000, 'r1'), (600_000_000, 'r1'), (700_000_000, 'r1')}


def test_a_robot_that_cannot_join_again_stays_in_map():
    # Four landmarks in map are too few to join by.
    estimator, results = estimate(
        standing([*[VIEW] * 5, *[SHIFTED] * 10]), join_min_landmarks=5)

    assert set(frames(results)) == {'map'}
    assert 'gated in a row' in estimator.innovations.lost_robots.reason('r2')


def test_impossible_odometry_is_rejected_and_the_robot_joins_at_its_next_scan():
    views = [*[VIEW] * 5, *[VIEW] * 5]

    estimator, results = estimate(standing(views, jumps=[(5, 30.0)]))

    assert set(frames(results)) == {'map'}
    assert estimator.statistics.rejection_counts['r2'] == {RejectionReason.IMPOSSIBLE_MOTION: 1}
    assert estimator.statistics.restart_reasons == {'r2': 'its odometry moved 30.0 m in 0.10 s'}
    np.testing.assert_allclose(estimator.pose('r2').pose, np.zeros(3), atol=0.1)


@pytest.mark.parametrize('between', [(), (430, 460)])
def test_impossible_odometry_is_counted_once_by_its_own_stamp(between):
    """Also if scans divide its increment, whose steps have other stamps."""
    records = [
        *standing([VIEW] * 10, jumps=[(5, 30.0)]), *(scan('r2', ms, VIEW) for ms in between)]

    estimator, _ = estimate(records)

    assert [(rejection.robot, rejection.stamp, rejection.reason)
            for rejection in estimator.statistics.rejections] == [
        ('r2', 500 * MS, RejectionReason.IMPOSSIBLE_MOTION)]


@pytest.mark.parametrize(('last', 'others', 'middle', 'reasons'), [
    # sqrt(61) 0.05 rad since the last correction, more than the 0.3 rad that are linearised.
    (VIEW[:1], (), (), {'r2': 'its heading has become uncertain by 0.39 rad'}),
    ([], (65,), (), {'r2': 'its heading has become uncertain by 0.39 rad'}),
    ([NEW], (), (), {}),
    # sqrt(31) 0.05 rad before and sqrt(30) 0.05 rad after a correction.
    (VIEW, (), [scan('r2', 3500, VIEW[:1])], {}),
    (VIEW, (), [robot_scan('r2', 3500, [('r1', (0.0, 0.0))])], {}),
    (VIEW, (), [robot_scan('r1', 3500, [('r2', (0.0, 0.0))])], {})])
def test_a_robot_restarts_if_its_heading_drifted_for_long_without_correction(
        last, others, middle, reasons):
    views = [*[VIEW] * 5, *[[]] * 60, last, []]

    estimator, _ = estimate([*standing(views, (), others, DRIFTING), *middle])

    assert estimator.statistics.restart_reasons == {
        robot: f'{reason} since it was last corrected' for robot, reason in reasons.items()}


def test_a_robot_that_drifted_in_its_own_frame_and_joined_stays_in_map():
    # When it observes landmarks again, their directions are known from the first observation.
    estimator, results = estimate(
        standing([*[[]] * 60, *[VIEW] * 5], twist_covariance=DRIFTING))

    assert frames(results)[-5:] == ['map'] * 5
    assert not estimator.statistics.relocalized


def test_the_last_robot_of_a_map_stays_in_it_however_its_heading_drifted():
    records = standing([*[VIEW] * 5, *[[]] * 60, VIEW, []], twist_covariance=DRIFTING)

    estimator, results = estimate([r for r in records if r.robot == 'r2'], ['r2'], anchor='r2')

    assert set(frames(results)) == {'map'}
    assert not estimator.statistics.relocalized


def test_a_robot_that_was_lost_for_long_stays_where_a_pose_places_it():
    elsewhere = [(number + 10, z) for number, z in VIEW]
    # Observed where they are, before r2 is lost, so that its own map never fits.
    both = [*VIEW, *[(number, (x + 30.0, y)) for number, (x, y) in elsewhere]]
    views = [*[both] * 5, *[SHIFTED] * 3, *[elsewhere] * 200]
    given = PosePrior('r2', 18_000 * MS, np.array([40.0, 0.0, 0.0]), 0.01 * np.eye(3))
    records = [
        record for record in standing(views)
        if record.robot == 'r2' or isinstance(record, Odometry)]

    _, results = estimate([*records, given])

    assert frames(results)[179] != 'map'
    assert frames(results)[180:] == ['map'] * (len(views) - 180)


def test_a_robot_that_may_be_lost_maps_at_once_from_a_pose_that_is_given():
    given = PosePrior('r2', 700 * MS, np.array([20.0, 0.0, 0.0]), 0.01 * np.eye(3))

    estimator, results = estimate([given, *standing([*[VIEW] * 5, *[SHIFTED] * 2, [NEW]])])

    assert set(frames(results)) == {'map'}
    assert estimator.statistics.rejection_counts['r2'] == {
        RejectionReason.GATED: 2 * len(SHIFTED)}
    assert 9 in estimator.groups.team.prior_map().ids


def test_a_robot_that_others_observe_elsewhere_restarts_though_it_observes_nothing():
    names = ['r1', 'r2', 'r3', 'r4']
    records = [
        record for ms in range(0, 1000, 100) for name in names for record in (
            odometry(name, ms, (0.0, 0.0, 0.0), AT_REST),
            *([scan(name, ms, VIEW)] if ms < 500 else []),
            *([robot_scan(name, ms, [('r2', (3.0, 0.0))])] if ms >= 500 and name != 'r2' else []))]

    estimator, _ = estimate(records, names)

    assert estimator.statistics.restart_reasons == {
        'r2': '9 observations by and of it in a row failed the gate'}


def test_a_landmark_that_a_robot_has_mapped_from_a_wrong_pose_is_removed_when_it_restarts():
    seen_by_others = [robot_scan('r1', 100 * k, [('r2', (3.0, 0.0))]) for k in range(5, 15)]

    estimator, _ = estimate([*standing([*[VIEW] * 5, *[[NEW]] * 10]), *seen_by_others])

    assert estimator.statistics.restart_reasons == {
        'r2': '9 observations of it in a row contradict its pose'}
    assert estimator.groups.team.prior_map().ids == tuple(k for k, _ in VIEW)
