# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records of a simulated robot whose odometry and sensor have systematic errors."""

import numpy as np

from fej_slam_ros.core.geometry import compose, inverse, transform
from fej_slam_ros.core.records import NS, Observation, Odometry, Scan, TruePose

DT, SECONDS, SIGMA = 0.1, 600.0, 0.03


def run(
        scale=(1.0, 1.0), bias=0.0, radius=None, seconds=SECONDS, slip=2e-3,
        sensor=(0.0, 0.0, 0.0), turn_rate=0.0, is_abrupt=False):
    """
    Return odometry with errors, scans and true poses of a robot, as lists of records.

    The robot drives on circles of a radius, perhaps infinite; without it, its turn rate varies
    about a mean, perhaps abruptly each 1.6 s. The observations are those from a sensor at a pose
    (x, y, yaw), as if it were at the origin.

    """
    rng = np.random.default_rng(1)
    landmarks = rng.uniform(-60.0, 60.0, (1000, 2))
    pose, measured = np.zeros(3), np.zeros(3)
    odometry, scans, true = [Odometry('r', 0, measured, None)], [], [TruePose('r', 0, pose)]
    for k in range(1, round(seconds / DT)):
        t, stamp = k * DT, round(k * DT * NS)
        speed = 0.5 + 0.3 * np.sin(0.5 * t)
        turn = turn_rate + (
            0.8 * np.sign(np.sin(2.0 * t)) if is_abrupt
            else 0.4 * np.sin(0.3 * t) + 0.2 * np.sin(0.07 * t))
        u = np.array([speed, 0.0, turn if radius is None else speed / radius]) * DT
        pose = compose(pose, u)
        wrong = np.array([u[0] / scale[0], 0.0, (u[2] + bias * DT) / scale[1]])
        measured = compose(measured, wrong + rng.normal(0.0, [slip, 1e-3, 1e-3]))
        odometry.append(Odometry('r', stamp, measured, None))
        true.append(TruePose('r', stamp, pose))
        if k % 5:
            continue
        z = transform(inverse(compose(pose, np.array(sensor))), landmarks)
        scans.append(Scan('r', stamp, tuple(
            Observation(int(i), z[i] + rng.normal(0.0, SIGMA, 2), SIGMA**2 * np.eye(2))
            for i in np.flatnonzero(np.hypot(*z.T) < 8.0))))
    return odometry, scans, true
