# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All measurements of a least-squares problem, and its sparse normal equations."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.records import UNKNOWN_POSE_COVARIANCE
from fej_slam_ros.core.smoothing.cauchy_loss import CauchyLoss
from fej_slam_ros.core.smoothing.chain_reduction import ChainedIncrements, ReducedChains
from fej_slam_ros.core.smoothing.factors import (
    LandmarkFactors, OdometryFactors, RendezvousFactors, rows_of, stacked, Values, whitened,
    whitener)
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.normal_equations import NormalEquations
from fej_slam_ros.core.smoothing.odometry_chains import OdometryChains

NO_RENDEZVOUS = stacked(RendezvousFactors, ())


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All measurements."""

    #: odometry, landmarks, rendezvous: the factors
    odometry: OdometryFactors
    landmarks: LandmarkFactors
    rendezvous: RendezvousFactors = NO_RENDEZVOUS
    #: indices of the poses that keep their initial values, one for each group of connected robots
    fixed_poses: Sequence[int] = (0,)
    #: results of `system`, by the numbers of variables
    _systems: 'dict[tuple[int, int], System]' = field(
        default_factory=dict, init=False, repr=False)

    def __reduce__(self) -> tuple[object, ...]:
        return Problem, (self.odometry, self.landmarks, self.rendezvous, self.fixed_poses)

    def measured_coordinates(self) -> int:
        """Return the number of measured coordinates; a motion that is not known has none."""
        unknown = (self.odometry.R == UNKNOWN_POSE_COVARIANCE).all(axis=(-2, -1))
        return (
            self.odometry.z.size - 3 * int(unknown.sum()) + self.landmarks.z.size
            + self.rendezvous.z.size)

    def system(self, x: Values, kept: Sequence[int] = ()) -> 'System':
        """
        Return the normal equations of variables x; their order and pattern are found once.

        Poses with odometry only are eliminated, but for those `kept`, for which they are found
        again each time.

        """
        sizes = len(x.poses), len(x.points)
        if len(kept):
            return System(self, *sizes, kept)
        if sizes not in self._systems:
            self._systems[sizes] = System(self, *sizes)
        return self._systems[sizes]

    def forget_systems(self) -> None:
        """Free the memory of the results of `system`, some kB for each measurement."""
        self._systems.clear()


@dataclass(frozen=True, slots=True, eq=False)
class LinearizedFactors:
    """Whitened A (m, d, c) and b (m, d) of each kind of factors, that of chains first."""

    A: list[Array]
    b: list[Array]
    chains: ReducedChains
    cost: float
    #: decrease of the cost if only the poses within chains move
    within_chains: float


class System:
    """
    Normal equations of a problem, eq. (2) of [Andersson], whose order and pattern are found once.

    Parameters
    ----------
    problem : all measurements
    poses, points : number of poses and of landmarks
    kept : poses that are not eliminated, even if there is only odometry to them

    Attributes
    ----------
    equations : those of the coordinates that are not eliminated
    unknowns : number of coordinates that are solved for, eliminated ones included

    """

    def __init__(
        self, problem: Problem, poses: int, points: int, kept: Sequence[int] = ()
    ) -> None:
        odometry = problem.odometry
        self._chains = OdometryChains.of(
            odometry.pose, odometry.target, _measured(problem, poses, kept))
        chained = rows_of(odometry, self._chains.rows)
        self._chained = ChainedIncrements.of(self._chains, chained.z, chained.R)
        if len(self._chains.rows):
            odometry = rows_of(
                odometry, np.delete(np.arange(len(odometry.z)), self._chains.rows))
        self._factors = [
            factors for factors in (odometry, problem.landmarks, problem.rendezvous)
            if len(factors.z) > 0]
        self._whiteners = [whitener(factors.R) for factors in self._factors]
        free = np.ones(poses + points, bool)
        free[list(problem.fixed_poses)] = False
        free[self._chains.eliminated] = False
        links = [factors.nodes(poses) for factors in self._factors]
        if len(self._chains.rows):
            links.insert(0, self._chains.nodes)
        self.equations = NormalEquations(
            np.repeat([3, 2], [poses, points]), np.flatnonzero(free), links)
        self.unknowns = len(self.equations.coordinates) + 3 * len(self._chains.eliminated)
        self._poses, self._points = poses, points

    def information(self, x: Values) -> Information:
        """Return the information linearised at x; errors as of `Information`."""
        at = self.linearize(x)
        return Information(
            self.equations.matrix(at.A), self.equations.coordinates, self._poses, self._points,
            at.chains)

    def unwound(self, x: Values) -> Values | None:
        """Return values without turns that contradict odometry, None if there are none."""
        poses = self._chained.unwound(x.poses)
        return None if poses is None else Values(poses, x.points)

    def linearize(self, x: Values, loss: CauchyLoss | None = None) -> LinearizedFactors:
        """Return the whitened linearisation at x; `loss` is the cost of landmark observations."""
        A, b, cost = [], [], 0.0
        for factors, L_inv in zip(self._factors, self._whiteners):
            A_k, b_k = whitened(L_inv, *factors.linearize(x))
            if loss is not None and isinstance(factors, LandmarkFactors):
                d2 = np.square(b_k).sum(axis=1)
                root = np.sqrt(loss.weights(d2))
                A_k, b_k = A_k * root[:, None, None], b_k * root[:, None]
                cost += loss.cost(d2)
            else:
                cost += float(np.vdot(b_k, b_k))
            A.append(A_k)
            b.append(b_k)
        chains, within = self._chained.reduced(x.poses), 0.0
        if len(chains.Phi):
            A_k, b_k = whitened(whitener(chains.covariances), chains.H, chains.residuals)
            A.insert(0, A_k)
            b.insert(0, b_k)
            cost += chains.cost
            within = chains.cost - float(np.vdot(b_k, b_k))
        return LinearizedFactors(A, b, chains, cost, within)

    def correction(self, at: LinearizedFactors, dx_free: Array, share: float) -> Array:
        """
        Return dx of all coordinates, poses first, from those of the normal equations.

        Within chains, poses move with the ends, and by a share of the way to their best places.

        """
        dx = np.zeros(3 * self._poses + 2 * self._points)
        dx[self.equations.coordinates] = dx_free
        at.chains.correct(dx[:3 * self._poses].reshape(-1, 3), share)
        return dx


def _measured(problem: Problem, poses: int, kept: Sequence[int]) -> Flags:
    """Return whether each of the poses is kept, fixed, or has measurements beside odometry."""
    is_measured = np.zeros(poses, bool)
    for used in (
            kept, problem.fixed_poses, problem.landmarks.pose, problem.rendezvous.pose,
            problem.rendezvous.target):
        is_measured[np.array(used, np.intp)] = True
    return is_measured
