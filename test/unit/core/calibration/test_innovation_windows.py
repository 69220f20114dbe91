# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors from innovations over some seconds, where errors persist and where not."""

from dataclasses import replace
import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_innovations import (
    LAST_STEP, most_likely_scales, run, with_scans_apart)
from fej_slam_ros.core.calibration.innovation_windows import (
    InnovationWindows, Moments, scales_over_windows)
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from helpers.calibration import error, received, simulated
from helpers.records import claiming, MS, odometry, robot_scan, scan, team
from helpers.slow import slow

#: Number of messages for which an error persists, and number of messages in 5 s at 5 Hz.
LENGTH, WINDOW = 12, 25
#: Factor on the standard deviation of a sum over 5 s, for blocks of equal errors that begin at any
#: message: the covariance of two errors k messages apart is that of one times 1 - k / LENGTH.
FACTOR = math.sqrt(1.0 + 2.0 * sum(
    (1.0 - k / WINDOW) * (1.0 - k / LENGTH) for k in range(1, LENGTH)))


def errors_in_blocks(rng, sigma):
    """Yield errors of which LENGTH are equal, from any within a block on."""
    count = int(rng.integers(1, LENGTH + 1))
    while True:
        error = rng.normal(0.0, sigma)
        for _ in range(count):
            yield error
        count = LENGTH


def with_persistent_odometry_errors(records, sigma):
    """Return records with errors of odometry, stated as independent ones of the same size."""
    rng, errors, before, integrated = np.random.default_rng(0), {}, {}, {}

    def with_error(record):
        if not isinstance(record, Odometry):
            return record
        robot = record.robot
        if robot in before:
            u = between(before[robot], record.pose)
            integrated[robot] = compose(integrated[robot], u + next(errors[robot]))
        else:
            errors[robot], integrated[robot] = errors_in_blocks(rng, sigma), record.pose
        before[robot] = record.pose
        return replace(
            record, pose=integrated[robot], twist_covariance=np.diag(np.square(sigma)) / 0.2 ** 2)

    return [*map(with_error, records)]


def with_persistent_observation_errors(records, sigma):
    """Return records with errors of observations that persist for each robot and landmark."""
    rng, errors = np.random.default_rng(0), {}

    def with_errors(record):
        if not isinstance(record, Scan):
            return record
        for o in record.observations:
            errors.setdefault((record.robot, o.id), errors_in_blocks(rng, [sigma, sigma]))
        return replace(record, observations=tuple(
            replace(o, z=o.z + next(errors[record.robot, o.id]), R=sigma ** 2 * np.eye(2))
            for o in record.observations))

    return [*map(with_errors, records)]


@pytest.mark.parametrize('seed', [1, slow(2), slow(3)])
def test_factors_of_independent_errors_equal_those_of_the_simulation(seed):
    records = received(claiming(
        simulated(seed, loops=8, rate=1, robot_sigma=[0.2, 0.2]), {Scan: 2.0, RobotScan: 0.5}))

    found = scales_over_windows(team(), records, {'landmark': 1.0, 'robot': 1.0})

    assert error(found['landmark'], 0.5) < 4.0
    assert error(found['robot'], 2.0) < 4.0
    assert all(scale.is_known() for scale in found.values())


@pytest.mark.parametrize(('true', 'is_known'), [(1.0 / 200.0, True), (1e-4, False)])
def test_a_factor_beyond_the_range_of_its_parameter_is_not_determined(true, is_known):
    records = received(claiming(simulated(1, loops=2, rate=1), {Scan: 1.0 / true}))

    found = scales_over_windows(team(), records, {'landmark': 1.0})

    assert found['landmark'].is_known() == is_known


@pytest.mark.slow
def test_errors_of_odometry_that_persist_count_over_5_s():
    records = received(with_persistent_odometry_errors(
        simulated(
            1, loops=6, rate=5, odometry_sigma=[1e-6, 1e-6, 1e-6], landmark_sigma=[0.03, 0.03]),
        np.array([0.03, 0.03, 0.01])))
    kinds = ['odometry', 'landmark']

    over_5_s = most_likely_scales(team(), with_scans_apart(records), kinds)['odometry']
    single = most_likely_scales(team(), records, kinds)['odometry']

    assert over_5_s.is_known()
    assert error(over_5_s, FACTOR) < 4.0
    assert single.scale < 0.8 * FACTOR


@pytest.mark.slow
def test_errors_of_observations_that_persist_count_over_5_s_but_for_what_the_map_follows():
    records = received(with_persistent_observation_errors(
        simulated(2, loops=6, rate=5, landmark_sigma=[1e-6, 1e-6]), 0.1))

    over_5_s = scales_over_windows(team(), records, {'landmark': 1.0})['landmark']
    single = most_likely_scales(team(), records, ['landmark'])['landmark']

    assert over_5_s.is_known()
    assert 0.65 * FACTOR < over_5_s.scale < FACTOR
    assert single.scale < 0.4 * FACTOR


def test_standard_errors_of_factors_are_those_of_q_through_its_slope():
    # q of the first kind depends on the first factor, that of the second on both.
    moments = Moments(
        np.array([[1.2, 1.0], [0.8, 1.0], [1.0, 1.4], [1.0, 0.6]]), np.ones((4, 2)))
    beside = [
        moments._replace(numerators=moments.numerators * np.exp(LAST_STEP * np.array(slope)))
        for slope in ((-2.0, -1.0), (0.0, -1.0))]

    # log q scatters by 0.05 and 0.1 in two windows each, so with 0.005 and 0.02; the factors are
    # -q_1 / 2 and q_1 / 2 - q_2.
    np.testing.assert_allclose(
        moments.standard_errors(beside), np.sqrt([0.005 / 4.0, 0.005 / 4.0 + 0.02]), rtol=1e-9)


