# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Odometry that cannot be the motion of a robot.

A driver that restarts may continue at another pose, or at its origin again. The limits are far
above any ground robot; smaller jumps are found by the gate on observations.
"""

import math
from typing import NamedTuple

from fej_slam_ros.core.geometry import Array, wrap
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.core.settings import RobotSettings

#: Odometry this close to its origin [m, rad] belongs to a robot that has not moved yet.
AT_ORIGIN = (0.01, 0.01)
#: A motion is plausible if it is at most this many times as fast as a neighbouring one, or slower
#: than these bounds [m/s, rad/s].
MAX_SPEED_RATIO = 3.0
MIN_SPEED_BOUNDS = (1.0, 1.0)
#: Time without odometry [s], and motion [m, rad], after which a robot at the origin has not
#: returned there: its driver was off.
RESTART_GAP, MIN_JUMP = 2.0, (0.3, 0.2)
#: Largest acceleration [m/s^2]: that of a collision; brakes and motors reach a tenth.
MAX_ACCELERATION = 100.0
#: Error of a stamp [s]: of drivers that stamp messages when these are sent, in bursts.
STAMP_ERROR = 0.1
#: Value of ``max_speed`` [m/s] with which no motion is impossible: of data without time or driver.
UNLIMITED = 1e9
#: Number of standard deviations of its covariance that a motion may be longer.
COVARIANCE_SIGMAS = 5.0


class Speeds(NamedTuple):
    """Mean speeds of an increment."""

    linear: float  #: [m/s]
    angular: float  #: [rad/s]


#: Before the first increment a robot may be as fast as its limits allow.
UNKNOWN_SPEEDS = Speeds(math.inf, math.inf)


def is_at_origin(record: Odometry) -> bool:
    """Return whether a robot has not moved since its odometry began."""
    x, y, phi = record.pose.tolist()
    return math.hypot(x, y) <= AT_ORIGIN[0] and abs(wrap(phi)) <= AT_ORIGIN[1]


def speeds(u: Array, dt: float) -> Speeds:
    """Return the mean speeds of an increment u (3,) of a duration [s]."""
    x, y, phi = u.tolist()
    return Speeds(math.hypot(x, y) / dt, abs(phi) / dt)


def impossible_motion(
    now: Speeds, Q: Array, dt: float, end: Odometry, before: Speeds, limits: RobotSettings
) -> str:
    """
    Return why an increment is not the motion of a robot, '' if it may be.

    Parameters
    ----------
    now : mean speeds of the increment
    Q : (3, 3) array, its covariance
    dt : duration of the increment [s]
    end : odometry at its end
    before : speeds of the increment before
    limits : maximum speeds of the robot

    """
    if limits.max_speed >= UNLIMITED:
        return ''
    span, (var_x, var_y, var_phi) = dt + STAMP_ERROR, Q.diagonal().tolist()
    distance = now.linear * dt - COVARIANCE_SIGMAS * math.sqrt(max(var_x + var_y, 0.0))
    turn = now.angular * dt - COVARIANCE_SIGMAS * math.sqrt(max(var_phi, 0.0))
    accelerated = before.linear * span + 0.5 * MAX_ACCELERATION * span ** 2
    if distance > min(limits.max_speed * span, accelerated):
        return f'its odometry moved {now.linear * dt:.1f} m in {dt:.2f} s'
    if turn > limits.max_turn_rate * span:
        return f'its odometry turned {now.angular * dt:.1f} rad in {dt:.2f} s'
    speed, turn_rate = MIN_SPEED_BOUNDS
    is_unusual = (
        distance > max(MAX_SPEED_RATIO * before.linear, speed) * span
        or turn > max(MAX_SPEED_RATIO * before.angular, turn_rate) * span)
    was_off = dt > RESTART_GAP and (
        now.linear * dt > MIN_JUMP[0] or now.angular * dt > MIN_JUMP[1])
    if (is_unusual or was_off) and is_at_origin(end):
        return f'its odometry began again at zero, {now.linear * dt:.1f} m away'
    return ''
