# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A gross outlier alone is rejected, with its distance; correct observations pass."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.stats import binom, chi2

from fej_slam_ros.core.ekf.covariance import Slot
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import (
    Association, Gate, InflatingGate, RobotAssociation, scan_gate_statistics, ScanGateStatistics)
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.records import Observation, RobotObservation, Scan
from fej_slam_ros.core.rejections import RejectionReason
from helpers.core import central_differences, circles, estimate, SmallTeam, turn

GROSS = np.array([5.0, -3.0])


def spoilt(scan, number, error=GROSS):
    """Return the scan with one observation far off."""
    return replace(scan, observations=tuple(
        replace(s, z=s.z + error) if s.id == number else s for s in scan.observations))


def without(scan, number):
    return replace(scan, observations=tuple(s for s in scan.observations if s.id != number))


def scans(errors, seed=5):
    """Return what a gate is given of observations with errors, by robot."""
    rng = np.random.default_rng(seed)
    robots = [Robot(name, None, 0) for name in errors for _ in errors[name]]
    A = rng.normal(size=(len(robots), 2, 8))
    R = np.array([[0.04, 0.01], [0.01, 0.02]])
    S = 0.01 * A @ A.transpose(0, 2, 1) + R
    observations = [
        Association(robot, Landmark(('', k), Slot(0, 2), '', 0), Observation(k, np.zeros(2), R))
        for k, robot in enumerate(robots)]
    return observations, np.array([[e, -0.3 * e] for some in errors.values() for e in some]), S


def on_no_arc(r):
    """Return distances of m innovations that fit no error on an arc."""
    return lambda: np.full(len(r), np.inf)


def numbers(associations):
    return [a.observation.id for a in associations]


@pytest.mark.parametrize('probability', [0.5, 0.9, 0.999])
def test_correct_observations_pass_with_the_configured_probability(probability):
    rng, m = np.random.default_rng(1), 5000
    S = np.array([[2.0, 0.8], [0.8, 1.0]])
    r = rng.multivariate_normal(np.zeros(2), S, size=m)
    observations, _, _ = scans({f'r{k}': [0.0] for k in range(m)})

    gated = Gate(probability).apply(observations, r, np.tile(S, (m, 1, 1)), on_no_arc(r))

    low, high = binom.interval(0.9999, m, probability)
    assert low <= len(gated.accepted) <= high


def test_each_observation_is_tested_by_its_own_covariance():
    rng = np.random.default_rng(2)
    A, r = rng.normal(size=(3, 2, 2)), rng.normal(size=(3, 2))
    S = A @ A.transpose(0, 2, 1)
    observations, _, _ = scans({'r1': [0.0], 'r2': [0.0], 'r3': [0.0]})

    gated = Gate(0.1).apply(observations, r, S, on_no_arc(r))

    alone = np.array([r[k] @ np.linalg.inv(S[k]) @ r[k] for k in range(3)])
    fails = alone > chi2.ppf(0.1, 2)
    assert numbers(gated.accepted) == np.flatnonzero(~fails).tolist()
    assert fails.tolist() == [True, False, True]
    assert_allclose([g.d2 for g in gated.rejected], alone[fails], rtol=1e-9)


def before_the_last_scan(kind='fej'):
    """Return a filter with a gate, and what its two robots are about to see of four landmarks."""
    team = SmallTeam(seed=3, landmarks=4)
    filter_ = team.start(kind)
    for stamp in (1, 2):
        team.step(filter_, stamp, team.names, team.names)
    team.step(filter_, 3, team.names, [])
    filter_.gate = Gate(0.999)
    return filter_, team.look('r1'), team.look('r2')


def test_an_outlier_is_rejected_and_the_rest_is_used():
    filter_, scan_1, scan_2 = before_the_last_scan()
    clean, *_ = before_the_last_scan()

    innovation = filter_.step([], [scan_1, spoilt(scan_2, 2)])
    clean.step([], [scan_1, without(scan_2, 2)])

    rejected = [
        (g.association.observer.name, g.association.observation.id) for g in innovation.rejected]
    assert rejected == [('r2', 2)]
    assert {name: len(values) for name, values in innovation.nis().items()} == {'r1': 4, 'r2': 3}
    assert_array_equal(filter_.state.x_hat, clean.state.x_hat)
    P, clean_P = (
        f.state.marginal([*f.state.robots.values(), *f.state.landmarks.values()])
        for f in (filter_, clean))
    assert_array_equal(P, clean_P)


@pytest.mark.parametrize(('failed', 'count'), [
    ([False, False], 0), ([True, False], 0), ([True, True], 1), ([True, True, False], 1)])
