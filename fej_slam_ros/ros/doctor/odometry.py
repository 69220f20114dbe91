# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of odometry: plausible motion and covariances."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import median_filter

from fej_slam_ros.core.definiteness import are_definite
from fej_slam_ros.core.geometry import Array, Flags, Stamps, wrap_all
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.findings import error, Finding, seconds, warning
from fej_slam_ros.ros.doctor.survey import OdometrySeries
from fej_slam_ros.ros.messages.incoming import checked_covariance, RejectedError
from fej_slam_ros.ros.session.input_health import MAX_SPEED_SIGMA, MIN_SPEED_SIGMA

#: Quantile of the speeds that is the usual maximum; the speeds above it may be jumps.
USUAL_QUANTILE = 0.95
#: Number of increments whose median speed is usual too: a robot at rest may begin to drive.
JUMP_NEIGHBOURS = 11
#: Factor of a jump over the usual speed and distance, and its margin of speed [m/s, rad/s].
JUMP_FACTOR = 2.0
JUMP_MARGIN = np.array([1.0, 2.0])
#: Upper bound of the median speed [m/s, rad/s]; above it, units are wrong.
MAX_MEDIAN_SPEED = np.array([50.0, 10.0])
#: Distance of a motion [m] whose direction is compared with the yaw, and minimum number of them.
COMPARED_DISTANCE, MIN_COMPARED = 0.3, 30
#: Factors by which a wrong yaw is multiplied.
YAW_FAULTS = {'have the other sign': -1.0, 'be in radians, not degrees': np.pi / 180.0}
#: Mean resultant length of the directions relative to the yaw, forwards or backwards, up to which
#: a robot does not drive in the direction of its yaw, and from which on it does.
NOT_ALONG, ALONG = 0.6, 0.8
SPEED_NAMES = np.array(['vx', 'vy', 'wz'])


def check(topic: OdometrySeries, robot: RobotSettings) -> Iterator[Finding]:
    """Yield implausible motion and covariances of the odometry of a robot."""
    where = f'{robot.name}/odom'
    stamps, moved = topic.increments()
    if len(moved) > 1:
        yield from _motion(where, stamps, moved)
        yield from _yaw(where, topic)
    if robot.use_odometry_covariance:
        yield from _covariances(where, topic, robot.name)


def _motion(where: str, stamps: Stamps, moved: Array) -> Iterator[Finding]:
    if not moved.any():
        yield warning(
            'stands_still', where, 'its pose never changes',
            'integrate the motion into pose.pose: the estimator does not use velocities',
            len(stamps), int(stamps[0, 0]))
        return
    speeds = moved * NS / np.diff(stamps, axis=1)
    median_speed = np.median(speeds, axis=0)
    if (median_speed > MAX_MEDIAN_SPEED).any():
        yield error(
            'speed', where,
            f'its median speed is {median_speed[0]:.3g} m/s and {median_speed[1]:.3g} rad/s',
            'give metres, radians (yaw in degrees?) and seconds (REP-103), from the driver of one'
            ' robot only',
            len(stamps), int(stamps[0, 0]))
        return
    usual = np.maximum(
        np.quantile(speeds, USUAL_QUANTILE, axis=0),
        median_filter(speeds, (JUMP_NEIGHBOURS, 1)))
    # Stamps in bursts make small motions fast.
    is_far = moved > JUMP_FACTOR * np.median(moved, axis=0)
    jumps = np.flatnonzero((is_far & (speeds > JUMP_FACTOR * usual + JUMP_MARGIN)).any(axis=1))
    if len(jumps):
        largest = jumps[np.argmax(moved[jumps, 0])]
        yield error(
            'jump', where,
            f'{counted(len(jumps), "jump")}, the largest of {moved[largest, 0]:.3g} m and'
            f' {moved[largest, 1]:.3g} rad in {seconds(stamps[largest, 1] - stamps[largest, 0])}',
            'give integrated odometry without resets or corrections of a localisation, or set'
            ' <robot>.max_speed and <robot>.max_turn_rate to what the robot can drive: it then'
            ' restarts at each jump',
            len(jumps), int(stamps[jumps[0], 1]))


