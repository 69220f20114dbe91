# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Collaborative smoothing and mapping, section IV of [Andersson]: joining the maps of a team.

Each robot has smoothed its trajectory and map in its own frame. Shared landmarks or robot-to-robot
observations give the base node of one map in another (Algorithm 1); the minimum of eq. (21) over
all poses and landmarks is the joint map, in which duplicate landmarks are merged (Algorithm 2).
Joined robots then act as one map, so that any number of robots can be joined.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES, JoinRules
from fej_slam_ros.core.csam.landmark_matching import match_landmarks
from fej_slam_ros.core.csam.loop_closing import close_loops, with_measurements
from fej_slam_ros.core.csam.maps import JointMap, merged
from fej_slam_ros.core.csam.odometry_links import MIN_PER_LINK, ReleasedOdometry
from fej_slam_ros.core.csam.outlier_removal import Outlier, without_landmarks
from fej_slam_ros.core.csam.rendezvous import (
    Failed, Measurements, outlier_report, Rendezvous, rendezvous_of, RendezvousMeasurement,
    RobotPair)
from fej_slam_ros.core.csam.rendezvous_alignment import RendezvousAligner
from fej_slam_ros.core.csam.shared_landmarks import (
    LandmarkAlignment, SharedLandmarks, variance_factor)
from fej_slam_ros.core.csam.slips import explained_loops
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import LandmarkKey


@dataclass(frozen=True, slots=True)
class ScaledJoin:
    """Two maps of different scales that were joined."""

    robots: tuple[str, ...]  #: robots of the first map
    others: tuple[str, ...]  #: robots of the second
    scale: float  #: lengths in the first map, divided by those in the second


class JoinedMaps(NamedTuple):
    """Result of joining maps."""

    maps: list[JointMap]  #: each robot is in one of them
    #: rendezvous, or single observations, that were not used, and landmarks that were not merged
    failures: list[JoinFailure]
    #: observations by robot of landmarks that contradicted those of the other map
    outliers: dict[str, list[Outlier]]
    released: list[ReleasedOdometry]  #: odometry of robots whose wheels slipped
    scaled: list[ScaledJoin]  #: maps whose scales differ

    def copy(self) -> 'JoinedMaps':
        """Return the same maps and reports, to which others may be added."""
        outliers = {robot: [*of_robot] for robot, of_robot in self.outliers.items()}
        return JoinedMaps(
            [*self.maps], [*self.failures], outliers, [*self.released], [*self.scaled])


def join_maps(
    maps: Sequence[JointMap], measurements: Measurements, rules: JoinRules = DEFAULT_RULES
) -> JoinedMaps:
    """
    Return the maps after joining, given each robot's own map at its minimum.

    The robot-to-robot observations are in the order of time. A joint map has the frame of its
    first one.

    """
    merger = _MapMerger(maps, measurements, rules)
    failed = merger.explain_by_slips(merger.apply(rendezvous_of(maps, measurements)))
    # Rendezvous with too few observations may suffice together.
    pooled: dict[RobotPair, list[RendezvousMeasurement]] = {}
    for rendezvous, _ in failed:
        pooled.setdefault(rendezvous.robots, []).extend(rendezvous.measurements)
    failed = merger.apply([Rendezvous(*of_pair) for of_pair in pooled.items()])
    matched = [*map(_matched, merger.result.maps)]
    return merger.result._replace(
        maps=[joint for joint, _ in matched],
        failures=[
            *merger.result.failures,
            *(replace(failure, robots=rendezvous.robots) for rendezvous, failure in failed),
            *(failure for _, failure in matched if failure is not None)])


def _matched(joint: JointMap) -> tuple[JointMap, JoinFailure | None]:
    """Return a map with merged duplicate landmarks, or as it is with the reason."""
    try:
        return match_landmarks(joint), None
    except NoMinimumError as error:
        return joint, JoinFailure(
            f'duplicate landmarks are not merged: {error}', robots=tuple(joint.robots))


