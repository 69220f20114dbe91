# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Alignment of two maps by the rendezvous of their robots, Algorithm 1 of [Andersson].

Of several rendezvous the largest set is used of which any two agree: each alone gives a base node
by Algorithm 1, and two agree if their base nodes differ by no more than their covariances allow.
The drift of the maps, an error of both, is counted twice: wrong rendezvous are found, and
inaccurate ones are left to the test against the joint map. This is pairwise consistency
maximisation (Mangelson et al., Pairwise Consistent Measurement Set Maximization, ICRA 2018); of at
most `MAX_COMPARED` all sets are tried.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from fej_slam_ros.core.csam.base_node import (
    align, Alignment, BaseNode, central, farthest, RendezvousInformation, RendezvousObservations)
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous import Measurements, MIN_PER_OUTLIER, Rendezvous
from fej_slam_ros.core.gauss_newton import ConvergenceError, SingularError
from fej_slam_ros.core.geometry import Indices, pose_difference
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.smoothing.marginals import Information

#: Returns the information of a map about some of its poses (k,).
InformationOf = Callable[[JointMap, Indices], RendezvousInformation]
#: Input of Algorithm 1: the information of two maps, and the observations between them.
AlignmentInput = tuple[RendezvousInformation, RendezvousInformation, RendezvousObservations]
#: Observations in the middle of a rendezvous that align the maps; the joint map uses all.
ALIGNMENT_WINDOW = 50
#: Number of rendezvous of which the largest set is found: each needs the information of both maps.
MAX_COMPARED = 5


def alignment_window(measurements: Measurements) -> Measurements:
    """Return the observations in the middle of a rendezvous that align the maps."""
    return measurements[central(len(measurements), ALIGNMENT_WINDOW)]


def alignment_input(
    p: JointMap, q: JointMap, measurements: Measurements, information: InformationOf
) -> AlignmentInput:
    """Return the input of Algorithm 1 for two maps, with the information of each about poses."""
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
    return information(p, poses_p), information(q, poses_q), observations


def aligned_but_for_outliers(
    measurements: Measurements, input_of: Callable[[Measurements], AlignmentInput],
    rules: JoinRules,
) -> tuple[Alignment, Measurements] | JoinFailure:
    """
    Return the alignment of two maps by observations that fit, and all of them but a few outliers.

    The observations are in the order of time; `input_of` returns the input of Algorithm 1 for some
    of them.

    """
    kept = measurements
    while isinstance(found := _aligned(alignment_window(kept), input_of, rules), JoinFailure):
        kept = [m for m in kept if m.key != found.outlier]
        if found.outlier is None or (
                len(measurements) - len(kept) > len(measurements) // MIN_PER_OUTLIER):
            return found
    return found, kept


class RendezvousAligner:
    """Base nodes of maps by their rendezvous; each map is factored once for all measurements."""

    def __init__(self, measurements: Measurements, rules: JoinRules) -> None:
        self._rules = rules
        self._poses = {
            end for m in measurements
            for end in ((m.observer, m.pose), (m.observed, m.observed_pose))}
        self._information: dict[JointMap, Information] = {}

    def forget(self, group: JointMap) -> None:
        """Free the memory of the factors of a map."""
        self._information.pop(group, None)

    def align(
        self, p: JointMap, q: JointMap, measurements: Measurements
    ) -> tuple[BaseNode, Measurements] | JoinFailure:
        """Return the base node of q in p, and the observations but for a few outliers."""
        found = aligned_but_for_outliers(
            measurements, lambda window: alignment_input(p, q, window, self._information_of),
            self._rules)
        return found if isinstance(found, JoinFailure) else (found[0].base_node, found[1])

    def contradiction(
        self, p: JointMap, q: JointMap, rendezvous: Rendezvous, attempted: Sequence[Rendezvous]
    ) -> JoinFailure | None:
        """Return a failure if a rendezvous is not in the largest set of those that agree."""
        # Of two that disagree either may be wrong; one that fails alone is reported by itself.
        if len(attempted) < 3 or isinstance(
                own := self.align(p, q, rendezvous.measurements), JoinFailure):
            return None
        compared: list[Rendezvous] = []
        base_nodes: list[BaseNode] = []
        # The rendezvous itself takes part in any case.
        room = MAX_COMPARED - 1
        for other in attempted:
            if other is not rendezvous and not (room and _relates(other, p, q)):
                continue
            aligned = own if other is rendezvous else self.align(p, q, other.measurements)
            if not isinstance(aligned, JoinFailure):
                compared.append(other)
                base_nodes.append(aligned[0])
                room -= other is not rendezvous
        agreeing = [compared[k] for k in largest_agreement(base_nodes, self._rules)]
        if len(compared) < 3 or rendezvous in agreeing:
            return None
        return JoinFailure(
            f'inconsistent ({len(agreeing)} of {len(compared)} rendezvous agree, without it)')

    def _information_of(self, group: JointMap, poses: Indices) -> RendezvousInformation:
        """Return the information of a map, which is factored once for all rendezvous poses."""
        if group not in self._information:
            kept = [
                group.first_poses[robot] + pose for robot, pose in self._poses
                if robot in group.robots]
            self._information[group] = group.information([*group.problem.fixed_poses, *kept])
        return group.rendezvous_information(poses, self._information[group])


def largest_agreement(base_nodes: Sequence[BaseNode], rules: JoinRules) -> tuple[int, ...]:
    """Return the indices of the largest set of which any two agree; of equal ones the first."""
    pairs = {
        (i, k) for i, k in combinations(range(len(base_nodes)), 2)
        if _agree(base_nodes[i], base_nodes[k], rules)}
    sets = (
        chosen for size in range(len(base_nodes), 0, -1)
        for chosen in combinations(range(len(base_nodes)), size)
        if pairs.issuperset(combinations(chosen, 2)))
    return next(sets, ())


def _aligned(
    window: Measurements, input_of: Callable[[Measurements], AlignmentInput], rules: JoinRules
) -> Alignment | JoinFailure:
    """Return the result of Algorithm 1, if the observations fit the maps."""
    try:
        given = input_of(window)
    except SingularError as error:
        return JoinFailure(f'cannot align: {error}')
    try:
        aligned = align(*given)
    except ConvergenceError as error:
        row, d2 = farthest(*given)
        return JoinFailure(f'cannot align: {error}', outlier=window[row].key, d2=d2)
    if isinstance(aligned, JoinFailure):
        return aligned
    failure = rules.inconsistency(aligned.chi_square, aligned.dof)
    if failure is None:
        return aligned
    worst = int(np.argmax(aligned.d2))
    if aligned.d2[worst] <= rules.limit(2):
        return failure
    return replace(failure, outlier=window[worst].key, d2=float(aligned.d2[worst]))


def _relates(rendezvous: Rendezvous, p: JointMap, q: JointMap) -> bool:
    """Return whether a rendezvous has observations between robots of two maps."""
    return bool(rendezvous.measurements) and not any(
        set(rendezvous.robots).isdisjoint(group.robots) for group in (p, q))


def _agree(a: BaseNode, b: BaseNode, rules: JoinRules) -> bool:
    difference = pose_difference(b.pose, a.pose)
    # Also of base nodes that are exact in some direction.
    information = np.linalg.pinv(a.P + b.P, hermitian=True)
    return float(difference @ information @ difference) <= rules.limit(3)