def _yaw(where: str, topic: OdometrySeries) -> Iterator[Finding]:
    """Yield a yaw of the wrong sign or unit, by which no robot drives ahead."""
    _, poses = topic.ordered()
    x, y, yaw = poses.T
    turned = np.append(0.0, np.cumsum(wrap_all(np.diff(yaw))))
    driven = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    at = np.unique(np.searchsorted(driven, np.arange(0.0, driven[-1], COMPARED_DISTANCE)))
    if len(at) <= MIN_COMPARED:
        return
    directions = np.arctan2(np.diff(y[at]), np.diff(x[at]))
    headings = (turned[at][1:] + turned[at][:-1]) / 2.0

    def along(factor: float) -> float:
        return float(np.abs(np.mean(np.exp(2j * (directions - factor * headings)))))

    fault = max(YAW_FAULTS, key=lambda fault: along(YAW_FAULTS[fault]))
    if along(1.0) < NOT_ALONG and along(YAW_FAULTS[fault]) > ALONG:
        yield error(
            'yaw', where, 'it does not drive in the direction of its yaw, as it would if that'
            f' were to {fault}', 'give yaw in radians, counterclockwise (REP-103)', len(at))


def _covariances(where: str, topic: OdometrySeries, robot: str) -> Iterator[Finding]:
    covariances = np.array(topic.covariances).reshape(-1, 3, 3)
    variances = np.einsum('nii->ni', covariances)
    # The first message has no increment.
    used = (np.array(topic.stamps) > min(topic.stamps, default=0)) & (
        np.isfinite(variances).all(axis=1) & (variances >= 0.0).all(axis=1))
    unknown = used & ~variances.any(axis=1)
    if unknown.any():
        yield warning(
            'unknown_covariance', where,
            f'twist.covariance is zero in {unknown.sum()} of {used.sum()} messages: the'
            ' parameter odometry_sigma is used',
            'fill the (vx, vy, wz) entries of twist.covariance, or calibrate odometry_sigma'
            ' (fej_slam calibrate, by ground truth or landmarks)', int(unknown.sum()))
    known = used & ~unknown
    exact = known & (variances[:, 1] == 0.0)
    if exact.any():
        yield warning(
            'exact_odometry', where,
            f'the variance of vy in twist.covariance is zero in {exact.sum()} of {used.sum()}'
            ' messages, which smooth rejects',
            f'to smooth the bag, give vy a variance, or set {robot}.use_odometry_covariance to'
            ' false, to use odometry_sigma', int(exact.sum()))
    regular = covariances[
        known & (variances > 0.0).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))]
    singular = sum(_is_accepted(P) for P in regular[~are_definite(regular)])
    if singular:
        yield error(
            'singular_covariance', where,
            f'vx, vy and wz in twist.covariance are fully correlated in {singular} of'
            f' {used.sum()} messages, which smooth rejects',
            'set the elements beside the diagonal to zero, or set'
            f' {robot}.use_odometry_covariance to false, to use odometry_sigma',
            singular)
    yield from _absurd(where, variances[known], _is_moving(topic)[known], robot)


def _is_accepted(covariance: Array) -> bool:
    """Return whether odometry of a covariance (3, 3) is accepted; rejections are named else."""
    try:
        checked_covariance(covariance)
    except RejectedError:
        return False
    return True


def _is_moving(topic: OdometrySeries) -> Flags:
    """Return whether the pose of each message (n,) is another than that of the one before."""
    steps = np.diff(np.array(topic.poses).reshape(-1, 3), axis=0, prepend=np.nan)
    moving: Flags = (steps != 0.0).any(axis=1)
    return moving


def _absurd(
    where: str, variances: Array, is_moving: Flags, robot: str
) -> Iterator[Finding]:
    """Yield variances (n, 3) that no odometry has; at rest, some drivers give almost none."""
    sigma, smallest = np.sqrt(variances), np.array(MIN_SPEED_SIGMA)
    # A variance of zero is valid for vy: many robots cannot move sideways.
    too_small = (sigma < smallest) & is_moving[:, None] & (
        np.array([True, False, True]) | (variances > 0.0))
    for wrong, side, bounds in (
            (too_small, 'below', smallest),
            (sigma > MAX_SPEED_SIGMA, 'above', np.full(3, MAX_SPEED_SIGMA))):
        if wrong.any():
            columns, messages = wrong.any(axis=0), int(wrong.any(axis=1).sum())
            yield error(
                'absurd_covariance', where,
                f'the standard deviation of {", ".join(SPEED_NAMES[columns])} in twist.covariance'
                f' is {side} {bounds[columns].max():g} in {messages} of {len(variances)} messages',
                'fill in the variances (not standard deviations) of vx, vy [m^2/s^2] and wz'
                f' [rad^2/s^2], all zero if unknown, or set {robot}.use_odometry_covariance to'
                ' false, to use odometry_sigma', messages)
