# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of scans: plausible ranges and covariances, and usable landmark IDs."""

from collections.abc import Iterator

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.ros.doctor.findings import error, Finding, warning
from fej_slam_ros.ros.doctor.survey import ObservationSeries, Survey

#: Upper bound of the median range [m]; above it, units are wrong.
MAX_MEDIAN_RANGE = 250.0
#: Lower bound of a plausible standard deviation [m]; no landmark sensor is as precise.
MIN_OBSERVATION_SIGMA = 1e-4
#: Upper bound of a standard deviation, relative to the median range; above it carries no data.
MAX_RELATIVE_SIGMA = 3.0
#: Upper bound of the standard deviation of half of the observations, relative to their ranges;
#: above it Jacobians at first estimates are wrong.
MAX_FIRST_SIGMA = 0.3
#: Minimum number of IDs, each in one scan only, to report; a short run may observe fewer once.
MIN_SINGLE_IDS = 10


def check(where: str, topic: ObservationSeries, all_joined: bool) -> Iterator[Finding]:
    """Yield problems of the scans of a topic that the estimator accepts."""
    if not any(map(len, topic.ranges)):
        if topic.stamps:
            yield warning(
                'sees_nothing', where, f'all {len(topic.stamps)} scans are empty',
                'check the detector: it detected nothing in the whole run', len(topic.stamps))
        return
    ranges = np.concatenate(topic.ranges)
    yield from _ids(where, topic, all_joined)
    finite = ranges[np.isfinite(ranges)]
    median_range = float(np.median(finite)) if len(finite) else 0.0
    if median_range > MAX_MEDIAN_RANGE:
        yield error(
            'range', where, f'the median range of observations is {median_range:.4g} m',
            'give x (ahead) and y (left) in metres, in the frame of the robot and not in map',
            len(ranges))
    yield from _covariances(where, np.concatenate(topic.variances), median_range)


def check_first_estimates(robot: str, survey: Survey, filter_name: str) -> Iterator[Finding]:
    """Yield that observations are too coarse for a filter with Jacobians at first estimates."""
    where = f'{robot}/landmarks'
    topic = survey.observations(where)
    if filter_name != 'fej' or not topic.ranges:
        return
    ranges, variances = np.concatenate(topic.ranges), np.concatenate(topic.variances)
    is_known = np.isfinite(ranges) & (ranges > 0.0) & (variances > 0.0).all(axis=1)
    relative = np.sqrt(variances[is_known].sum(axis=1)) / ranges[is_known]
    if len(relative) and (median := float(np.median(relative))) > MAX_FIRST_SIGMA:
        yield warning(
            'coarse_observations', where,
            f'half of {len(relative)} observations have a standard deviation of {median:.0%} of'
            ' their range or more, and so do first estimates of landmarks, where fej linearises',
            'set filter: invariant', len(relative))


def _ids(where: str, topic: ObservationSeries, all_joined: bool) -> Iterator[Finding]:
    observed = np.concatenate(topic.ids)
    if topic.id_types.keys() & {'f'}:
        yield error(
            'bad_cloud', where, 'the field id holds floats',
            'make the field id an int32 (PointField.INT32)', topic.id_types['f'])
    elif (observed == NO_ID).all():
        if not all_joined:
            lacks = 'there is no field id' if topic.id_types.keys() == {''} else 'all IDs are -1'
            yield warning(
                'no_identity', where,
                f'{lacks}: {len(observed)} observations are matched by position only',
                'publish landmark IDs if the detector knows them: without IDs robots join and lost'
                ' ones return only by five landmarks or more at a place that looks like no other',
                len(observed))
    else:
        ids, scans = np.unique(
            np.concatenate([np.unique(scan) for scan in topic.ids]), return_counts=True)
        known = int((ids != NO_ID).sum())
        if known >= MIN_SINGLE_IDS and scans[ids != NO_ID].max() == 1:
            yield error(
                'never_seen_again', where, f'none of {known} IDs is in a second scan',
                'give the ID of the landmark, always the same, instead of one per detection',
                known)


def _covariances(where: str, variances: Array, median_range: float) -> Iterator[Finding]:
    variances = variances[np.isfinite(variances).all(axis=1)]
    unknown = ~variances.any(axis=1)
    total = len(variances)
    if unknown.any():
        yield warning(
            'unknown_covariance', where,
            f'{unknown.sum()} of {total} observations have no covariance: the parameter'
            ' landmark_sigma is used',
            'publish var_x, cov_xy and var_y [m^2], or calibrate landmark_sigma (fej_slam'
            ' calibrate)', int(unknown.sum()))
    known = variances[(variances > 0.0).all(axis=1)]
    largest = MAX_RELATIVE_SIGMA * max(median_range, 1.0)
    for wrong, bound in (
            ((known < MIN_OBSERVATION_SIGMA**2).any(axis=1), f'below {MIN_OBSERVATION_SIGMA:g} m'),
            ((known > largest**2).any(axis=1),
             f'above {MAX_RELATIVE_SIGMA:g} times the median range')):
        if wrong.any():
            yield error(
                'absurd_covariance', where,
                f'{wrong.sum()} of {total} observations have a standard deviation {bound}',
                'fill in variances in m^2, not standard deviations, or all zero if unknown',
                int(wrong.sum()))
