# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots that drive by the constant-turn model with lateral slip, section III-A of [Andersson].

A feedback controller that knows the true pose keeps the robot on its planned course. The odometry
knows only the commands; the deviation from them is the noise of the model.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose
from fej_slam_ros.core.motion_models import constant_turn
from fej_slam_ros.core.records import NS, Odometry

#: Duration of a step [ns] and [s].
STEP = NS // 2
STEP_SECONDS = STEP / NS
#: Forward speed along the course [m/s].
FORWARD_SPEED = 0.5
#: Gain from the pose error (ahead, left, turned left) relative to the course to (v, v_lat, omega):
#: errors decay within a few seconds without oscillation.
STEERING_GAIN = np.array([[0.2, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.2, 0.6]])


class Leg(NamedTuple):
    """An arc of the course: number of steps and total turn [rad], left positive."""

    steps: int
    turn: float


class DrivenPath(NamedTuple):
    """The commands and the true path of a robot."""

    #: (K, 3) array, the driving vector u = (v, v_lat, omega) of each step, eq. (4).
    commands: Array
    poses: Array  #: (K + 1, 3) array, true poses in the frame of the start


def drive(legs: Sequence[Leg], sigma: Array, rng: np.random.Generator) -> DrivenPath:
    """Drive along the legs with driving noise of standard deviations sigma (3,), eq. (5)."""
    course = [np.zeros(3)]
    poses = [np.zeros(3)]
    commands = []
    velocities = (
        np.array([FORWARD_SPEED, 0.0, turn / (steps * STEP_SECONDS)])
        for steps, turn in legs for _ in range(steps))
    for planned in velocities:
        u = planned - STEERING_GAIN @ between(course[-1], poses[-1])
        course.append(compose(course[-1], constant_turn(planned, sigma, STEP_SECONDS)[0]))
        driven = u + rng.normal(0.0, sigma)
        poses.append(compose(poses[-1], constant_turn(driven, sigma, STEP_SECONDS)[0]))
        commands.append(u)
    return DrivenPath(np.array(commands), np.array(poses))


def odometry(
    robot: str, commands: Array, sigma: Array, stamps: Sequence[int]
) -> Iterator[Odometry]:
    """
    Yield the integrated odometry of a robot from [0, 0, 0], eqs. (7) and (10).

    The commands (K, 3) lead from each of the K + 1 stamps to the next. The covariance Q of an
    increment is carried by the later message as that of the mean twist, Q / STEP_SECONDS^2.
    """
    pose = np.zeros(3)
    yield Odometry(robot, stamps[0], pose, None)
    for stamp, u in zip(stamps[1:], commands):
        U, Q = constant_turn(u, sigma, STEP_SECONDS)
        pose = compose(pose, U)
        yield Odometry(robot, stamp, pose, Q / STEP_SECONDS**2)
