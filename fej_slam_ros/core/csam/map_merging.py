# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Collaborative smoothing and mapping, section IV of [Andersson]: joining the maps of a team.

Each robot has smoothed its trajectory and map in its own frame. Shared landmarks or robot-to-robot
observations give the base node of one map in another (Algorithm 1); the minimum of eq. (21) over
all poses and landmarks is the joint map, in which duplicate landmarks are merged (Algorithm 2).
Joined robots then act as one map, so that any number of robots can be joined.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile
from fej_slam_ros.core.csam.base_node import (
    align, central, inconsistency, RendezvousInformation, RendezvousObservations)
from fej_slam_ros.core.csam.landmark_matching import match_landmarks
from fej_slam_ros.core.csam.maps import JointMap, LocalMap, merged
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array, rigid_fit
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS, RendezvousKey
from fej_slam_ros.core.smoothing.least_squares import concatenated, RendezvousFactors, stacked

#: Observations in the middle of a rendezvous that align the maps; the joint map uses all.
ALIGNMENT_WINDOW = 50
#: Largest heading sigma [rad] of an alignment by landmarks; beyond it the iteration may start too
#: far away.
MAX_HEADING_SIGMA = 0.1
#: Observations per outlier that may be left out; with fewer, outliers cannot be identified.
MIN_PER_OUTLIER = 10
#: Longest time [ns] without observations within one rendezvous.
MAX_PAUSE = 20 * NS

#: Names of two robots.
RobotPair = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousMeasurement:
    """One robot-to-robot observation, a rendezvous-measurement of [Andersson]."""

    #: observer, pose: name of the observer, and index of its pose
    observer: str
    pose: int
    #: observed, observed_pose: name of the observed robot, and index of its pose
    observed: str
    observed_pose: int
    z: Array  #: (2,) array, position of the observed robot in the base frame of the observer [m]
    R: Array  #: (2, 2) array, covariance of z [m^2]
    stamp: int  #: time of both poses [ns]

    @property
    def key(self) -> RendezvousKey:
        """Return observer, observed robot and stamp."""
        return RendezvousKey(self.observer, self.observed, self.stamp)


#: Robot-to-robot observations in the order of time.
Measurements = Sequence[RendezvousMeasurement]
#: Two robots and the observations of one session; none if they only share landmarks.
Rendezvous = tuple[RobotPair, list[RendezvousMeasurement]]
#: A rendezvous that was not used, and why.
Failed = tuple[Rendezvous, JoinFailure]


@dataclass(frozen=True, slots=True)
class JoinRules:
    """Conditions for joining two maps."""

    min_shared: int = 3  #: smallest number of shared landmark keys that joins maps
    #: chi-square probability with which correct data is accepted; 1.0 accepts all
    probability: float = 1.0 - 1e-4


#: Rules that accept correct data with probability 1 - 1e-4.
DEFAULT_RULES = JoinRules()


def join_maps(
    maps: Sequence[LocalMap], measurements: Measurements, rules: JoinRules = DEFAULT_RULES
) -> tuple[list[JointMap], list[JoinFailure]]:
    """
    Return the maps after joining, each robot in one of them, and the failures.

    Parameters
    ----------
    maps : maps of all robots; a joint map has the frame of its first one
    measurements : robot-to-robot observations in the order of time
    rules : conditions for joining

    """
    joiner = _TeamJoiner(maps, rules)
    failed = joiner.apply(_sessions(maps, measurements))
    # Sessions with too few observations may suffice together.
    pooled: dict[RobotPair, list[RendezvousMeasurement]] = {}
    for (pair, session), _ in failed:
        pooled.setdefault(pair, []).extend(session)
    failed = joiner.apply([*pooled.items()])
    return (
        [match_landmarks(group).with_base_nodes() for group in joiner.groups],
        [*joiner.outliers, *(replace(failure, robots=pair) for (pair, _), failure in failed)])


def alignment_window(measurements: Measurements) -> Measurements:
    """Return the observations in the middle of a rendezvous that align the maps."""
    return measurements[central(len(measurements), ALIGNMENT_WINDOW)]


