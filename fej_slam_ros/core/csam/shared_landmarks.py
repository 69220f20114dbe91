# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Alignment of two maps by the landmarks that both have, and the noise between maps.

If all observations of a landmark by one robot have a misread ID, it contradicts the other
landmarks.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from statistics import median_low
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.chi_square import increases_of_chi_square
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.geometry import Array, rigid_fit, rotation, transform
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.point_consensus import farthest_points, MAX_OUTLYING
from fej_slam_ros.core.records import LandmarkKey

#: Largest heading sigma [rad] of an alignment; beyond it the iteration may start too far away.
MAX_ALIGNMENT_SIGMA = 0.1
#: Steps of the alignment with full covariances, from that with their traces.
ALIGNMENT_STEPS = 5
#: Minimum and maximum number of pairs of maps from which the noise between maps is estimated.
MIN_MAP_PAIRS, MAX_MAP_PAIRS = 3, 15
#: Largest share of the shared landmarks that may contradict the others, as people with IDs do, if
#: these are at least so many: by chance, or because they have moved together, fewer would agree.
MAX_MOVING, MIN_AGREEING = 0.45, 8
#: Largest distance between the shared landmarks of aligned maps, relative to their spread, at
#: which systematic errors may be the cause of a contradiction: a wrong place is as far as a map.
MAX_SYSTEMATIC = 0.1
#: Largest factor between the lengths of two maps: ranges that are 5 % too long for one robot and
#: 5 % too short for the other.
MAX_SCALE = 1.1


class LandmarkAlignment(NamedTuple):
    """Alignment of two maps."""

    base_node: Array  #: (3,) array, pose of the frame of the second map in that of the first
    #: chi_square, dof: weighted squared distances of the landmarks, and degrees of freedom
    chi_square: float
    dof: int
    scale: float  #: lengths in the first map, divided by those in the second


#: An alignment, or why there is none.
Aligned = LandmarkAlignment | JoinFailure


class SharedLandmarks:
    """
    The landmarks of two maps that have a common key.

    Parameters
    ----------
    p, q : the maps
    min_shared : smallest number of landmarks that aligns them

    """

    def __init__(self, p: JointMap, q: JointMap, min_shared: int) -> None:
        index_p, index_q = p.landmark_index(), q.landmark_index()
        self.p, self.q, self._min_shared = p, q, min_shared
        self._keys = sorted(index_p.keys() & index_q.keys())
        self._in_p, self._in_q = (
            np.array([index[key] for key in self._keys], np.intp) for index in (index_p, index_q))
        self._points_p, self._points_q = p.values.points[self._in_p], q.values.points[self._in_q]

    def align(
        self, without: Collection[LandmarkKey] = (), *, with_scale: bool = False
    ) -> Aligned:
        """
        Return the base node that aligns the landmarks, but for some of them.

        The scale is 1, or the one that aligns them best.

        """
        kept = [k for k, key in enumerate(self._keys) if key not in without]
        if len(kept) < self._min_shared:
            return JoinFailure(f'{len(kept)} shared landmarks, {self._min_shared} are needed')
        P_p = self.p.information().joint(points=self._in_p[kept].tolist())
        P_q = self.q.information().joint(points=self._in_q[kept].tolist())
        points_p, points_q = self._points_p[kept], self._points_q[kept]
        # Traces do not depend on the frame of either P.
        weights = 2.0 / np.diag(P_p + P_q).reshape(-1, 2).sum(axis=1)
        heading_sigma = _heading_sigma(points_q, weights)
        if heading_sigma > MAX_ALIGNMENT_SIGMA:
            return JoinFailure(
                f'cannot align: the heading sigma by {len(kept)} shared landmarks is'
                f' {heading_sigma:.2f} rad, {MAX_ALIGNMENT_SIGMA} is needed')
        base_node, scale = rigid_fit(points_q, points_p, weights), 1.0
        unknowns = 4 if with_scale else 3
        for _ in range(ALIGNMENT_STEPS):
            chi_square, step = _step(
                base_node, points_p, scale * points_q, P_p, scale ** 2 * P_q, unknowns)
            base_node = base_node + step[:3]
            scale *= float(np.exp(step[3:].sum()))
            if not 1.0 / MAX_SCALE < scale < MAX_SCALE:
                return JoinFailure(f'cannot align: the scales differ by more than {MAX_SCALE:g}')
        return LandmarkAlignment(base_node, chi_square, 2 * len(kept) - unknowns, scale)

    def align_but_for_scale(self, rules: JoinRules) -> LandmarkAlignment | None:
        """
        Return the alignment of maps that contradict each other in nothing but a small scale.

        Systematic errors of ranges, or of odometry, make a map a few per cent too large or too
        small all over, by far more than its covariance.

        """
        return _consistent(self.align(with_scale=True), rules)

    def align_by_consistent(self) -> Aligned:
        """Return the alignment by the landmarks that do not contradict the others."""
        farthest = self._farthest()
        others = self.align(farthest)
        if not farthest:
            return others
        factor = 1.0 if isinstance(others, JoinFailure) else max(
            1.0, others.chi_square / others.dof)
        rules = JoinRules(self._min_shared, variance_factor=factor)
        return self.align(self._contradicting(farthest, others, rules))

    def contradicting(self, rules: JoinRules) -> dict[LandmarkKey, float]:
        """
        Return the d2 of the landmarks that contradict the others.

        The result is empty if they are too many, if the others do not fit, or if many of them
        agree on another place.

        """
        farthest = self._farthest()
        return self._contradicting(farthest, self.align(farthest), rules)

    def cure_of_contradiction(self) -> str:
        """Return how to join maps that contradict each other a little all over, else ''."""
        points_p, points_q = self._points_p, self._points_q
        moved = transform(rigid_fit(points_q, points_p, np.ones(len(points_p))), points_q)
        distance, spread = (
            float(np.sqrt(np.square(d).sum(axis=1).mean()))
            for d in (points_p - moved, points_p - points_p.mean(axis=0)))
        if distance > MAX_SYSTEMATIC * spread:
            return ''
        return (
            f'; the shared landmarks are {distance:.2f} m apart: if the sensors are no better than'
            ' this, join_probability 1.0 joins the maps')

    def _contradicting(
        self, farthest: Sequence[LandmarkKey], aligned: Aligned, rules: JoinRules
    ) -> dict[LandmarkKey, float]:
        """Return `contradicting` among the farthest ones, given the alignment by the others."""
        others = _consistent(aligned, rules)
        if not farthest or others is None:
            return {}
        found = {
            key: d2 for key, d2 in self._squared_distances(farthest, others).items()
            if d2 > rules.landmark_limit()}
        if len(found) <= MAX_OUTLYING * len(self._keys):
            return found
        # So many that agree among themselves may as well be right, and the others have moved.
        rival = self.align([key for key in self._keys if key not in found])
        return found if _consistent(rival, rules) is None else {}

    def _squared_distances(
        self, farthest: Sequence[LandmarkKey], others: LandmarkAlignment
    ) -> dict[LandmarkKey, float]:
        """
        Return the increase of chi-square by each of the farthest landmarks, if it aligns the maps.

        All landmarks of a map share the errors of its robots: what matters is the distance from
        where the others predict a landmark.

        """
        left_out = frozenset(farthest)
        order = sorted(range(len(self._keys)), key=lambda k: self._keys[k] in left_out)
        fitted = len(order) - len(left_out)
        C = np.kron(np.eye(len(order)), rotation(others.base_node[2]))
        S = self.p.information().joint(points=self._in_p[order].tolist()) + (
            C @ self.q.information().joint(points=self._in_q[order].tolist()) @ C.T)
        moved = transform(others.base_node, self._points_q[order])
        D = np.vstack([*map(models.F, moved - others.base_node[:2])])
        d2 = increases_of_chi_square((self._points_p[order] - moved).ravel(), D, S, 2 * fitted)
        return {self._keys[k]: value for k, value in zip(order[fitted:], d2.tolist())}

    def _farthest(self) -> list[LandmarkKey]:
        """Return the landmarks that fit the others least."""
        count = len(self._keys)
        most = max(int(MAX_OUTLYING * count), min(int(MAX_MOVING * count), count - MIN_AGREEING))
        return [self._keys[k] for k in farthest_points(self._points_p, self._points_q, most)]


