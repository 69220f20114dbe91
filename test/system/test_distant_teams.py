# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Two teams that map different places join when a robot drives from one to the other.

Only the odometry of its way relates the directions of both maps, whatever is observed later.
"""

import math

import numpy as np
import pytest

from fej_slam_ros.core.geometry import compose, inverse, transform
from fej_slam_ros.core.records import Observation, Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings
from helpers.core import estimate

#: Seconds between steps, of circles at each place, of the way between both, and of the run.
STEP, CIRCLES, WAY, END = 0.5, 20.0, 60.0, 160.0
#: Standard deviations of odometry [m, m, rad per sqrt(s)] and of observations [m].
ODOMETRY, SIGMA = (0.05, 0.02, 0.0125), 0.1
#: Distance of the places, half of the side of each, and range of observations [m].
DISTANCE, SIDE, RANGE = 60.0, 6.0, 8.0


def true_motion(robot, t):
    """Return the motion of a step: circles, but r2 drives to the other place after some."""
    if robot == 'r2' and CIRCLES <= t < CIRCLES + WAY:
        return np.array([DISTANCE / WAY * STEP, 0.0, 0.0])
    return np.array([0.5 * STEP, 0.0, 2.0 * math.pi / CIRCLES * STEP])


def simulated(seed):
    """Yield the records of r1 at the first place, and of r2 and r3 that begin at the second."""
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-SIDE, SIDE, (24, 2)) + np.repeat([[0.0, 0.0], [DISTANCE, 0.0]], 12, 0)
    poses = {
        'r1': np.zeros(3), 'r2': np.array([DISTANCE, 0.0, math.pi]),
        'r3': np.array([DISTANCE, 2.0, 0.0])}
    by_odometry = {robot: np.zeros(3) for robot in poses}
    for k in range(round(END / STEP)):
        stamp = round(k * STEP * 1e9)
        for robot, pose in poses.items():
            yield Odometry(robot, stamp, by_odometry[robot].copy(), None)
            seen = [j for j, point in enumerate(landmarks)
                    if np.hypot(*(point - pose[:2])) < RANGE]
            yield Scan(robot, stamp, tuple(
                Observation(
                    j, transform(inverse(pose), landmarks[j]) + rng.normal(0.0, SIGMA, 2),
                    SIGMA ** 2 * np.eye(2)) for j in seen))
        for robot, pose in poses.items():
            u = true_motion(robot, k * STEP)
            error = rng.normal(size=3) * ODOMETRY * math.sqrt(STEP)
            poses[robot] = compose(pose, u)
            by_odometry[robot] = compose(by_odometry[robot], u + error)


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
@pytest.mark.parametrize('seed', range(3))
def test_the_directions_of_two_maps_are_known_no_better_than_by_the_odometry_between_them(
        seed, kind):
    estimator, _ = estimate(
        simulated(seed),
        [RobotSettings(f'r{k}', k, odometry_sigma=ODOMETRY) for k in (1, 2, 3)], filter=kind,
        gate_probability=1.0)
    state = estimator.groups.team.state
    assert state.robots.keys() == {'r1', 'r2', 'r3'}

    P = state.marginal([state.robots['r1'], state.robots['r3']])

    turned = P[2, 2] + P[5, 5] - 2.0 * P[2, 5]
    unseen = (DISTANCE - 2.0 * (SIDE + RANGE)) / DISTANCE * WAY
    assert turned >= ODOMETRY[2] ** 2 * unseen
