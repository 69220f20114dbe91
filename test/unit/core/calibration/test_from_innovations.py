# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Innovations tell by which factors noise is claimed wrongly."""

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fej_slam_ros.core.calibration.from_innovations import (
    counts, most_likely_scales, run, with_scales)
from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.ros.session import simulation
from helpers.records import claiming, odometry, scan, team


def simulated(seed, **changes):
    """Return what robots measure, without ground truth."""
    records = simulation.parse({'loops': 1, 'landmarks': 30, 'seed': seed, **changes}).records()
    return [r for r in records if isinstance(r, (Odometry, Scan, RobotScan))]


def received(records):
    return [(record, None) for record in records]


def off(found, true):
    """Return by how many standard errors a factor is off."""
    return abs(math.log(found.scale / true)) / found.relative_error


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_factors_are_those_of_the_simulation(seed):
    records = received(claiming(simulated(seed), {Odometry: 0.5, Scan: 2.0}))

    found = most_likely_scales(team(), records, ['odometry', 'landmark'])

    assert off(found['odometry'], 2.0) < 4.0
    assert off(found['landmark'], 0.5) < 4.0
    assert all(told.is_known() for told in found.values())


def test_noise_that_is_claimed_rightly_has_factors_of_one():
    records = received(simulated(4, robot_sigma=[0.2, 0.2]))

    found = most_likely_scales(team(), records, ['odometry', 'landmark', 'robot'])

    assert all(off(told, 1.0) < 4.0 for told in found.values())


@pytest.mark.parametrize('seed', [5, 6])
def test_a_filter_with_the_factors_is_consistent(seed):
    records = received(claiming(simulated(seed), {Odometry: 0.5, Scan: 0.3}))
    found = most_likely_scales(team(), records, ['odometry', 'landmark'])
    scales = {kind: told.scale for kind, told in found.items()}

    estimator, _ = run(with_scales(team(), scales), records)

    for nis in estimator.innovations.nis.values():
        low, high = chi_square_band(nis.dof, 0.9999)
        # The factors themselves are off by their standard errors, 3 % of NIS here.
        assert 0.95 * low < nis.total < 1.05 * high


def _with_last_moved(record):
    *others, last = record.observations
    return replace(record, observations=(*others, replace(last, z=last.z + 10.0)))


def test_gross_errors_change_the_factors_little():
    wrong = [
        _with_last_moved(record)
        if isinstance(record, Scan) and record.observations and k % 40 == 1 else record
        for k, record in enumerate(simulated(1))]

    found = most_likely_scales(team(), received(wrong), ['odometry', 'landmark'])

    assert found['landmark'].scale == pytest.approx(1.0, rel=0.1)
    assert found['landmark'].samples < counts(received(wrong))['landmark']


def test_what_no_observation_tells_is_not_known():
    records = received([odometry('r1', ms) for ms in range(0, 2000, 100)])

    found = most_likely_scales(team('r1'), records, ['odometry'])

    assert not found['odometry'].is_known()


def test_the_log_likelihood_is_that_of_the_innovation():
    # A robot that moves by 1 m with unit covariance sees again what it saw at its start.
    records = [
        odometry('r1', 0, (0, 0, 0)), scan('r1', 0, [(1, (2.0, 0.0))]),
        odometry('r1', 1000, (1, 0, 0), np.diag([1.0, 1.0, 0.0])),
        scan('r1', 1000, [(1, (0.5, 0.3))])]

    estimator, _ = run(team('r1'), received(records))

    # Of the landmark 0.01 m^2, of the motion 1 m^2, of the observation 0.01 m^2; 2 log(2 pi) / 2 is
    # the constant.
    density = multivariate_normal([1.0, 0.0], 1.02 * np.eye(2)).logpdf([0.5, 0.3])
    assert estimator.innovations.log_likelihood == pytest.approx(density + math.log(2.0 * math.pi))