class _MapMerger:
    """
    Groups of joined robots, each with one map.

    Attributes
    ----------
    result : the map of each group, and the reports so far; rendezvous that fail are none of these

    """

    def __init__(
        self, maps: Sequence[JointMap], measurements: Measurements, rules: JoinRules
    ) -> None:
        self.result = JoinedMaps([*maps], [], {}, [], [])
        self._rules = replace(rules, variance_factor=variance_factor(maps, rules.min_shared))
        self._aligner = RendezvousAligner(measurements, self._rules)
        #: why maps were not joined by their landmarks, which no rendezvous changes
        self._not_joined: dict[tuple[JointMap, JointMap], JoinFailure] = {}

    def apply(self, attempted: Sequence[Rendezvous]) -> list[Failed]:
        """Apply rendezvous until no more of them succeed; return those that failed."""
        failed: list[Failed] = []
        loops: list[Rendezvous] = []
        for rendezvous in attempted:
            p, *others = self._groups_of(rendezvous)
            closes_loop = not others or self._join(p, others[0], rendezvous, attempted)
            if isinstance(closes_loop, JoinFailure):
                failed.append((rendezvous, closes_loop))
            elif closes_loop:
                loops.append(rendezvous)
        failed += self._close_loops(loops)
        # A rendezvous that fails may succeed after others have joined its robots.
        if len(failed) in {0, len(attempted)}:
            return failed
        return self.apply([rendezvous for rendezvous, _ in failed])

    def explain_by_slips(self, failed: Sequence[Failed]) -> list[Failed]:
        """Apply rendezvous that failed if a slip of a robot explains it; return the others."""
        failed = self._with_slips(failed)
        for rendezvous, failure in failed:
            if self._joined_with_slip(rendezvous, failure):
                others = [other for other, _ in failed if other is not rendezvous]
                return self.explain_by_slips(self.apply(others))
        return failed

    def _with_slips(self, failed: Sequence[Failed]) -> list[Failed]:
        """Close loops that failed, where a slip explains it; return the other rendezvous."""
        left = [*failed]
        for k in range(len(self.result.maps)):
            while True:
                group = self.result.maps[k]
                own = _within(group, [loop for loop, _ in left])
                explained = explained_loops(group, own, self._rules)
                if explained is None:
                    break
                self._aligner.forget(group)
                self.result.maps[k] = explained.closed.joint
                self.result.released.append(explained.released)
                self.result.failures.extend(explained.closed.outliers)
                robot = explained.released.robot
                left = [
                    (loop, failure) for loop, failure in left
                    if not (loop in own and robot in loop.robots)]
                left += explained.closed.failed
        return left

    def _joined_with_slip(self, rendezvous: Rendezvous, failure: JoinFailure) -> bool:
        """Join maps by half of a rendezvous if a slip explains why the other half fails."""
        p, *others = self._groups_of(rendezvous)
        measurements = rendezvous.measurements
        if not others or len(measurements) < 2 * MIN_PER_LINK:
            return False
        before, middle = self.result, len(measurements) // 2
        halves = [
            rendezvous._replace(measurements=half)
            for half in (measurements[:middle], measurements[middle:])]
        for half, other in (halves, halves[::-1]):
            self.result = before.copy()
            joined = self._join(p, others[0], half, ())
            if not isinstance(joined, JoinFailure) and not self._with_slips([(other, failure)]):
                return True
        self.result = before
        return False

    def _close_loops(self, loops: Sequence[Rendezvous]) -> list[Failed]:
        failed: list[Failed] = []
        for k, group in enumerate(self.result.maps):
            closed = close_loops(group, _within(group, loops), self._rules)
            if closed.joint is not group:
                self._aligner.forget(group)
            self.result.maps[k] = closed.joint
            self.result.failures.extend(closed.outliers)
            failed += closed.failed
        return failed

    def _groups_of(self, rendezvous: Rendezvous) -> list[JointMap]:
        """Return the one or two groups that the robots of a rendezvous are in."""
        return [g for g in self.result.maps if not set(rendezvous.robots).isdisjoint(g.robots)]

    def _join(
        self, p: JointMap, q: JointMap, rendezvous: Rendezvous, attempted: Sequence[Rendezvous]
    ) -> JoinFailure | bool:
        """
        Join maps by shared landmarks, or else by the rendezvous.

        Returns whether the rendezvous is to close a loop, as after a join by landmarks, or why the
        maps are not joined. A rendezvous that most of those attempted between the maps contradict
        does not join them.

        """
        shared = SharedLandmarks(p, q, self._rules.min_shared)
        aligned = shared.align()
        if isinstance(aligned, JoinFailure):
            joined = aligned if not rendezvous.measurements else (
                self._aligner.contradiction(p, q, rendezvous, attempted)
                or self._joined_by_rendezvous(p, q, rendezvous))
        else:
            joined = self._not_joined.get((p, q)) or self._joined_by_landmarks(shared, aligned)
            if isinstance(joined, JoinFailure):
                self._not_joined[p, q] = joined
        if isinstance(joined, JoinFailure):
            return joined
        self.result.maps[:] = [joined if g is p else g for g in self.result.maps if g is not q]
        for part in (p, q):
            part.problem.forget_systems()
            self._aligner.forget(part)
        return not isinstance(aligned, JoinFailure)

    def _joined_by_landmarks(
        self, shared: SharedLandmarks, aligned: LandmarkAlignment
    ) -> JointMap | JoinFailure:
        """
        Return the joined maps.

        A few landmarks that contradict the others, as from misread IDs, are left out of the map
        with fewer observations of them.

        """
        joined = self._joined_in_any_scale(shared, aligned)
        if not isinstance(joined, JoinFailure):
            return joined
        d2 = shared.contradicting(self._rules)
        if not d2:
            return joined
        by_p, by_q = (_observations_of(part, d2) for part in (shared.p, shared.q))
        of_p = {key: d2[key] for key in d2 if by_p[key] < by_q[key]}
        of_q = {key: d2[key] for key in d2 if key not in of_p}
        limit = self._rules.landmark_limit()
        p, outliers_p = without_landmarks(shared.p, of_p, limit)
        q, outliers_q = without_landmarks(shared.q, of_q, limit)
        others = SharedLandmarks(p, q, self._rules.min_shared)
        aligned_by_others = others.align()
        if isinstance(aligned_by_others, JoinFailure):
            return joined
        again = self._joined_in_any_scale(others, aligned_by_others)
        if not isinstance(again, JoinFailure):
            for robot, outliers in (outliers_p | outliers_q).items():
                self.result.outliers.setdefault(robot, []).extend(outliers)
        return again

    def _joined_in_any_scale(
        self, shared: SharedLandmarks, aligned: LandmarkAlignment
    ) -> JointMap | JoinFailure:
        """Return the joined maps, also if they contradict each other in their scale."""
        p, q = shared.p, shared.q
        joined = self._joined(p, q, aligned.base_node)
        if not isinstance(joined, JoinFailure):
            return joined
        scaled = shared.align_but_for_scale(self._rules)
        if scaled is None:
            return joined
        try:
            compromise = merged(p, q, scaled.base_node).solved()
        except NoMinimumError:
            return joined
        self.result.scaled.append(ScaledJoin(tuple(p.robots), tuple(q.robots), scaled.scale))
        return compromise

    def _joined_by_rendezvous(
        self, p: JointMap, q: JointMap, rendezvous: Rendezvous
    ) -> JointMap | JoinFailure:
        """Return the joined maps, leaving out a few outliers at most."""
        aligned = self._aligner.align(p, q, rendezvous.measurements)
        if isinstance(aligned, JoinFailure):
            return aligned
        base_node, kept = aligned
        joined = self._joined(p, q, base_node.pose, kept)
        if len(kept) < len(rendezvous.measurements) and not isinstance(joined, JoinFailure):
            self.result.failures.append(outlier_report(rendezvous, len(kept)))
        return joined

    def _joined(
        self, p: JointMap, q: JointMap, base_node: Array, measurements: Measurements = ()
    ) -> JointMap | JoinFailure:
        """Return the minimum of eq. (21), from a base node (3,), if all measurements fit."""
        try:
            joint = with_measurements(merged(p, q, base_node), measurements).solved()
        except NoMinimumError as error:
            return JoinFailure(f'cannot align: {error}')
        increase = joint.chi_square - (p.chi_square + q.chi_square)
        failure = self._rules.inconsistency(increase, joint.dof - p.dof - q.dof)
        if failure is None:
            return joint
        # Wrong observations of robots leave no trace in the landmarks.
        cure = '' if measurements else SharedLandmarks(
            p, q, self._rules.min_shared).cure_of_contradiction()
        return replace(failure, reason=failure.reason + cure)


def _within(group: JointMap, attempted: Iterable[Rendezvous]) -> list[Rendezvous]:
    """Return the rendezvous with observations between robots of one map."""
    return [
        rendezvous for rendezvous in attempted
        if rendezvous.measurements and {*rendezvous.robots} <= {*group.robots}]


def _observations_of(joint: JointMap, keys: Mapping[LandmarkKey, float]) -> Counter[LandmarkKey]:
    """Return the number of observations of some landmarks of a map."""
    index = joint.landmark_index()
    counts = np.bincount(joint.problem.landmarks.target, minlength=len(joint.landmarks))
    return Counter({key: int(counts[index[key]]) for key in keys})
