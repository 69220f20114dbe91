# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether scans see something, with numbers, at distances and with covariances of this world."""

from collections.abc import Iterator

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.ros.doctor.findings import ERROR, Finding, WARNING
from fej_slam_ros.ros.doctor.survey import ObservationSeries

#: No sensor of landmarks sees so far in the median [m].
FARTHEST = 250.0
#: Nobody measures as well [m], and who measures worse than so many times the range measures
#: nothing.
SMALLEST_SIGMA = 1e-4
LARGEST_SIGMA = 3.0
#: Of so many numbers some are seen again, if they are kept.
NUMBERS = 10


def check(where: str, topic: ObservationSeries, all_joined: bool) -> Iterator[Finding]:
    """
    Yield what is wrong with scans; what the estimator refuses is told with its refusals.

    Parameters
    ----------
    where, topic : name of the topic and what is known of it
    all_joined : whether all robots come into one map, with the numbers that there are

    """
    if not topic.stamps:
        return
    ranges = np.concatenate([np.empty(0), *topic.ranges])
    if not len(ranges):
        yield Finding(
            WARNING, 'sees_nothing', where, f'all {len(topic.stamps)} scans are empty',
            'look into the detector: nothing was detected in the whole run', len(topic.stamps))
        return
    yield from _identities(where, topic, all_joined)
    middle = float(np.median(ranges[np.isfinite(ranges)])) if np.isfinite(ranges).any() else 0.0
    if middle > FARTHEST:
        yield Finding(
            ERROR, 'range', where, f'observations are {middle:.4g} m away in the median',
            'give x ahead and y to the left in metres, seen from the robot and not in map',
            len(ranges))
    variances = np.concatenate([np.empty((0, 2)), *topic.variances])
    yield from _covariances(where, variances, middle)


def _identities(where: str, topic: ObservationSeries, all_joined: bool) -> Iterator[Finding]:
    ids = np.concatenate([np.empty(0, np.int64), *topic.ids])
    if topic.id_types.keys() & {'f'}:
        yield Finding(
            ERROR, 'bad_cloud', where, 'the field id holds floats',
            'make the field id an int32 (PointField.INT32)', topic.id_types['f'])
        return
    if (ids == NO_ID).all():
        if all_joined:
            return
        lacks = 'there is no field id' if topic.id_types.keys() == {''} else 'all ids are -1'
        yield Finding(
            WARNING, 'no_identity', where,
            f'{lacks}: {len(ids)} observations are matched by where they are',
            'publish the numbers of landmarks where the detector tells them: robots cannot be'
            ' joined by landmarks without, and a lost robot stays lost', len(ids))
        return
    numbers, counts = np.unique(
        np.concatenate([np.unique(scan) for scan in topic.ids]), return_counts=True)
    named = numbers != NO_ID
    if named.sum() >= NUMBERS and counts[named].max() == 1:
        yield Finding(
            ERROR, 'never_seen_again', where,
            f'none of {named.sum()} numbers comes in a second scan',
            'give the number of the landmark, always the same, not one of the detection',
            int(named.sum()))


def _covariances(where: str, variances: Array, middle: float) -> Iterator[Finding]:
    variances = variances[np.isfinite(variances).all(axis=1)]
    unknown = ~variances.any(axis=1)
    total = len(variances)
    if unknown.any():
        yield Finding(
            WARNING, 'unknown_covariance', where,
            f'{unknown.sum()} of {total} observations have no covariance, so that the parameter'
            ' landmark_sigma counts',
            'publish var_x, cov_xy and var_y [m^2], or set landmark_sigma to what the detector is'
            ' worth and check it with fej_slam calibrate', int(unknown.sum()))
    known = variances[(variances > 0.0).all(axis=1)]
    for wrong, claim in (
            ((known < SMALLEST_SIGMA**2).any(axis=1), f'below {SMALLEST_SIGMA:g} m'),
            ((known > (LARGEST_SIGMA * max(middle, 1.0)) ** 2).any(axis=1),
             f'above {LARGEST_SIGMA:g} times the usual range')):
        if wrong.any():
            yield Finding(
                ERROR, 'absurd_covariance', where,
                f'{wrong.sum()} of {total} observations claim a standard deviation {claim}',
                'fill in variances in m^2, not standard deviations, or all zero where they are'
                ' unknown', int(wrong.sum()))
