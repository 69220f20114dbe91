# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks without identity: numbers for what is seen, and which of them count.

What nobody has numbered is numbered here, downwards from -2, so that no number is ever taken for
one that a robot knows. A new landmark is provisional until it has been seen again and again; what
was clutter is forgotten. Two landmarks that are found to be one are merged.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
import math

import numpy as np

from fej_slam_ros.core.filter import Filter
from fej_slam_ros.core.gating import squared_distances
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.matching import Matcher
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import NO_ID, Scan, Sighting
from fej_slam_ros.core.state import Landmark, Robot

#: A provisional landmark counts when it was seen so much oftener again than it was missed.
CONFIRMED_AT = 3

#: What is within these parts of the largest range and bearing of a robot's sightings should be
#: seen.
SURE_RANGE = 0.8
SURE_BEARING = 0.9

SURE_ODDS = math.log(0.9 / 0.1)

#: Landmarks are one where that is so much likelier than that they are two.
ONE_WHERE_LIKELIER = 100.0

#: A provisional landmark that was not seen for so many scans of its robot is forgotten.
FORGOTTEN_AFTER = 20


@dataclass(slots=True)
class View:
    """How far [m] and how far to the side [rad] a robot has ever seen a landmark."""

    range: float = 1.0
    bearing: float = 0.5

    def widen(self, sightings: Sequence[Sighting]) -> None:
        """Take in what was seen."""
        for z in (sighting.z for sighting in sightings):
            self.range = max(self.range, math.hypot(*z))
            self.bearing = max(self.bearing, abs(math.atan2(z[1], z[0])))

    def area(self) -> float:
        """Return how large it is [m^2]."""
        return self.bearing * self.range**2

    def odds(self, state, robot, landmarks) -> Array:
        if not landmarks:
            return np.empty(0)
        x = state.estimate(robot)
        z = h(x[None], state.x_hat[state.positions(landmarks)])
        near = np.hypot(*z.T) <= SURE_RANGE * self.range
        sure = near & (np.abs(np.arctan2(z[:, 1], z[:, 0])) <= SURE_BEARING * self.bearing)
        counts = np.array([f.provisional is None for f in landmarks])
        return np.where(sure & counts, SURE_ODDS, 0.0)

    def surely_holds(self, z: Array) -> bool:
        """Return whether a point (2,) in the base frame should be seen."""
        near = math.hypot(*z) <= SURE_RANGE * self.range
        return near and abs(math.atan2(z[1], z[0])) <= SURE_BEARING * self.bearing


