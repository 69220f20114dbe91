# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Creation, confirmation, merging and deletion of landmarks observed without IDs.

Their IDs are assigned here, -2 and downwards, so that none is equal to an observed ID. A new
landmark is tentative; it is confirmed by repeated observations, or deleted as clutter.
"""

from bisect import insort
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from fej_slam_ros.core.data_association.constellations import can_be_found
from fej_slam_ros.core.data_association.duplicate_landmarks import merge_duplicates
from fej_slam_ros.core.data_association.failure_detection import ScanMatchStatistics
from fej_slam_ros.core.data_association.joint_compatibility import match_scan, MatchingResult
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.landmark_evidence import TentativeEvidence
from fej_slam_ros.core.ekf.state import JointState, Landmark, position_indices, Robot
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import LandmarkKey, NO_ID, Observation, Scan

#: Score (scans that observed it again, less those that missed it) at which a tentative landmark is
#: confirmed, and consecutive scans of its owner without it after which it is deleted.
CONFIRMATION_SCORE = 3
MAX_UNOBSERVED = 20

#: The largest ranges and bearings are outside of a robot's field of view, so that a single wrong
#: one does not extend it: one from MIN_VIEW_OBSERVATIONS observations on, one more for each
#: OUTSIDE_ONE_IN of them, and at most MAX_OUTSIDE.
MIN_VIEW_OBSERVATIONS, OUTSIDE_ONE_IN, MAX_OUTSIDE = 20, 1000, 100
#: Smallest field of view [m, rad].
MIN_VIEW_RANGE, MIN_VIEW_BEARING = 1.0, 0.5
#: Fractions of its range and bearing within which a landmark should be observed, and the
#: probability that it then is.
SURE_RANGE = 0.8
SURE_BEARING = 0.9
DETECTION_PROBABILITY = 0.9
#: Minimum share of such landmarks that a robot must have observed so far, and minimum number of
#: them, for missed ones to mean that it is lost. In Victoria Park, where trees hide each other,
#: the share is a third.
RELIABLE_SHARE, MIN_EXPECTED = 0.7, 100


@dataclass(slots=True)
class FieldOfView:
    """Range [m] and bearing [rad] within which a robot has made all but a few observations."""

    range: float = MIN_VIEW_RANGE
    bearing: float = MIN_VIEW_BEARING
    count: int = 0  #: number of observations
    farthest: list[float] = field(default_factory=list)  #: the largest ranges, increasing
    widest: list[float] = field(default_factory=list)  #: the largest bearings, increasing
    expected: int = 0  #: number of times that a confirmed landmark should have been observed
    found: int = 0  #: and was

    def widen(self, observations: Sequence[Observation]) -> None:
        """Extend the field of view to contain further observations."""
        for x, y in (observation.z for observation in observations):
            insort(self.farthest, math.hypot(x, y))
            insort(self.widest, abs(math.atan2(y, x)))
        self.count += len(observations)
        outside = self.count // OUTSIDE_ONE_IN + (self.count >= MIN_VIEW_OBSERVATIONS)
        for largest in (self.farthest, self.widest):
            del largest[:-MAX_OUTSIDE]
        if self.count:
            last = -1 - min(outside, MAX_OUTSIDE - 1)
            self.range = max(MIN_VIEW_RANGE, self.farthest[last])
            self.bearing = max(MIN_VIEW_BEARING, self.widest[last])

    def is_reliable(self) -> bool:
        """Return whether the robot has observed most landmarks that it should have."""
        return self.expected >= MIN_EXPECTED and self.found >= RELIABLE_SHARE * self.expected

    def add_expected(self, expected: int, missed: int) -> None:
        """Add a scan in which some of the landmarks that should have been observed were missed."""
        self.expected += expected
        self.found += expected - missed

    def area(self) -> float:
        """Return its area [m^2]."""
        return self.bearing * self.range**2

    def surely_contains(
        self, state: JointState, robot: Robot, landmarks: Sequence[Landmark]
    ) -> Flags:
        """Return which landmarks (l,) the robot should observe."""
        poses = np.broadcast_to(state.pose(robot), (len(landmarks), 3))
        x, y = h(poses, state.estimates_of(position_indices(landmarks))).T
        near = np.hypot(x, y) <= SURE_RANGE * self.range
        sure: Flags = near & (np.abs(np.arctan2(y, x)) <= SURE_BEARING * self.bearing)
        return sure


@dataclass(frozen=True, slots=True, eq=False)
class AssociatedScan:
    """A scan after data association."""

    with_ids: Scan  #: the observations that had an ID
    associated: Scan  #: those without, with the ID of an existing or of a new landmark
    statistics: ScanMatchStatistics  #: how well those without ID fit the map
    #: those without an unambiguous association, which are not used
    doubtful: Sequence[Observation] = ()
    candidates: Sequence[Landmark] = ()  #: landmarks that the doubtful ones may be of


@dataclass(slots=True)
class LandmarkManager:
    """Assigns IDs to observations without one, and manages their landmarks."""

    last: int = NO_ID  #: the ID that was assigned last
    views: dict[str, FieldOfView] = field(default_factory=dict)  #: the field of view of each robot
    #: for each robot the number of ``matched``, ``new`` and ``doubtful`` observations, and of
    #: landmarks that were ``settled`` (confirmed), ``forgotten`` (deleted) or ``merged``
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    #: the ID that a landmark has now, by one that it had before it was merged or its map joined
    replaced: dict[int, int] = field(default_factory=dict)

    def present_id(self, id_: int) -> int:
        """Return the present ID of a landmark that has or had an ID."""
        while id_ in self.replaced:
            id_ = self.replaced[id_]
        return id_

    def replace_ids(self, ids: Mapping[int, int]) -> None:
        """Note the IDs that landmarks have from now on, by those before."""
        for id_, present in ids.items():
            self.replaced[id_] = present
            self.replaced.pop(present, None)

    def associate(self, filter_: Filter, scan: Scan, probability: float) -> AssociatedScan:
        """Associate the observations without ID of a scan; `probability` as of `match_scan`."""
        unknown = [s for s in scan.observations if s.id == NO_ID]
        view = self.views.setdefault(scan.robot, FieldOfView())
        # The field of view is not needed as long as all observations have IDs.
        if unknown or self.last != NO_ID:
            view.widen(scan.observations)
        if not unknown:
            return AssociatedScan(
                scan, Scan(scan.robot, scan.stamp, ()),
                ScanMatchStatistics(used=len(scan.observations)))
        with_ids = tuple(s for s in scan.observations if s.id != NO_ID)
        landmarks = _landmarks_for(filter_, scan.robot, with_ids)
        is_expected = view.surely_contains(
            filter_.state, filter_.state.robots[scan.robot], landmarks
        ) & np.array([landmark.tentative is None for landmark in landmarks], bool)
        result = _matched(
            filter_, scan.robot, unknown, landmarks, _log_odds(view, is_expected, len(unknown)),
            probability)
        expected = [f for f, is_sure in zip(landmarks, is_expected) if is_sure]
        missed = _count_missed(expected, result)
        view.add_expected(len(expected), missed)
        statistics = _statistics(result, with_ids)
        if view.is_reliable():
            statistics = replace(statistics, expected=len(expected), missed=missed)
        return self._with_assigned_ids(scan, unknown, with_ids, result, statistics)

    def _with_assigned_ids(
        self, scan: Scan, unknown: Sequence[Observation], with_ids: tuple[Observation, ...],
        result: MatchingResult, statistics: ScanMatchStatistics,
    ) -> AssociatedScan:
        """Return a scan with IDs of matched and of new landmarks for its unknown observations."""
        matched = [
            replace(unknown[i], id=landmark.key[1]) for i, landmark in result.landmarks.items()]
        new = [replace(unknown[i], id=self._new_id()) for i in result.new]
        doubtful = [unknown[i] for i in result.doubtful]
        self._count(scan.robot, matched=len(matched), new=len(new), doubtful=len(doubtful))
        return AssociatedScan(
            replace(scan, observations=with_ids), replace(scan, observations=(*matched, *new)),
            statistics, doubtful, result.candidates)

    def update_tentative(self, filter_: Filter, scan: AssociatedScan) -> None:
        """Confirm, delete and merge landmarks by a scan that the filter has been updated with."""
        if self.last == NO_ID:
            return
        state, robot = filter_.state, filter_.state.robots[scan.with_ids.robot]
        keys = filter_.landmark_keys(robot.name, [
            s.id for s in (*scan.with_ids.observations, *scan.associated.observations)])
        observed = [state.landmarks[key] for key in keys if key in state.landmarks]
        for landmark in observed:
            self._add_hit(robot, landmark)
        candidates = [f for f in scan.candidates if f.key in state.landmarks]
        not_missed = {f.key for f in (*observed, *candidates)}
        self._add_misses(state, robot, {
            key: f.tentative for key, f in state.landmarks.items()
            if f.tentative is not None and key not in not_missed})
        merged = merge_duplicates(
            filter_, [*observed, *candidates], [f for f in observed if not f.tentative])
        self._add_merged(robot.name, merged)

    def merge(self, filter_: Filter, robot: str) -> None:
        """
        Merge duplicate landmarks after a robot's frame has been joined.

        Maps whose robots have all left keep theirs until a frame with a robot joins.

        """
        while filter_.state.robots and (
                merged := merge_duplicates(filter_, filter_.state.confirmed_landmarks())):
            self._add_merged(robot, merged)

    def _add_merged(self, robot: str, merged: Mapping[int, int]) -> None:
        self.replace_ids(merged)
        self._count(robot, merged=len(merged))

    def _add_hit(self, robot: Robot, landmark: Landmark) -> None:
        """Add an observation to a tentative landmark's evidence, which may confirm it."""
        tentative = landmark.tentative
        if tentative is not None and landmark.created < robot.stamp:
            tentative.score, tentative.unobserved = tentative.score + 1, 0
            if tentative.score >= CONFIRMATION_SCORE:
                landmark.tentative = None
                self._count(robot.name, settled=1)

    def _add_misses(
        self, state: JointState, robot: Robot, missed: Mapping[LandmarkKey, TentativeEvidence]
    ) -> None:
        """Add a missing observation to tentative landmarks' evidence, which may delete them."""
        landmarks = [state.landmarks[key] for key in missed]
        sure = self.views[robot.name].surely_contains(state, robot, landmarks)
        forgotten = []
        for landmark, tentative, should_be_observed in zip(landmarks, missed.values(), sure):
            tentative.score -= int(should_be_observed)
            tentative.unobserved += landmark.owner not in state.robots.keys() - {robot.name}
            if tentative.score < 0 or tentative.unobserved >= MAX_UNOBSERVED:
                forgotten.append(landmark)
                self._count(robot.name, forgotten=1)
        state.remove_all(forgotten)

    def _new_id(self) -> int:
        self.last -= 1
        return self.last

    def _count(self, robot: str, **events: int) -> None:
        self.counts.setdefault(robot, Counter()).update(events)


