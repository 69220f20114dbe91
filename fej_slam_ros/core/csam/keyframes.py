# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Choice of the poses that a smoother keeps, so that memory grows with distance and not with time.

A pose is kept if the robot has moved since the last one, or since it last observed one of the
landmarks in view. Odometry between two keyframes is one measurement without loss. Observations
from the poses in between repeat earlier ones from nearly the same place: they correct the newest
pose only, and no solution has them.

The choice by landmarks depends on odometry and scans of the robot alone, so that each smoother
that has these chooses the same. A pose that is kept for an observation of a robot changes nothing
in it.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, compose, wrap
from fej_slam_ros.core.records import Motion, Observation, RobotScan

#: Turn [rad] that counts as a motion: another part of the surroundings is in view.
KEYFRAME_TURN = 0.5

#: Robot, motion (None at its first pose) and observations of one robot of a step.
RobotStep = tuple[str, Motion | None, tuple[Observation, ...]]


class Keyframes:
    """
    Keyframes of a team.

    A pose or an observation is kept after a motion of `distance` [m]; at 0 all are.

    """

    def __init__(self, distance: float) -> None:
        self._distance = distance
        # Odometry poses (3,) of each robot: now, and when something was last kept, by its key:
        # the ID of a landmark, the name of another robot, or None for the pose.
        self._now: dict[str, Array] = {}
        self._kept: dict[str, dict[Hashable, Array]] = {}

    def choose(self, steps: Iterable[RobotStep]) -> set[str]:
        """Return the robots whose poses at one stamp are kept for their own measurements."""
        if self._distance == 0.0:
            return {robot for robot, _, _ in steps}
        return {step[0] for step in steps if self._is_kept(*step)}

    def choose_robot_scans(self, scans: Iterable[RobotScan]) -> list[RobotScan]:
        """Return the robot-to-robot observations that are kept: one of the two has moved."""
        if self._distance == 0.0:
            return [*scans]
        kept = []
        for scan in scans:
            observations = tuple(
                o for o in scan.observations if self._has_moved(scan.robot, o.observed)
                or self._has_moved(o.observed, scan.robot))
            if observations:
                kept.append(replace(scan, observations=observations))
        # Of two robots that observe each other at one stamp, neither observation is the last one
        # of the other: the order of the robots would decide.
        for scan in kept:
            for o in scan.observations:
                self._kept[scan.robot][o.observed] = self._now[scan.robot]
                self._kept[o.observed][scan.robot] = self._now[o.observed]
        return kept

    def _is_kept(
        self, robot: str, motion: Motion | None, observations: Sequence[Observation]
    ) -> bool:
        if motion is None:
            self._now[robot], self._kept[robot] = np.zeros(3), {}
        else:
            self._now[robot] = compose(self._now[robot], motion.u)
        keys = [None, *(observation.id for observation in observations)]
        if not any(self._has_moved(robot, key) for key in keys):
            return False
        self._kept[robot].update(dict.fromkeys(keys, self._now[robot]))
        return True

    def _has_moved(self, robot: str, key: Hashable) -> bool:
        """Return whether a robot has moved since something was last kept, or it never was."""
        if key not in self._kept[robot]:
            return True
        x, y, phi = (self._now[robot] - self._kept[robot][key]).tolist()
        return math.hypot(x, y) >= self._distance or abs(wrap(phi)) >= KEYFRAME_TURN
