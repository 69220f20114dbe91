# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of two robots in which a landmark is moved."""

from dataclasses import replace

import numpy as np

from fej_slam_ros.core.records import NS, Scan, TruePose
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, WorldSettings
from helpers.core import turn

#: Both robots drive two loops, 0.4 m a step, and see about ten landmarks at a time.
WORLD = WorldSettings('circles', (80.0, 70.0), 200, landmarks=30, loops=2, rate=10.0)
SENSORS = SensorSettings((0.02, 0.02, 0.004), (0.1, 0.1), range=10.0)

SHIFT = np.array([0.9, -1.2])
SECOND_LOOP = 20 * NS


def drive(seed):
    """Return the records of a run in which nothing is moved."""
    rng = np.random.default_rng(seed)
    return list(measure(make_world(WORLD, rng), SENSORS, rng))


def with_moved(records, number, since):
    """Move a landmark by SHIFT."""
    poses = {(r.robot, r.stamp): r.pose for r in records if isinstance(r, TruePose)}

    def shifted(scan):
        shift = turn(poses[scan.robot, scan.stamp][2]).T @ SHIFT
        return replace(scan, observations=tuple(
            replace(s, z=s.z + shift) if s.id == number else s for s in scan.observations))

    return [shifted(r) if isinstance(r, Scan) and r.stamp >= since else r for r in records]