def test_a_landmark_that_several_sensors_observe_counts_once_in_a_scan(failed, count):
    robot = Robot('r1', Slot(0, 3), 0)
    moved, other = (Landmark(('', k), Slot(0, 2), 'r1', 0) for k in (1, 2))
    results = [(Association(robot, moved, None), has_failed, has_failed) for has_failed in failed]

    found = scan_gate_statistics([*results, (Association(robot, other, None), False, False)])

    assert found == {'r1': ScanGateStatistics(
        known=2, failed=count, trusted=2, trusted_failed=count, gated=count, trusted_gated=count)}


def test_a_rejected_observation_has_its_distance_and_the_threshold():
    filter_, _, scan = before_the_last_scan('standard')
    state = filter_.state
    variables = [state.robots['r2'], state.landmarks['', 2]]
    at = np.concatenate([state.estimate(variable) for variable in variables])
    P = state.marginal(variables)

    gated, = filter_.step([], [spoilt(scan, 2)]).rejected

    def h(v):
        return turn(v[2]).T @ (v[3:] - v[:2])

    H, s = central_differences(h, at), gated.association.observation
    r = s.z - h(at)
    assert_allclose(gated.d2, r @ np.linalg.inv(H @ P @ H.T + s.R) @ r, rtol=1e-7)
    assert_allclose(gated.threshold, chi2.ppf(0.999, 2), rtol=1e-12)


def test_with_probability_1_all_observations_pass():
    filter_, scan, _ = before_the_last_scan()
    filter_.gate = Gate(1.0)

    innovation = filter_.step([], [spoilt(scan, 0)])

    assert not innovation.rejected
    assert sum(innovation.nis()['r1']) > 1000.0


def test_a_scan_that_is_rejected_completely_changes_nothing():
    filter_, scan, _ = before_the_last_scan()
    before = filter_.state.x_hat.copy()

    innovation = filter_.step([], [spoilt(replace(scan, observations=scan.observations[:1]), 0)])

    assert len(innovation.rejected) == 1
    assert innovation.nis() == {}
    assert_array_equal(filter_.state.x_hat, before)


def test_the_estimator_reports_each_rejected_observation():
    records = circles(seed=4)
    place, scan = [
        (k, record) for k, record in enumerate(records)
        if isinstance(record, Scan) and record.robot == 'r2' and record.observations][-1]
    number = scan.observations[0].id
    records[place] = spoilt(scan, number, error=10.0 * GROSS)

    estimator, _ = estimate(records)

    rejection = estimator.statistics.rejections[-1]
    reported = rejection.robot, rejection.stamp, rejection.reason, rejection.id
    assert reported == ('r2', scan.stamp, RejectionReason.GATED, number)
    assert rejection.d2 > rejection.threshold == pytest.approx(chi2.ppf(0.999, 2))


def test_noise_of_a_rejected_scan_is_inflated_to_the_median_of_chi_square():
    observations, r, S = scans({'r1': [0.1, 9.0], 'r2': [3.0, 2.8, 3.3, 0.1, 60.0]})

    gated = InflatingGate(0.999).apply(observations, r, S, on_no_arc(r))

    scale = gated.accepted[-1].observation.R[0, 0] / observations[0].observation.R[0, 0]
    d2 = []
    for k in range(2, 7):
        block = S[k] + (scale - 1.0) * observations[k].observation.R
        d2.append(r[k] @ np.linalg.inv(block) @ r[k])
    assert np.median(d2) == pytest.approx(chi2.median(2), rel=1e-6)
    assert numbers(gated.accepted) == [0, 2, 3, 4, 5]
    assert numbers(g.association for g in gated.inflated) == [2, 3, 4]
    assert numbers(g.association for g in gated.rejected) == [1, 6]


@pytest.mark.parametrize(('d2_of_threshold', 'is_used'), [(100.0, True), (102.0, False)])
def test_an_inflated_scan_is_gated_by_its_inflated_covariance(d2_of_threshold, is_used):
    # Prior and noise have the covariance I. Three observations at 101 medians need the noise
    # 100 I: the fourth has the covariance 101 I, and passes up to 101 thresholds.
    x = np.sqrt([*3 * [101.0 * chi2.median(2)], d2_of_threshold * chi2.ppf(0.999, 2), 1e9])
    observations, _, _ = scans({'r1': x})
    observations = [
        a._replace(observation=replace(a.observation, R=np.eye(2))) for a in observations]

    gated = InflatingGate(0.999).apply(
        observations, np.column_stack([x, np.zeros(5)]), np.tile(2.0 * np.eye(2), (5, 1, 1)),
        on_no_arc(x))

    assert numbers(gated.accepted) == [0, 1, 2, 3][:3 + is_used]


