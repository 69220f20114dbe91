# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motion of a robot before its first odometry that arrived.

A start pose holds at the first odometry message that a robot sends. If that was missed, the motion
since is taken from the odometry itself, which begins at its own origin as REP-105 describes, and
its covariance is estimated from the number of messages that were missed.
"""

import numpy as np

from fej_slam_ros.core.geometry import Array, perpendicular, wrap
from fej_slam_ros.core.ordering.impossible_motion import (
    AT_ORIGIN, MAX_SPEED_RATIO, MIN_SPEED_BOUNDS, speeds)
from fej_slam_ros.core.ordering.odometry_increments import (
    scaled_increment, without_odometry_errors)
from fej_slam_ros.core.records import Motion, NS, Odometry
from fej_slam_ros.core.settings import RobotSettings

#: Standard deviation of the heading [rad] beyond which the motion is unknown: half of the
#: largest that the estimator linearises, for a covariance that is itself an estimate.
MAX_MISSED_TURN_SIGMA = 0.15


def pose_text(record: Odometry) -> str:
    """Return the pose of odometry for a sentence."""
    return np.array2string(record.pose, precision=2, suppress_small=True, separator=', ')


def missed_motion(
    first: Odometry, period: tuple[Odometry, Odometry], missed: int | None, robot: RobotSettings
) -> Motion | str:
    """
    Return the motion from the start to the first odometry, or the reason why it is unknown.

    The motion u [m, m, rad] is in the frame of the base at the start. Systematic errors of
    odometry are corrected as on a straight path.

    Parameters
    ----------
    first : first odometry record that arrived
    period : two records in a row, of which the noise and the period of the missed ones are taken
    missed : number of odometry messages sent before, None if it is unknown
    robot : settings, for the noise of odometry without covariance

    """
    at = pose_text(first)
    if missed is None:
        return f'the first odometry received is {at}, and it is unknown how long it had moved'
    received = f'the first odometry received is {at}, after {missed} messages'
    earlier, later = period
    increment, dt = scaled_increment(earlier, later, robot), (later.stamp - earlier.stamp) / NS
    duration = missed * dt
    u = without_odometry_errors(first.pose, duration, robot)
    distance, turn = float(np.hypot(*u[:2])), abs(wrap(float(u[2])))
    usual = speeds(increment.u, dt)
    fastest = np.maximum(MAX_SPEED_RATIO * np.array(usual), MIN_SPEED_BOUNDS)
    if np.any([distance, turn] > duration * fastest + AT_ORIGIN):
        return f'{received}: too far from its origin for {duration:.1f} s'
    noise = missed * increment.Q
    sigma = float(np.sqrt(noise[2, 2]))
    if sigma > MAX_MISSED_TURN_SIGMA:
        return f'{received}: its heading has a standard deviation of {sigma:.2f} rad'
    P = _covariance(u, noise, max(distance, usual.linear * duration))
    return Motion(first.robot, first.stamp, u, P)


def _covariance(u: Array, noise: Array, length: float) -> Array:
    """
    Return the covariance (3, 3) [m, m, rad] of a motion u along an unknown path of a length [m].

    The noise (3, 3) of all increments is spread evenly over a straight path to u. On a longer path
    the robot may have been up to its length away from u, where errors of its heading count more.

    """
    q, q_phi = noise[:2, :2].diagonal().max(), noise[2, 2]
    across = perpendicular(u[:2])
    bends = (length ** 2 - across @ across) / 3.0
    P = np.empty((3, 3))
    P[:2, :2] = (q + q_phi * bends) * np.eye(2) + q_phi * np.outer(across, across) / 3.0
    P[:2, 2] = P[2, :2] = q_phi * across / 2.0
    P[2, 2] = q_phi
    return P
