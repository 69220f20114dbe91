# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors from innovations."""

from dataclasses import replace
from functools import cache
import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fej_slam_ros.core.calibration.from_innovations import (
    counts, most_likely_odometry_scales, most_likely_scales, run, with_scales)
from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.estimator import BrokenEstimateError
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from helpers.calibration import error, received, simulated
from helpers.records import claiming, odometry, scan, team, with_scaled_noise
from helpers.slow import slow


@pytest.mark.parametrize('seed', [1, slow(2), slow(3)])
def test_factors_equal_those_of_the_simulation(seed):
    records = received(claiming(simulated(seed), {Odometry: 0.5, Scan: 2.0}))

    found = most_likely_scales(team(), records, ['odometry', 'landmark'])

    assert error(found['odometry'], 2.0) < 4.0
    assert error(found['landmark'], 0.5) < 4.0
    assert all(scale.is_known() for scale in found.values())


@pytest.mark.parametrize(('factors', 'expected'), [
    ((1.0, 1.0), {'': 1.0}), ((0.5, 0.5), {'': 2.0}),
    # Of two that differ, the first has its own.
    ((1.0, 0.2), {'': 5.0, 'r1': 1.0})])
def test_robots_that_differ_have_factors_of_their_own(factors, expected):
    of_robots = dict(zip(('r1', 'r2'), factors))
    records = received(
        with_scaled_noise(of_robots[r.robot], r) if isinstance(r, Odometry) else r
        for r in simulated(2))

    found = most_likely_odometry_scales(team(), records)

    assert found.keys() == expected.keys()
    assert all(error(found[robot], scale) < 4.0 for robot, scale in expected.items())


@pytest.mark.slow
def test_standard_deviations_far_too_small_have_their_factor_too():
    # Some drivers fill in constants such as 1e-7 (m/s)^2.
    records = received(claiming(simulated(1), {Odometry: 1.0 / 300.0}))

    found = most_likely_scales(team(), records, ['odometry', 'landmark'])

    assert error(found['odometry'], 300.0) < 4.0
    assert found['odometry'].is_known()


def test_correctly_stated_noise_has_factors_of_one():
    records = received(simulated(4, robot_sigma=[0.2, 0.2]))

    found = most_likely_scales(team(), records, ['odometry', 'landmark', 'robot'])

    assert all(error(scale, 1.0) < 4.0 for scale in found.values())


@pytest.mark.parametrize('seed', [5, 6])
def test_a_filter_with_the_factors_is_consistent(seed):
    records = received(claiming(simulated(seed), {Odometry: 0.5, Scan: 0.3}))
    found = most_likely_scales(team(), records, ['odometry', 'landmark'])
    scales = {kind: factor.scale for kind, factor in found.items()}

    estimator, _ = run(with_scales(team(), scales), records)

    for nis in estimator.innovations.nis.values():
        low, high = band_per_dof(nis.dof, 0.9999)
        # The standard errors of the factors are 3 % of NIS.
        assert 0.95 * low < nis.total / nis.dof < 1.05 * high


def _with_last_moved(record):
    *others, last = record.observations
    return replace(record, observations=(*others, replace(last, z=last.z + 10.0)))


@pytest.mark.parametrize(('scans', 'kind'), [(Scan, 'landmark'), slow(RobotScan, 'robot')])
def test_outliers_change_the_factors_little(scans, kind):
    records = simulated(1, robot_sigma=[0.2, 0.2])
    # Every twentieth scan with observations has a wrong one.
    wrong = {
        id(record) for record in
        [r for r in records if isinstance(r, scans) and r.observations][10::20]}

    measured = received([_with_last_moved(r) if id(r) in wrong else r for r in records])
    found = most_likely_scales(team(), measured, ['odometry', kind])

    assert found[kind].scale == pytest.approx(1.0, rel=0.1)
    # A wrong observation that starts a landmark takes the next one with it.
    assert 0 <= counts(measured)[kind] - found[kind].samples - len(wrong) <= 1


@pytest.mark.slow
def test_factors_do_not_depend_on_the_heading_that_robots_need_to_join():
    # With 0.05 rad, the noise would decide when the second robot joins.
    records = received(simulated(2, range=6, robot_sigma=[0.2, 0.2]))

    strict, usual = (
        most_likely_scales(team(join_heading_sigma=sigma), records, ['odometry', 'landmark'])
        for sigma in (0.05, 0.1))

    assert strict == usual


@cache
def with_faults():
    """Return records with a wrong scan, and a landmark that is moved then."""
    records = simulated(2, range=8, loops=2, robot_sigma=[0.2, 0.2])
    scans = [r for r in records if isinstance(r, Scan) and len(r.observations) > 2]
    wrong = scans[len(scans) // 2]

    def is_wrong(record, observation):
        return record is wrong or (observation.id == 20 and record.stamp > wrong.stamp)

    return received(
        replace(record, observations=tuple(
            replace(o, z=o.z + 10.0) if is_wrong(record, o) else o for o in record.observations))
        if isinstance(record, Scan) else record for record in records)


@cache
def usual_factors():
    return most_likely_scales(team(), with_faults(), ['odometry', 'landmark'])


@pytest.mark.slow
@pytest.mark.parametrize('setting', [
    {'inflate_rejected_scans': True}, {'moved_landmarks': 'ignore'}, {'join_probability': 0.01}])
def test_factors_do_not_depend_on_what_the_estimator_does_with_rejected_data(setting):
    # By any of these, the noise would decide which innovations count.
    found = most_likely_scales(team(**setting), with_faults(), ['odometry', 'landmark'])

    assert found == usual_factors()


@pytest.mark.slow
def test_factors_are_those_of_the_simulation_if_each_robot_has_landmark_ids_of_its_own():
    records = [
        replace(r, observations=tuple(replace(o, id=31 - o.id) for o in r.observations))
        if isinstance(r, Scan) and r.robot == 'r2' else r
        for r in simulated(1, robot_sigma=[0.2, 0.2])]

    found = most_likely_scales(
        team(shared_landmark_ids=False), received(records), ['odometry', 'landmark', 'robot'])

    # Robots that do not join have no innovations of each other.
    assert all(scale.is_known() and error(scale, 1.0) < 4.0 for scale in found.values())


def test_without_observations_the_factors_are_not_known():
    records = received([odometry('r1', ms) for ms in range(0, 2000, 100)])

    found = most_likely_scales(team('r1'), records, ['odometry'])

    assert not found['odometry'].is_known()


@pytest.mark.filterwarnings('error')
def test_without_a_scale_at_which_the_estimate_holds_its_error_is_all_that_is_reported():
    records = received(claiming(simulated(7), {Scan: 1e-40}))

    with pytest.raises(BrokenEstimateError, match='look for covariances of the input'):
        most_likely_scales(team(), records, ['landmark'])


def test_the_log_likelihood_equals_the_density_of_the_innovation():
    # A robot that moves by 1 m with unit covariance observes one landmark twice.
    records = [
        odometry('r1', 0, (0, 0, 0)), scan('r1', 0, [(1, (2.0, 0.0))]),
        odometry('r1', 1000, (1, 0, 0), np.diag([1.0, 1.0, 0.0])),
        scan('r1', 1000, [(1, (0.5, 0.3))])]

    estimator, _ = run(team('r1'), received(records))

    # Variances: landmark 0.01, motion 1, observation 0.01 m^2; the constant is 2 log(2 pi) / 2.
    density = multivariate_normal([1.0, 0.0], 1.02 * np.eye(2)).logpdf([0.5, 0.3])
    assert estimator.innovations.log_likelihood == pytest.approx(density + math.log(2.0 * math.pi))