def _consistent(aligned: Aligned, rules: JoinRules) -> LandmarkAlignment | None:
    """Return an alignment if there is one whose chi-square is within its limit."""
    if isinstance(aligned, JoinFailure) or rules.inconsistency(aligned.chi_square, aligned.dof):
        return None
    return aligned


def _heading_sigma(points: Array, weights: Array) -> float:
    """Return the standard deviation [rad] of the heading that points (l, 2) determine."""
    spread = points - np.average(points, axis=0, weights=weights)
    with np.errstate(divide='ignore'):  # it is infinite if all are at one place
        return float(1.0 / np.sqrt(weights @ np.square(spread).sum(axis=1)))


def variance_factor(maps: Sequence[JointMap], min_shared: int) -> float:
    """
    Return the variance of the residuals between maps, relative to that of the stated noise.

    Persistent errors, such as the bias of a sensor, make maps of several robots contradict each
    other more than their covariances state. The result is the median over robots of the median
    over the pairs of each, at least 1: a single wrong map does not change it, nor do a few
    landmarks that were moved. With less than three pairs it is 1.

    """
    if len(maps) < MIN_MAP_PAIRS:
        return 1.0
    aligned = (
        ((i, k), SharedLandmarks(maps[i], maps[k], min_shared).align_by_consistent())
        for i, k in _pairs(len(maps)))
    found = [*islice(
        ((pair, alignment) for pair, alignment in aligned
         if isinstance(alignment, LandmarkAlignment)), MAX_MAP_PAIRS)]
    if len(found) < MIN_MAP_PAIRS:
        return 1.0
    factors: defaultdict[int, list[float]] = defaultdict(list)
    for pair, alignment in found:
        for k in pair:
            factors[k].append(alignment.chi_square / alignment.dof)
    # With three robots, a wrong map is in two of three pairs, but only its own robot has no other.
    return max(1.0, median_low(map(median_low, factors.values())))


def _pairs(count: int) -> Iterator[tuple[int, int]]:
    """Yield the pairs of some maps, so that the first ones are of all maps alike."""
    for distance in range(1, count // 2 + 1):
        for k in range(count if 2 * distance < count else distance):
            yield k, (k + distance) % count


def _step(
    base_node: Array, points_p: Array, points_q: Array, P_p: Array, P_q: Array, unknowns: int
) -> tuple[float, Array]:
    """
    Return chi-square at a base node, and the Gauss-Newton step.

    The step is that of the base node or, with four unknowns, also of the logarithm of the scale.

    """
    C = np.kron(np.eye(len(points_q)), rotation(base_node[2]))
    moved = transform(base_node, points_q)
    r = (points_p - moved).ravel()
    d = moved - base_node[:2]
    J = np.column_stack([np.vstack([*map(models.F, d)]), d.ravel()])[:, :unknowns]
    weighted = np.linalg.solve(P_p + C @ P_q @ C.T, np.column_stack([r, J]))
    return float(r @ weighted[:, 0]), np.linalg.solve(J.T @ weighted[:, 1:], J.T @ weighted[:, 0])
