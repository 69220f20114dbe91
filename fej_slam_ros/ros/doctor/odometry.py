# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether odometry moves as a robot can, and says how well it knows that."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.doctor.findings import counted, ERROR, Finding, seconds, WARNING
from fej_slam_ros.ros.doctor.survey import OdometrySeries

#: A jump is so many times as fast as nearly all motions are, and as most of those around it, and
#: by so much besides [m/s, rad/s].
FASTER = 2.0
USUAL = 0.95
AROUND = 11
BESIDES = np.array([1.0, 2.0])
#: No robot is faster [m/s, rad/s]: a quarter turn in 0.02 s is none.
FASTEST = np.array([50.0, 80.0])
#: Standard deviations of speeds that nobody has [m/s, m/s, rad/s].
SMALLEST_SIGMA = np.array([1e-5, 1e-5, 1e-6])
LARGEST_SIGMA = np.array([100.0, 100.0, 50.0])

UNITS = 'give metres, radians and seconds (REP-103)'


def check(where: str, topic: OdometrySeries) -> Iterator[Finding]:
    """Yield what is wrong with odometry."""
    stamps, moved = topic.increments()
    if len(moved) > 1:
        yield from _motions(where, stamps, moved)
    yield from _covariances(where, topic)


def _motions(where: str, stamps: NDArray[np.int64], moved: Array) -> Iterator[Finding]:
    speeds = moved * NS / np.diff(stamps, axis=1)
    if not moved.any():
        yield Finding(
            WARNING, 'stands_still', where, 'its pose never changes',
            'integrate the motion into pose.pose, of which differences are used: a velocity alone'
            ' is not', len(stamps), int(stamps[0, 0]))
        return
    usual = np.quantile(speeds, USUAL, axis=0)
    if (np.median(speeds, axis=0) > FASTEST).any():
        forward, turning = np.median(speeds, axis=0)
        yield Finding(
            ERROR, 'speed', where,
            f'it moves with {forward:.3g} m/s and {turning:.3g} rad/s in the median', UNITS,
            len(stamps), int(stamps[0, 0]))
        return
    # Of who stands nearly all the time a drive is no jump.
    usual = np.maximum(usual, median_filter(speeds, (AROUND, 1)))
    # Stamps that come in bursts make small motions fast.
    is_far = moved > FASTER * np.median(moved, axis=0)
    jumps = np.flatnonzero((is_far & (speeds > FASTER * usual + BESIDES)).any(axis=1))
    if len(jumps):
        worst = jumps[np.argmax(moved[jumps, 0])]
        yield Finding(
            ERROR, 'jump', where,
            f'{counted(len(jumps), "jump")}, as of {moved[worst, 0]:.3g} m and'
            f' {moved[worst, 1]:.3g} rad in {seconds(stamps[worst, 1] - stamps[worst, 0])}',
            'give integrated odometry that is never reset or corrected: jumps of a localisation'
            ' belong into map -> odom', len(jumps), int(stamps[jumps[0], 1]))


def _covariances(where: str, topic: OdometrySeries) -> Iterator[Finding]:
    # Nothing is moved by the first.
    later = np.array(topic.stamps) > min(topic.stamps, default=0)
    variances = np.array(topic.variances).reshape(-1, 3)[later]
    variances = variances[np.isfinite(variances).all(axis=1) & (variances >= 0.0).all(axis=1)]
    if not len(variances):
        return
    unknown = ~variances.any(axis=1)
    if unknown.any():
        yield Finding(
            WARNING, 'unknown_covariance', where,
            f'twist.covariance is zero in {unknown.sum()} of {len(variances)} messages, so that'
            ' the parameter odometry_sigma counts',
            'fill the (vx, vy, wz) entries of twist.covariance, or set odometry_sigma to what the'
            ' odometry is worth and check it with fej_slam calibrate', int(unknown.sum()))
    known = variances[~unknown]
    sigma = np.sqrt(known)
    names = np.array(['vx', 'vy', 'wz'])
    # A robot that cannot go sideways may well claim so.
    certain = (sigma < SMALLEST_SIGMA) & (np.array([True, False, True]) | (known > 0.0))
    for wrong, is_like, why in (
            (certain, 'below', 'no observation would correct it'),
            (sigma > LARGEST_SIGMA, 'above', 'it would tell nothing')):
        if wrong.any():
            limit = SMALLEST_SIGMA if is_like == 'below' else LARGEST_SIGMA
            which = ', '.join(names[wrong.any(axis=0)])
            yield Finding(
                ERROR, 'absurd_covariance', where,
                f'twist.covariance claims a standard deviation of {which} {is_like}'
                f' {limit[wrong.any(axis=0)].max():g} in {wrong.any(axis=1).sum()} of'
                f' {len(variances)} messages: {why}',
                'fill in the variances (not standard deviations) of vx, vy [m^2/s^2] and wz'
                ' [rad^2/s^2], or all zero where they are unknown', int(wrong.any(axis=1).sum()))
