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
from fej_slam_ros.core.ordering.odometry_increments import scaled_increment
from fej_slam_ros.core.records import Motion, NS, Odometry
from fej_slam_ros.core.settings import RobotSettings

#: Odometry this close to its origin [m, rad] belongs to a robot that has not moved yet.
AT_ORIGIN = (0.01, 0.01)
#: Speeds [m/s, rad/s] that a robot may have had although it is slower or at rest now, and the
#: factor by which it may have been faster than now.
USUAL_SPEEDS = (1.0, 1.0)
FASTER = 3.0
#: Standard deviation of the heading [rad] beyond which the motion is unknown: half of what the
#: estimator linearises at most, for a covariance that is itself an estimate.
MAX_HEADING_SIGMA = 0.15


def is_at_origin(first: Odometry) -> bool:
    """Return whether a robot has not moved since its odometry began."""
    x, y, phi = first.pose
    return bool(np.hypot(x, y) <= AT_ORIGIN[0] and abs(wrap(phi)) <= AT_ORIGIN[1])


def missed_motion(
    first: Odometry, second: Odometry, missed: int | None, robot: RobotSettings
) -> Motion | str:
    """
    Return the motion from the start to the first odometry, or the reason why it is unknown.

    Parameters
    ----------
    first, second : first two odometry records that arrived
    missed : number of odometry messages sent before, None if it is unknown
    robot : settings, for the noise of odometry without covariance

    """
    at = np.array2string(first.pose, precision=2, suppress_small=True, separator=', ')
    if missed is None:
        return f'it was first heard at odometry {at}, and it is unknown how long it had moved'
    heard = f'it was first heard at odometry {at}, after {missed} messages'
    step = scaled_increment(first, second, robot)
    dt = (second.stamp - first.stamp) / NS
    distance, turn = float(np.hypot(*first.pose[:2])), abs(wrap(float(first.pose[2])))
    speed, turn_rate = float(np.hypot(*step.u[:2])) / dt, abs(float(step.u[2])) / dt
    duration = missed * dt
    if distance > duration * max(FASTER * speed, USUAL_SPEEDS[0]) + AT_ORIGIN[0] or (
            turn > duration * max(FASTER * turn_rate, USUAL_SPEEDS[1]) + AT_ORIGIN[1]):
        return f'{heard}: too far from its origin for {duration:.1f} s'
    noise = missed * step.Q
    sigma = float(np.sqrt(noise[2, 2]))
    if sigma > MAX_HEADING_SIGMA:
        return f'{heard}: its heading since the start is unknown to {sigma:.2f} rad'
    P = _covariance(first.pose, noise, max(distance, speed * duration))
    return Motion(first.robot, first.stamp, first.pose, P)


def _covariance(u: Array, noise: Array, length: float) -> Array:
    """
    Return the covariance of a motion u whose path of a given length [m] is unknown.

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