@pytest.mark.parametrize('errors', [
    {'r1': [0.1, 9.0, 9.0, 0.1]}, {'r1': [9.0, 9.0]}, {'r1': [9.0, 9.0], 'r2': [9.0, 0.1, 0.1]}])
def test_half_a_scan_or_fewer_than_three_observations_are_not_inflated(errors):
    observations, r, S = scans(errors)

    first, second = (
        gate(0.999).apply(observations, r, S, on_no_arc(r)) for gate in (Gate, InflatingGate))

    assert second.accepted == first.accepted
    assert numbers(g.association for g in second.rejected) == numbers(
        g.association for g in first.rejected)
    assert not second.inflated


def test_inflated_observations_correct_the_filter_less_than_their_innovation():
    filter_, _, scan = before_the_last_scan()
    off = replace(scan, observations=tuple(replace(s, z=s.z + GROSS) for s in scan.observations))
    start = filter_.state.x_hat.copy()
    filter_.gate = InflatingGate(0.999)

    innovation = filter_.step([], [off])

    moved = np.linalg.norm((filter_.state.x_hat - start)[filter_.state.robots['r2'].slot.indices])
    assert len(innovation.inflated) == len(scan.observations)
    assert 0.0 < moved < 0.5 * np.linalg.norm(GROSS)


def test_of_a_scan_that_mostly_fails_nothing_is_used_nor_the_robot_by_others():
    state = JointState()
    r1, r2 = (state.insert_robot(name, 0, np.zeros(3), 0.01 * np.eye(3)) for name in ('r1', 'r2'))
    landmarks = [
        state.augment(('', k), r1, np.array([k, 1.0]), np.eye(2, 3), 0.01 * np.eye(2))
        for k in range(4)]

    def of_landmark(robot, k, error=0.0):
        z = np.array([k + error, 1.0])
        return Association(robot, landmarks[k], Observation(k, z, 0.01 * np.eye(2)))

    of_robot = RobotAssociation(
        r2, r1, RobotObservation('r1', np.zeros(2), 0.01 * np.eye(2)))
    right = [of_landmark(r2, k) for k in range(3)]
    wrong = [of_landmark(r1, k, error=9.0) for k in range(3)]
    filter_ = Filter(state, FirstEstimates(), Gate(0.999))

    innovation = filter_.update([*right, *wrong, of_landmark(r1, 3), of_robot])

    assert innovation.used == right
    passed = [g.association for g in innovation.rejected if g.passed()]
    assert [a.observed for a in passed] == [landmarks[3], r1]
    assert innovation.scan_gate_statistics()['r1'].failed == 3


@pytest.mark.parametrize(('trusted', 'failed', 'suspected'), [
    # Known landmarks by whether they are trusted, and whether they fail.
    ('1111', '1110', True), ('1111', '1100', False), ('1100', '1100', True),
    ('1100', '0011', False), ('1000', '1000', False), ('0000', '1110', True), ('11', '11', False)])
def test_trusted_landmarks_decide_whether_a_pose_is_suspected(trusted, failed, suspected):
    statistics = ScanGateStatistics()
    for k, (is_trusted, has_failed) in enumerate(zip(trusted, failed)):
        landmark = Landmark(('', k), Slot(0, 2), 'r1', 0, is_trusted=is_trusted == '1')
        statistics.add('r1', landmark, has_failed == '1', True)

    assert statistics.mostly_failed() == suspected


def test_untrusted_landmarks_of_other_robots_do_not_count_for_a_pose():
    statistics = ScanGateStatistics()
    for k in range(3):
        statistics.add('r1', Landmark(('', k), Slot(0, 2), 'r2', 0, is_trusted=False), True, True)

    assert statistics == ScanGateStatistics()


@pytest.mark.parametrize(('known', 'trusted', 'clears'), [
    (3, 0, True), (2, 2, True), (2, 1, False), (2, 0, False)])
def test_three_known_or_two_trusted_landmarks_can_clear_a_suspected_robot(known, trusted, clears):
    assert ScanGateStatistics(known, trusted=trusted).can_clear() is clears


@pytest.mark.parametrize(('trusted', 'gated', 'confirmed'), [
    (2, 0, True), (3, 1, True), (2, 1, False), (1, 0, False)])
def test_most_of_at_least_two_trusted_landmarks_confirm_a_pose(trusted, gated, confirmed):
    """Before, landmarks that failed the gate without a contradiction confirmed it, too."""
    scan = ScanGateStatistics(trusted, trusted=trusted, gated=gated, trusted_gated=gated)

    assert scan.confirms_pose() is confirmed
