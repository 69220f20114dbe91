# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendezvous of robots that are in one map already: they close loops.

All are solved for at once, eq. (21) of [Andersson]. Single observations that contradict the map by
far are left out before. Afterwards each rendezvous is tested against all other measurements: its
residuals r against these have the covariance R - H P H^T, with the P of its poses in the solution.
Those that contradict the rest are left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from fej_slam_ros.core.chi_square import own_blocks, squared_distances
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous import (
    Failed, Measurements, outlier_report, Rendezvous, RendezvousMeasurement, without_few_outliers)
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.smoothing.factors import concatenated, RendezvousFactors, stacked
from fej_slam_ros.core.smoothing.marginals import Information

#: Factor of the limit before the map is solved for: the linearisation is at a map that may be
#: wrong by its standard deviations.
GROSS_FACTOR = 9.0


@dataclass(slots=True, eq=False)
class ClosedLoops:
    """A map after closing loops."""

    joint: JointMap  #: the minimum with the rendezvous that fit
    failed: list[Failed] = field(default_factory=list)  #: rendezvous that were left out
    #: reports of single observations that were left out
    outliers: list[JoinFailure] = field(default_factory=list)


def close_loops(joint: JointMap, loops: Sequence[Rendezvous], rules: JoinRules) -> ClosedLoops:
    """Return a map with the rendezvous of its robots that do not contradict the rest."""
    if not loops:
        return ClosedLoops(joint)
    closed, left = _without_gross_outliers(joint, loops, rules)
    while left:
        try:
            solved = with_measurements(joint, measurements_of(left)).solved()
        except NoMinimumError:
            return _one_by_one(closed, left, rules)
        failures = _contradictions(solved, left, rules)
        if not failures:
            closed.joint = solved
            break
        closed.failed += ((left[k], failure) for k, failure in failures.items())
        left = [loop for k, loop in enumerate(left) if k not in failures]
    return closed


def with_measurements(joint: JointMap, measurements: Measurements) -> JointMap:
    """Return a map with further observations after its own ones, before it is solved for."""
    if not measurements:
        return joint
    first = joint.first_poses
    factors = stacked(RendezvousFactors, (
        (first[m.observer] + m.pose, first[m.observed] + m.observed_pose, m.z, m.R)
        for m in measurements))
    return replace(joint, problem=replace(
        joint.problem, rendezvous=concatenated(joint.problem.rendezvous, factors)))


def measurements_of(loops: Sequence[Rendezvous]) -> list[RendezvousMeasurement]:
    """Return all observations of some rendezvous."""
    return [m for loop in loops for m in loop.measurements]


def _without_gross_outliers(
    joint: JointMap, loops: Sequence[Rendezvous], rules: JoinRules
) -> tuple[ClosedLoops, list[Rendezvous]]:
    """Return a map with reports of what it contradicts by far, and the rest of the rendezvous."""
    closed = ClosedLoops(joint)
    left: list[Rendezvous] = []
    used = with_measurements(joint, measurements_of(loops))
    factors, limit = used.problem.rendezvous, GROSS_FACTOR * rules.limit(2)
    information = joint.information([*factors.pose, *factors.target])
    for loop, r, R, HPH in _residuals(used, information, loops):
        is_outlier = squared_distances(r.reshape(-1, 2), own_blocks(R + HPH)) > limit
        kept = without_few_outliers(loop.measurements, is_outlier.tolist())
        if kept is None:
            closed.failed.append((loop, JoinFailure(
                f'inconsistent ({is_outlier.sum()} of {len(is_outlier)} observations contradict'
                ' the map)')))
            continue
        if len(kept) < len(is_outlier):
            closed.outliers.append(outlier_report(loop, len(kept)))
        left.append(loop._replace(measurements=kept))
    return closed, left


def _contradictions(
    solved: JointMap, loops: Sequence[Rendezvous], rules: JoinRules
) -> dict[int, JoinFailure]:
    """Return the loops that contradict the rest most, by row; others may because of them."""
    failures: dict[int, JoinFailure] = {}
    excess: dict[int, float] = {}
    for k, (_, r, R, HPH) in enumerate(_residuals(solved, solved.information(), loops)):
        chi_square = float(r @ np.linalg.solve(R - HPH, r))
        failure = rules.inconsistency(chi_square, len(r))
        if failure is not None:
            failures[k], excess[k] = failure, chi_square / len(r)
    least = max(excess.values(), default=0.0) / 2.0
    return {k: failure for k, failure in failures.items() if excess[k] >= least}


def _residuals(
    joint: JointMap, information: Information, loops: Sequence[Rendezvous]
) -> Iterator[tuple[Rendezvous, Array, Array, Array]]:
    """Yield r (2 k,), R and H P H^T (2 k, 2 k) of each loop; they are the last of the map."""
    factors = joint.problem.rendezvous
    H, r = factors.linearize(joint.values)
    end = len(r) - len(measurements_of(loops))
    for loop in loops:
        begin, end = end, end + len(loop.measurements)
        rows = slice(begin, end)
        poses, columns = np.unique(
            np.column_stack([factors.pose[rows], factors.target[rows]]), return_inverse=True)
        blocks = np.zeros((end - begin, 2, len(poses), 3))
        for k, (a, b) in enumerate(columns.reshape(-1, 2)):
            blocks[k, :, a], blocks[k, :, b] = H[begin + k, :, :3], H[begin + k, :, 3:]
        H_loop = blocks.reshape(2 * (end - begin), -1)
        P = information.joint(poses.tolist())
        yield loop, r[rows].ravel(), block_diag(*factors.R[rows]), H_loop @ P @ H_loop.T


def _one_by_one(
    closed: ClosedLoops, loops: Sequence[Rendezvous], rules: JoinRules
) -> ClosedLoops:
    """Close the loops one after another: together they are too far from a minimum."""
    for loop in loops:
        try:
            solved = with_measurements(closed.joint, loop.measurements).solved()
        except NoMinimumError as error:
            closed.failed.append((loop, JoinFailure(f'cannot align: {error}')))
            continue
        increase = solved.chi_square - closed.joint.chi_square
        failure = rules.inconsistency(increase, 2 * len(loop.measurements))
        if failure is None:
            closed.joint = solved
        else:
            closed.failed.append((loop, failure))
    return closed