def _landmarks_for(
    filter_: Filter, robot: str, with_ids: Sequence[Observation]
) -> list[Landmark]:
    """Return the landmarks that a robot's observations without ID may be of, beside others."""
    landmarks = filter_.state.landmarks
    observed = {*filter_.landmark_keys(robot, [s.id for s in with_ids])}
    observable = filter_.landmark_keys(robot, [id_ for _, id_ in landmarks])
    return [
        landmark for (key, landmark), of_robot in zip(landmarks.items(), observable)
        if key == of_robot and key not in observed]


def _matched(
    filter_: Filter, name: str, unknown: Sequence[Observation], landmarks: Sequence[Landmark],
    log_odds: Array, probability: float,
) -> MatchingResult:
    """Return the matches of a robot's observations, none if its heading is too uncertain."""
    state, robot = filter_.state, filter_.state.robots[name]
    result = match_scan(
        state, filter_.linearization, robot, unknown, landmarks, log_odds, probability)
    # A linear update cannot correct the heading by so much, a join can.
    has_turned = robot.turn_variance > filter_.linearization.max_turn_sigma_without_ids ** 2
    return result.without_matches() if has_turned and can_be_found(state) else result


def _log_odds(view: FieldOfView, is_expected: Flags, count: int) -> Array:
    """
    Return `CandidatePairs.log_odds` (l,) of landmarks in a scan of `count` unknown observations.

    A confirmed landmark that should be observed is missed rarely, any other one half of the time.
    The density of unknown objects is that of all the observations in the field of view.

    """
    density = count / view.area()
    detected = math.log(DETECTION_PROBABILITY / (1.0 - DETECTION_PROBABILITY))
    return np.where(is_expected, detected, 0.0) - math.log(2.0 * math.pi * density)


def _count_missed(expected: Sequence[Landmark], result: MatchingResult) -> int:
    """Return how many landmarks that should have been observed no observation may be of."""
    not_missed = {f.key for f in (*result.landmarks.values(), *result.candidates)}
    return sum(landmark.key not in not_missed for landmark in expected)


def _statistics(
    result: MatchingResult, with_ids: Sequence[Observation]
) -> ScanMatchStatistics:
    """Return how well the observations of a scan fit the map."""
    matched = result.landmarks.values()
    tentative = sum(landmark.tentative is not None for landmark in matched)
    return ScanMatchStatistics(
        len(matched) + len(with_ids), len(result.doubtful), len(result.new) + tentative)
