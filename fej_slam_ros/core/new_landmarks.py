# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks that a scan starts: a limited number, each observation left out with a reason."""

from collections.abc import Container, Sequence
from dataclasses import replace

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Association
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.pieces import must_end
from fej_slam_ros.core.records import Observation, Scan
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: Maximum number of landmarks that observations without ID of a scan start, so that the clutter of
#: one robot, which is deleted after 20 scans, does not fill a map of the default size.
MAX_NEW_WITHOUT_ID = 100
#: Number of landmarks for which a frame outside ``map`` always has room, so that its robots can
#: join: those of a few scans.
MIN_ROOM = 50


def room_for_landmarks(state: JointState, states: Sequence[JointState], limit: int) -> int:
    """
    Return how many more landmarks a state may have, of those of all frames, ``map`` first.

    All together have at most `limit`, but one outside ``map`` always has some by which it joins.

    """
    room = limit - sum(len(other.landmarks) for other in states)
    reserved = 0 if state is states[0] else MIN_ROOM - len(state.landmarks)
    return max(room, reserved, 0)


def start_landmarks(
    filter_: Filter, scan: Scan, most: int, reason: RejectionReason, statistics: InputStatistics
) -> list[Association]:
    """
    Start unknown landmarks of a scan with IDs; return the associations of its other observations.

    At most `most` landmarks are started; the observations of further ones are rejected for the
    given reason, and those that an ending process leaves out as interrupted.

    """
    if not scan.observations:
        return []
    if len(scan.observations) > most:
        ids = dict.fromkeys(s.id for s in _unknown_observations(filter_, scan))
        scan = _without(scan, [*ids][most:], reason, statistics)
    associations = filter_.start_landmarks([scan])
    if must_end():
        left_out = {s.id for s in _unknown_observations(filter_, scan)}
        _without(scan, left_out, RejectionReason.INTERRUPTED, statistics)
    return associations


def _unknown_observations(filter_: Filter, scan: Scan) -> list[Observation]:
    """Return the observations of landmarks that are not in the state."""
    keys = filter_.keys_of(scan)
    return [
        s for s, key in zip(scan.observations, keys) if key not in filter_.state.landmarks]


def _without(
    scan: Scan, ids: Container[int], reason: RejectionReason, statistics: InputStatistics
) -> Scan:
    """Return a scan without the observations of some IDs, which are rejected for a reason."""
    for observation in scan.observations:
        if observation.id in ids:
            statistics.reject_observation(
                Rejection(scan.robot, scan.stamp, reason, id=observation.id))
    return replace(scan, observations=tuple(s for s in scan.observations if s.id not in ids))
