# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of odometry without covariance are found where their ratio is wrong."""

import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_truth import odometry_sigmas
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.records import NS, Odometry, TruePose
from fej_slam_ros.core.settings import RobotSettings, Settings

STEP, SPEED = 0.2, 0.6
STATED = (0.05, 0.05, 0.02)


def driving(seed, sigma, seconds=900, covariance=None):
    """Yield odometry and true poses of a robot whose turn rate changes at random."""
    rng = np.random.default_rng(seed)
    pose, by_odometry, rate = np.zeros(3), np.zeros(3), 0.0
    for k in range(round(seconds / STEP)):
        stamp = round(k * STEP * NS)
        yield Odometry('r1', stamp, by_odometry.copy(), covariance)
        yield TruePose('r1', stamp, pose.copy())
        rate += rng.normal(0.0, 0.3) - 0.2 * rate
        u = np.array([SPEED * STEP, 0.0, rate * STEP])
        pose = compose(pose, u)
        by_odometry = compose(
            by_odometry, u + rng.normal(size=3) * sigma * math.sqrt(STEP))


def found(records):
    settings = Settings((RobotSettings('r1', 1, odometry_sigma=STATED),), anchor='r1')
    return odometry_sigmas(
        TeamRecords([(record, None) for record in records], settings), settings)


@pytest.mark.parametrize('sigma', [(0.02, 0.02, 0.05), (0.2, 0.2, 0.02), (0.05, 0.05, 0.1)])
@pytest.mark.parametrize('seed', range(2))
def test_sigmas_are_those_of_the_noise(seed, sigma):
    # 180 windows of 5 s: standard errors of 5 % of turns and 4 % of positions; 4 of them.
    assert found(driving(seed, sigma))['r1'] == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize('factor', [0.5, 1.0, 3.0])
def test_where_one_factor_does_sigmas_stay(factor):
    assert found(driving(3, factor * np.array(STATED))) == {}


def test_odometry_that_states_its_covariance_keeps_it():
    assert found(driving(1, (0.02, 0.02, 0.05), covariance=np.diag([1e-3, 1e-3, 1e-4]))) == {}


def test_odometry_without_noise_determines_no_sigmas():
    assert not found(driving(1, np.zeros(3)))


def test_few_windows_determine_no_sigmas():
    assert found(driving(1, (0.02, 0.02, 0.05), seconds=300)) == {}