def rendezvous_between(
    p: JointMap, q: JointMap, measurements: Measurements
) -> tuple[RendezvousInformation, RendezvousInformation, RendezvousObservations]:
    """Return the input of Algorithm 1 for two maps."""
    ends = [((m.observer, m.pose), (m.observed, m.observed_pose)) for m in measurements]
    (poses_p, rows_p), (poses_q, rows_q) = (
        np.unique(np.array([
            group.first_poses[robot] + pose for pair in ends for robot, pose in pair
            if robot in group.robots], np.intp), return_inverse=True)
        for group in (p, q))
    by_p = np.array([m.observer in p.robots for m in measurements], bool)
    observations = RendezvousObservations(
        rows_p, rows_q, by_p, np.array([m.z for m in measurements]).reshape(-1, 2),
        np.array([m.R for m in measurements]).reshape(-1, 2, 2))
    return p.rendezvous_information(poses_p), q.rendezvous_information(poses_q), observations


class _TeamJoiner:
    """
    Groups of joined robots, each with one map.

    Attributes
    ----------
    groups : the maps
    outliers : failures of single observations of rendezvous that were applied

    """

    def __init__(self, maps: Sequence[LocalMap], rules: JoinRules) -> None:
        self.groups = [JointMap.of(local) for local in maps]
        self.outliers: list[JoinFailure] = []
        self._rules = rules

    def apply(self, sessions: Sequence[Rendezvous]) -> list[Failed]:
        """Apply rendezvous until no more of them succeed; return those that failed."""
        failed: list[Failed] = []
        loops = []
        for session in sessions:
            if any(set(session[0]) <= set(group.robots) for group in self.groups):
                loops.append(session)
            elif failure := self._apply_rendezvous(*session):
                failed.append((session, failure))
        failed += self._close_loops(loops)
        # A rendezvous that fails may succeed after others have joined its robots.
        if len(failed) in {0, len(sessions)}:
            return failed
        return self.apply([session for session, _ in failed])

    def _close_loops(self, sessions: Sequence[Rendezvous]) -> list[Failed]:
        """
        Use rendezvous of robots that are in one map; return those that contradict the rest.

        All are solved for at once, which takes as long as one of them.

        """
        failed: list[Failed] = []
        for p in list(self.groups):
            loops = [(pair, own) for pair, own in sessions if own and pair[0] in p.robots]
            while loops:
                try:
                    closed = _with_measurements(p, [m for _, own in loops for m in own]).solved()
                    chi_squares = closed.contradictions([len(own) for _, own in loops])
                except NoMinimumError as error:
                    failed += ((loop, JoinFailure(f'cannot align: {error}')) for loop in loops)
                    break
                contradicting = self._contradicting(loops, chi_squares)
                if not contradicting:
                    self.groups = [closed if g is p else g for g in self.groups]
                    break
                failed += ((loops[k], failure) for k, failure in contradicting.items())
                loops = [loop for k, loop in enumerate(loops) if k not in contradicting]
        return failed

    def _contradicting(
        self, loops: Sequence[Rendezvous], chi_squares: Sequence[float]
    ) -> dict[int, JoinFailure]:
        """Return the rendezvous that fail by most, by row: others may fail because of them."""
        failures: dict[int, JoinFailure] = {}
        excess: dict[int, float] = {}
        for k, ((_, own), chi_square) in enumerate(zip(loops, chi_squares)):
            failure = inconsistency(chi_square, 2 * len(own), self._rules.probability)
            if failure is not None:
                failures[k], excess[k] = failure, chi_square / (2 * len(own))
        least = max(excess.values(), default=0.0) / 2.0
        return {k: failure for k, failure in failures.items() if excess[k] >= least}

    def _apply_rendezvous(
        self, pair: RobotPair, measurements: Sequence[RendezvousMeasurement]
    ) -> JoinFailure | None:
        """Join the maps of two robots, leaving out a few outliers at most."""
        p, *others = (g for g in self.groups if not set(pair).isdisjoint(g.robots))
        kept = list(measurements)
        while isinstance(joined := self._join(p, others, kept), JoinFailure):
            removed = len(measurements) - len(kept)
            if joined.outlier is None or removed >= len(measurements) // MIN_PER_OUTLIER:
                return joined
            kept = [m for m in kept if m.key != joined.outlier]
        self.groups = [joined if g is p else g for g in self.groups if g not in others]
        if len(kept) < len(measurements):
            self.outliers.append(JoinFailure(
                f'{len(measurements) - len(kept)} of {len(measurements)} observations contradict'
                ' the rest', pair))
        return None

    def _join(
        self, p: JointMap, others: Sequence[JointMap], measurements: Measurements
    ) -> JointMap | JoinFailure:
        """Return p joined with another map."""
        q, = others
        base_node = _base_node_of_landmarks(p, q, self._rules.min_shared)
        if isinstance(base_node, JoinFailure) and measurements:
            base_node = self._base_node_of_rendezvous(p, q, alignment_window(measurements))
        if isinstance(base_node, JoinFailure):
            return base_node
        return self._solve(merged(p, q, base_node), [p, q], measurements)

    def _base_node_of_rendezvous(
        self, p: JointMap, q: JointMap, window: Measurements
    ) -> Array | JoinFailure:
        """Return the pose of q in p by Algorithm 1, if the observations fit the maps."""
        aligned = align(*rendezvous_between(p, q, window))
        if isinstance(aligned, JoinFailure):
            return aligned
        probability = self._rules.probability
        failure = inconsistency(aligned.chi_square, aligned.dof, probability)
        if failure is None:
            return aligned.base_node.pose
        worst = int(np.argmax(aligned.d2))
        if aligned.d2[worst] <= chi_square_quantile(2, probability):
            return failure
        return replace(failure, outlier=window[worst].key, d2=float(aligned.d2[worst]))

    def _solve(
        self, joint: JointMap, parts: Sequence[JointMap], measurements: Measurements
    ) -> JointMap | JoinFailure:
        """Return the minimum of eq. (21) with further observations, if these fit the parts."""
        try:
            solved = _with_measurements(joint, measurements).solved()
        except NoMinimumError as error:
            return JoinFailure(f'cannot align: {error}')
        increase = solved.chi_square - sum(part.chi_square for part in parts)
        dof = solved.dof - sum(part.dof for part in parts)
        return inconsistency(increase, dof, self._rules.probability) or solved