@dataclass(slots=True)
class Identities:
    """
    What became of sightings without identity.

    Attributes
    ----------
    last : the number that was given last
    views : what each robot sees
    counts : of each robot, how many sightings were ``matched``, ``new`` or ``doubtful``, and how
        many of its landmarks were ``forgotten`` or ``merged``

    """

    last: int = NO_ID
    views: dict[str, View] = field(default_factory=dict)
    counts: dict[str, Counter[str]] = field(default_factory=dict)

    def named(
        self, group: Filter, matcher: Matcher, scan: Scan
    ) -> tuple[Scan, list[Sighting], Sequence[Landmark]]:
        """
        Return a scan in which every sighting has a number.

        Returns
        -------
        named : the scan
        doubtful : what is not in it
        maybe_seen : landmarks that these may be of

        """
        robot = group.state.robots[scan.robot]
        given = [s for s in scan.sightings if s.id != NO_ID]
        unknown = [s for s in scan.sightings if s.id == NO_ID]
        keys = {group.landmark_key(scan.robot, s.id) for s in given}
        landmarks = [
            landmark for key, landmark in group.state.landmarks.items()
            if key not in keys and key[0] in ('', scan.robot)]
        view = self.views.setdefault(scan.robot, View())
        view.widen(scan.sightings)
        odds = view.odds(group.state, robot, landmarks) - math.log(
            2.0 * math.pi * len(unknown) / view.area())
        found = matcher.match(group.state, group.linearization, robot, unknown, landmarks, odds)
        matched = [
            replace(unknown[i], id=landmark.key[1]) for i, landmark in found.landmarks.items()]
        new = [replace(unknown[i], id=self._fresh()) for i in found.new]
        doubtful = [unknown[i] for i in found.doubtful]
        self.counts.setdefault(scan.robot, Counter()).update(
            matched=len(matched), new=len(new), doubtful=len(doubtful))
        return replace(scan, sightings=(*given, *matched, *new)), doubtful, found.maybe_seen

    def judge(self, group: Filter, scan: Scan, maybe_seen: Sequence[Landmark]) -> None:
        """Let a scan, all of it named, confirm or forget landmarks, or find two to be one."""
        state = group.state
        robot, seen = state.robots[scan.robot], {s.id for s in scan.sightings}
        view = self.views[scan.robot]
        untold = [f for f in state.landmarks.values() if f.provisional and f not in maybe_seen]
        for landmark in untold:
            if self._is_forgotten(group, robot, landmark, landmark.key[1] in seen, view):
                state.remove(landmark)
                self.counts[scan.robot]['forgotten'] += 1
        own = [f for f in state.landmarks.values() if f.key[1] in seen and f.key[1] < NO_ID]
        for landmark, other in duplicates(group, own):
            group.merge(*sorted((landmark, other), key=lambda f: -f.key[1]))
            self.counts[scan.robot]['merged'] += 1

    def _fresh(self) -> int:
        self.last -= 1
        return self.last

    @staticmethod
    def _is_forgotten(
        group: Filter, robot: Robot, landmark: Landmark, is_seen: bool, view: View
    ) -> bool:
        """Return whether a provisional landmark was clutter, as far as one scan more tells."""
        provisional = landmark.provisional
        assert provisional is not None
        if is_seen:
            provisional.score += landmark.started < robot.stamp
            provisional.unseen = 0
            if provisional.score >= CONFIRMED_AT:
                landmark.provisional = None
            return False
        x, f = group.state.estimate(robot), group.state.estimate(landmark)
        provisional.score -= view.surely_holds(h(x[None], f[None])[0])
        provisional.unseen += landmark.owner == robot.name
        return provisional.score < 0 or provisional.unseen >= FORGOTTEN_AFTER


def duplicates(group: Filter, seen: Sequence[Landmark]) -> list[tuple[Landmark, Landmark]]:
    """
    Return pairs of landmarks that are found to be one, of those that a scan shows and all others.

    What one scan shows is never one. Else they are where that is a hundred times as likely as
    that there are two so near to each other, given how far the next landmark is.
    """
    state = group.state
    for a, b in combinations(seen, 2):
        a.distinct.add(b.key)
        b.distinct.add(a.key)
    found: list[tuple[Landmark, Landmark]] = []
    everything = list(state.landmarks.values())
    places = state.x_hat[state.positions(everything)]
    for landmark in seen:
        away = np.hypot(*(places - state.estimate(landmark)).T)
        order = np.argsort(away, kind='stable')[1:3]
        if len(order) < 2:
            continue
        other, spacing = everything[order[0]], float(away[order[1]])
        taken = any(landmark in pair or other in pair for pair in found)
        if other.key not in landmark.distinct and not taken and _are_one(
            group, landmark, other, spacing
        ):
            found.append((landmark, other))
    return found


def _are_one(group: Filter, a: Landmark, b: Landmark, spacing: float) -> bool:
    d = group.state.estimate(a) - group.state.estimate(b)
    P = group.state.marginal([a, b])
    S = P[:2, :2] + P[2:, 2:] - P[:2, 2:] - P[2:, :2]
    d2 = float(squared_distances(d[None], S[None])[0])
    # Densities of d: of one landmark N(0, S), of two one within the circle to the next.
    likelier = math.exp(-0.5 * d2) * spacing**2 / (2.0 * math.sqrt(np.linalg.det(S)))
    return likelier > ONE_WHERE_LIKELIER
