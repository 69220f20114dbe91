# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots that drive by the constant-turn model with lateral slip, section III-A of [Andersson].

Whoever drives a robot sees where it is and steers it back to its course; only the commands are
known to the odometry, and what the robot does beyond them is the noise of the model.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose
from fej_slam_ros.core.motion_models import constant_turn
from fej_slam_ros.core.records import NS, Odometry

#: Time from step to step [ns] and [s], and the speed ahead [m/s].
STEP = NS // 2
T = STEP / NS
SPEED = 0.5

#: How (v, omega) answers to being ahead, to the left and turned to the left of the course: within
#: a few seconds, and without swinging.
STEERING = np.array([[0.2, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.2, 0.6]])


class Leg(NamedTuple):
    """So many steps along an arc on which the robot turns by so much [rad], left positive."""

    steps: int
    turn: float


class Drive(NamedTuple):
    """
    How a robot drove.

    Attributes
    ----------
    commands : (K, 3) array, the driving vector u = (v, v_lat, omega) of each step, eq. (4)
    poses : (K + 1, 3) array, where that and the noise took it, in the frame of its start

    """

    commands: Array
    poses: Array


def drive(legs: Sequence[Leg], sigma: Array, rng: np.random.Generator) -> Drive:
    """Drive along some legs with noise of the standard deviations sigma (3,), eq. (5)."""
    course = [np.zeros(3)]
    poses = [np.zeros(3)]
    commands = []
    for planned in _planned(legs):
        u = planned - STEERING @ between(course[-1], poses[-1])
        course.append(compose(course[-1], constant_turn(planned, sigma, T)[0]))
        poses.append(compose(poses[-1], constant_turn(u + rng.normal(0.0, sigma), sigma, T)[0]))
        commands.append(u)
    return Drive(np.array(commands), np.array(poses))


def odometry(
    robot: str, commands: Array, sigma: Array, stamps: Sequence[int]
) -> Iterator[Odometry]:
    """
    Yield the integrated odometry of a robot, which starts at [0, 0, 0], eqs. (7) and (10).

    The commands (K, 3) lead from each of the K + 1 stamps to the next. The covariance Q of an
    increment goes into the later message as that of a mean twist, Q / T^2.
    """
    pose = np.zeros(3)
    yield Odometry(robot, stamps[0], pose, None)
    for stamp, u in zip(stamps[1:], commands):
        U, Q = constant_turn(u, sigma, T)
        pose = compose(pose, U)
        yield Odometry(robot, stamp, pose, Q / T**2)


def _planned(legs: Sequence[Leg]) -> Iterator[Array]:
    """Yield the driving vector of each step on the course."""
    for steps, turn in legs:
        for _ in range(steps):
            yield np.array([SPEED, 0.0, turn / (steps * T)])
