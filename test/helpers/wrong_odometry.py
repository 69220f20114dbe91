# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records of a simulated robot whose odometry has systematic errors."""

import numpy as np

from fej_slam_ros.core.geometry import compose, inverse, transform
from fej_slam_ros.core.records import NS, Observation, Odometry, Scan, TruePose

DT, SECONDS, SIGMA = 0.1, 600.0, 0.03


def run(scale=(1.0, 1.0), bias=0.0, straight=False, seconds=SECONDS, slip=2e-3):
    """Return odometry with errors, scans and true poses of a robot, as lists of records."""
    rng = np.random.default_rng(1)
    landmarks = rng.uniform(-60.0, 60.0, (1000, 2))
    pose, measured = np.zeros(3), np.zeros(3)
    odometry, scans, true = [Odometry('r', 0, measured, None)], [], [TruePose('r', 0, pose)]
    for k in range(1, round(seconds / DT)):
        t, stamp = k * DT, round(k * DT * NS)
        turn = 0.0 if straight else 0.4 * np.sin(0.3 * t) + 0.2 * np.sin(0.07 * t)
        u = np.array([(0.5 + 0.3 * np.sin(0.5 * t)) * DT, 0.0, turn * DT])
        pose = compose(pose, u)
        wrong = np.array([u[0] / scale[0], 0.0, (u[2] + bias * DT) / scale[1]])
        measured = compose(measured, wrong + rng.normal(0.0, [slip, 1e-3, 1e-3]))
        odometry.append(Odometry('r', stamp, measured, None))
        true.append(TruePose('r', stamp, pose))
        if k % 5:
            continue
        z = transform(inverse(pose), landmarks)
        scans.append(Scan('r', stamp, tuple(
            Observation(int(i), z[i] + rng.normal(0.0, SIGMA, 2), SIGMA**2 * np.eye(2))
            for i in np.flatnonzero(np.hypot(*z.T) < 8.0))))
    return odometry, scans, true