def test_scans_apart_are_one_of_each_kind_and_robot_in_the_time():
    messages = [odometry('r1', ms) for ms in range(0, 12_000, 500)]
    # Those of r1 at 0 and 5 s are empty, and the last one comes after later ones.
    scans = [record for ms in range(0, 12_000, 500) for record in (
        scan('r1', ms, [(1, (2.0, 0.0))] if ms % 5000 else []),
        robot_scan('r1', ms + 100, [('r2', (2.0, 0.0))]),
        scan('r2', ms + 250, [(1, (2.0, 0.0))]))]
    late = scan('r1', 9900, [(1, (2.0, 0.0))])

    kept = [record for record, _ in with_scans_apart(received([*messages, *scans, late]))]

    assert kept[:len(messages)] == messages
    assert [(type(record), record.robot, record.stamp // MS) for record in kept[24:]] == [
        (kind, robot, s + ms) for s in (0, 5000, 10_000)
        for kind, robot, ms in ((RobotScan, 'r1', 100), (Scan, 'r2', 250), (Scan, 'r1', 500))]


def still(*robots):
    """Return odometry of robots that stand still for 14 s, without any error."""
    return [odometry(robot, ms, (0.0, 0.0, 0.0), np.zeros((3, 3)))
            for ms in range(0, 14_001, 100) for robot in robots]


def windows_of(settings, records):
    """Return the innovations over windows of an estimator, and the estimator, after records."""
    windows = InnovationWindows()
    estimator, _ = run(
        settings, received(sorted(records, key=lambda r: r.stamp)), innovations=windows)
    return windows, estimator


def test_observations_of_a_landmark_by_two_sensors_at_one_stamp_are_summed():
    # A robot that stands still starts a landmark, and sees it again with two errors.
    windows, _ = windows_of(team('r1'), [
        *still('r1'), scan('r1', 0, [(1, (2.0, 0.0))]), scan('r1', 6000, [(1, (2.1, 0.0))]),
        scan('r1', 6000, [(1, (2.2, 0.0))])])

    # Landmark and observations have a variance of 0.01 m^2 each: of the sum of 0.3 m, that of the
    # landmark counts four times, that of the observations twice.
    numerators, denominators = windows.moments(['landmark', 'robot'])
    np.testing.assert_allclose(numerators, [[0.3 ** 2 * 0.02 / 0.06 ** 2, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(denominators, [[2.0 * 0.02 / 0.06, 0.0]], rtol=1e-9)


def test_observations_of_a_landmark_by_two_robots_are_not_summed():
    settings = team('r1', 'r2', known=[('r2', (0.0, 0.0, 0.0), (1e-7, 1e-7, 1e-7))])

    windows, _ = windows_of(settings, [
        *still('r1', 'r2'), scan('r1', 0, [(1, (2.0, 0.0))]),
        scan('r1', 6000, [(1, (2.1, 0.0))]), scan('r2', 6000, [(1, (2.2, 0.0))])])

    # V is 0.02 m^2 for each, with 0.01 m^2 in common: V^-1 e is (0, 10), tr V^-1 is 400 / 3.
    numerators, denominators = windows.moments(['landmark'])
    np.testing.assert_allclose(numerators, [[0.01 * 10.0 ** 2]], rtol=1e-6)
    np.testing.assert_allclose(denominators, [[2.0 * 0.01 * 400.0 / 3.0]], rtol=1e-6)


def test_windows_of_5_s_leave_the_statistics_of_innovations_as_they_are():
    records = [*still('r1'), *(
        scan('r1', ms, [(1, (2.0 + 1e-5 * ms, 0.0))]) for ms in (0, 6000, 9900, 10_100))]

    windows, estimator = windows_of(team('r1'), records)

    alone, _ = run(team('r1'), received(sorted(records, key=lambda r: r.stamp)))
    assert windows.moments(['landmark']).numerators.shape == (2, 1)
    assert estimator.innovations.log_likelihood == alone.innovations.log_likelihood


def test_outliers_change_the_factor_little():
    # None of them starts a landmark.
    def with_outlier(k, record):
        if not isinstance(record, Scan) or not record.observations or k % 40 != 1 or k < 100:
            return record
        first, *others = record.observations
        return replace(record, observations=(replace(first, z=first.z + 10.0), *others))

    wrong = [with_outlier(k, record) for k, record in enumerate(simulated(1))]

    found = scales_over_windows(team(), received(wrong), {'landmark': 1.0})['landmark']

    assert found.scale == pytest.approx(1.0, rel=0.1)


def test_moments_of_a_kind_do_not_depend_on_others_that_are_asked_for():
    windows, _ = windows_of(team(), simulated(1, rate=1, robot_sigma=[0.2, 0.2]))

    both, one = windows.moments(['robot', 'landmark']), windows.moments(['landmark'])

    np.testing.assert_array_equal(np.array(both)[:, :, 1:], one)
    assert both.is_complete()


def test_without_observations_of_a_kind_its_factor_is_not_known():
    records = received([odometry('r1', ms) for ms in range(0, 2000, 100)])

    found = scales_over_windows(team('r1'), records, {'landmark': 1.0})

    assert not found['landmark'].is_known()


def test_without_observations_of_one_of_two_kinds_neither_factor_is_known():
    found = scales_over_windows(
        team(), received(simulated(1, rate=1)), {'landmark': 1.0, 'robot': 1.0})

    assert not found['landmark'].is_known()
    assert not found['robot'].is_known()
