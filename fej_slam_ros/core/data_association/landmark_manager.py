# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks without identity: numbers for what is seen, and which of them count.

What nobody has numbered is numbered here, downwards from -2, so that no number is ever taken for
one that a robot knows. A new landmark is provisional until it has been seen again and again; what
was clutter is forgotten. Two landmarks that are found to be one are merged.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from fej_slam_ros.core.data_association.duplicate_landmarks import merge_duplicates
from fej_slam_ros.core.data_association.joint_compatibility import JointCompatibilityMatcher
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import (
    JointState, Landmark, position_indices, Robot, TentativeEvidence)
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import LandmarkKey, NO_ID, Observation, Scan

#: A provisional landmark counts when it was seen so much oftener again than it was missed, and is
#: forgotten when the robot that started it has not seen it for so many scans.
SETTLED_AT = 3
FORGOTTEN_AFTER = 20

#: What is within these parts of the largest range and bearing of a robot's observations should be
#: seen, and then is with this probability.
SURE_RANGE = 0.8
SURE_BEARING = 0.9
DETECTED = 0.9


@dataclass(slots=True)
class FieldOfView:
    """How far [m] and how far to the side [rad] a robot has ever seen a landmark."""

    range: float = 1.0
    bearing: float = 0.5

    def widen(self, observations: Sequence[Observation]) -> None:
        """Take in what was seen."""
        for x, y in (observation.z for observation in observations):
            self.range = max(self.range, math.hypot(x, y))
            self.bearing = max(self.bearing, abs(math.atan2(y, x)))

    def area(self) -> float:
        """Return how much ground it covers [m^2]."""
        return self.bearing * self.range**2

    def surely_holds(
        self, state: JointState, robot: Robot, landmarks: Sequence[Landmark]
    ) -> Flags:
        """Return which landmarks a robot should see, (l,)."""
        poses = np.broadcast_to(state.estimate(robot), (len(landmarks), 3))
        x, y = h(poses, state.estimates_of(position_indices(landmarks))).T
        near = np.hypot(x, y) <= SURE_RANGE * self.range
        sure: Flags = near & (np.abs(np.arctan2(y, x)) <= SURE_BEARING * self.bearing)
        return sure


@dataclass(frozen=True, slots=True, eq=False)
class AssociatedScan:
    """A scan in which every observation has a number."""

    given: Scan  #: the observations that had a number
    numbered: Scan  #: those that had none, and have one now
    doubtful: Sequence[Observation] = ()  #: what else was seen
    maybe_seen: Sequence[Landmark] = ()  #: landmarks that this may be of


@dataclass(slots=True)
class LandmarkManager:
    """What became of observations without identity."""

    last: int = NO_ID  #: the number that was given last
    views: dict[str, FieldOfView] = field(default_factory=dict)  #: what each robot sees
    #: of each robot, how many observations were ``matched``, ``new`` or ``doubtful``, and how many
    #: landmarks its scans let be ``settled``, ``forgotten`` or ``merged``
    counts: dict[str, Counter[str]] = field(default_factory=dict)

    def named(self, group: Filter, matcher: JointCompatibilityMatcher, scan: Scan) -> AssociatedScan:
        """Return a scan of a robot that is in a group, with the observations numbered."""
        unknown = [s for s in scan.observations if s.id == NO_ID]
        view = self.views.setdefault(scan.robot, FieldOfView())
        # While all have numbers nobody needs to know how far they are seen.
        if unknown or self.last != NO_ID:
            view.widen(scan.observations)
        if not unknown:
            return AssociatedScan(scan, Scan(scan.robot, scan.stamp, ()))
        given = tuple(s for s in scan.observations if s.id != NO_ID)
        robot = group.state.robots[scan.robot]
        taken = {group.landmark_key(scan.robot, s.id) for s in given}
        landmarks = [
            landmark for key, landmark in group.state.landmarks.items()
            if key not in taken and key == group.landmark_key(scan.robot, key[1])]
        found = matcher.match(
            group.state, group.linearization, robot, unknown, landmarks,
            _odds(view, group.state, robot, landmarks, len(unknown)))
        matched = [
            replace(unknown[i], id=landmark.key[1]) for i, landmark in found.landmarks.items()]
        new = [replace(unknown[i], id=self._fresh()) for i in found.new]
        doubtful = [unknown[i] for i in found.doubtful]
        self._count(scan.robot, matched=len(matched), new=len(new), doubtful=len(doubtful))
        return AssociatedScan(
            replace(scan, observations=given), replace(scan, observations=(*matched, *new)), doubtful,
            found.maybe_seen)

    def judge(self, group: Filter, named: AssociatedScan) -> None:
        """Let a scan settle or forget landmarks, or find two to be one."""
        if self.last == NO_ID:
            return
        state, name = group.state, named.given.robot
        keys = [
            group.landmark_key(name, s.id)
            for s in (*named.given.observations, *named.numbered.observations)]
        seen = [state.landmarks[key] for key in keys if key in state.landmarks]
        for landmark in seen:
            self._see_again(state.robots[name], landmark)
        told = {f.key for f in (*seen, *named.maybe_seen)}
        self._miss(state, state.robots[name], {
            key: f.tentative for key, f in state.landmarks.items()
            if f.tentative is not None and key not in told})
        merged = merge_duplicates(
            group, [*seen, *named.maybe_seen], [f for f in seen if not f.tentative])
        self._count(name, merged=merged)

    def unite(self, group: Filter, robot: str) -> None:
        """Let landmarks of frames be one where a robot has brought them together."""
        while merged := merge_duplicates(group, group.state.confirmed_landmarks()):
            self._count(robot, merged=merged)

    def _see_again(self, robot: Robot, landmark: Landmark) -> None:
        tentative = landmark.tentative
        if tentative is not None and landmark.created < robot.stamp:
            tentative.score, tentative.unobserved = tentative.score + 1, 0
            if tentative.score >= SETTLED_AT:
                landmark.tentative = None
                self._count(robot.name, settled=1)

    def _miss(
        self, state: JointState, robot: Robot, missed: Mapping[LandmarkKey, TentativeEvidence]
    ) -> None:
        """Let a robot not have seen provisional landmarks, of which some are forgotten then."""
        landmarks = [state.landmarks[key] for key in missed]
        sure = self.views[robot.name].surely_holds(state, robot, landmarks)
        for landmark, tentative, should_be_seen in zip(landmarks, missed.values(), sure):
            tentative.score -= int(should_be_seen)
            tentative.unobserved += landmark.owner not in state.robots.keys() - {robot.name}
            if tentative.score < 0 or tentative.unobserved >= FORGOTTEN_AFTER:
                state.remove(landmark)
                self._count(robot.name, forgotten=1)

    def _fresh(self) -> int:
        self.last -= 1
        return self.last

    def _count(self, robot: str, **events: int) -> None:
        self.counts.setdefault(robot, Counter()).update(events)


def _odds(
    view: FieldOfView, state: JointState, robot: Robot, landmarks: Sequence[Landmark], observations: int
) -> Array:
    """
    Return how often each landmark is seen for once that something unknown is, as `Pairs.odds`.

    What should be seen is missed seldom; of all else nobody knows how often. Something unknown is
    as dense as if all observations of the scan were of it.

    """
    surely = view.surely_holds(state, robot, landmarks) & np.array(
        [landmark.tentative is None for landmark in landmarks], bool)
    density = observations / view.area()
    return np.where(surely, math.log(DETECTED / (1.0 - DETECTED)), 0.0) - math.log(
        2.0 * math.pi * density)