def _with_measurements(joint: JointMap, measurements: Measurements) -> JointMap:
    """Return a map with further observations after its own ones, before it is solved for."""
    first = joint.first_poses
    factors = stacked(RendezvousFactors, (
        (first[m.observer] + m.pose, first[m.observed] + m.observed_pose, m.z, m.R)
        for m in measurements))
    return replace(joint, problem=replace(
        joint.problem, rendezvous=concatenated(joint.problem.rendezvous, factors)))


def _sessions(maps: Sequence[LocalMap], measurements: Measurements) -> list[Rendezvous]:
    """Return the rendezvous of each pair of robots, or an empty one if they share landmarks."""
    names = [local.robot for local in maps]
    pairs: dict[RobotPair, list[list[RendezvousMeasurement]]] = {}
    for m in measurements:
        one, other = sorted((m.observer, m.observed), key=names.index)
        sessions = pairs.setdefault((one, other), [])
        if not sessions or m.stamp - sessions[-1][-1].stamp > MAX_PAUSE:
            sessions.append([])
        sessions[-1].append(m)
    for p, q in combinations(maps, 2):
        if not set(p.landmarks).isdisjoint(q.landmarks):
            pairs.setdefault((p.robot, q.robot), [[]])
    return [(pair, session) for pair, sessions in pairs.items() for session in sessions]


def _base_node_of_landmarks(p: JointMap, q: JointMap, min_shared: int) -> Array | JoinFailure:
    """Return the pose of q in p that aligns the landmarks with a common key."""
    index_p, index_q = p.landmark_index(), q.landmark_index()
    shared = sorted(index_p.keys() & index_q.keys())
    if len(shared) < min_shared:
        return JoinFailure(f'{len(shared)} shared landmarks, {min_shared} are needed')
    in_p, in_q = [index_p[key] for key in shared], [index_q[key] for key in shared]
    P = p.information().joint(points=in_p) + q.information().joint(points=in_q)
    # Traces do not depend on the frame of either P.
    weights = 2.0 / np.diag(P).reshape(-1, 2).sum(axis=1)
    points = q.values.points[in_q]
    spread = points - np.average(points, axis=0, weights=weights)
    heading_sigma = 1.0 / np.sqrt(weights @ np.square(spread).sum(axis=1))
    if heading_sigma > MAX_HEADING_SIGMA:
        return JoinFailure(
            f'cannot align: the heading sigma by {len(shared)} shared landmarks is'
            f' {heading_sigma:.2f} rad, {MAX_HEADING_SIGMA} is needed')
    return rigid_fit(points, p.values.points[in_p], weights)
