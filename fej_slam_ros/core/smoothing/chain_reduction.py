# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Poses to which only odometry leads, eliminated from the normal equations exactly.

A chain leads from pose a to pose b through poses without other measurements. With errors
xi = Phi(p_b - p) dx of a pose at p, an increment with residual r and covariance Q from pose i to
pose j adds to the error,

    xi_j = xi_i + T (r + noise),    T = Phi(p_b - p_j) diag(C(phi_i), 1),    noise of covariance Q,

so that the whole chain is one measurement between a and b, of residual rho = sum T r and
covariance S = sum T Q T^T. The poses in between follow from both ends: pose i takes the share
W_i = S_i S^-1 of the correction at b, with the sum S_i up to it.
"""

from dataclasses import dataclass
import math

import numpy as np

from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.geometry import Array, compose, Indices, wrap_all
from fej_slam_ros.core.models import Phi_all
from fej_slam_ros.core.smoothing.odometry_chains import OdometryChains, PartOfChains
from fej_slam_ros.core.smoothing.packed_matrices import (
    inverse, packed, quadratic, rotated, transported, unpacked)

#: Why odometry cannot be used, although the covariance of each message was not singular.
SINGULAR_ODOMETRY = (
    'rounding makes the covariance of odometry singular, as of a gap of years in its stamps')


@dataclass(frozen=True, slots=True, eq=False)
class ChainedIncrements:
    """The increments of chains with their covariances, element by element."""

    chains: OdometryChains
    u: Array  #: (3, m) array, the increments of the factors in `chains.rows`
    #: Q, information: (6, m) arrays, their covariances and the inverses of these, `packed`
    Q: Array
    information: Array

    @classmethod
    def of(cls, chains: OdometryChains, u: Array, Q: Array) -> 'ChainedIncrements':
        """Return the increments u (m, 3), with covariances Q (m, 3, 3), of the chains."""
        elements = packed(Q)
        try:
            return cls(chains, np.ascontiguousarray(u.T), elements, inverse(elements))
        except np.linalg.LinAlgError:
            raise SingularError(SINGULAR_ODOMETRY) from None

    def unwound(self, poses: Array) -> Array | None:
        """
        Return poses (n, 3) without chains that turn once more, or less, than odometry does.

        A turn too many, spread over a chain, is a minimum: each increment contradicts a little.
        The poses within such a chain are laid by odometry from its begin. None if there is none.

        """
        chains = self.chains
        if not len(chains.rows):
            return None
        turned = wrap_all(self.u[2] - (poses[chains.ends, 2] - poses[chains.begins, 2]))
        wound = np.abs(np.add.reduceat(turned, chains.firsts)) > math.pi
        if not wound.any():
            return None
        unwound = poses.copy()
        for first, length in zip(chains.firsts[wound].tolist(), chains.lengths[wound].tolist()):
            # The end of the chain stays.
            for k in range(first, first + length - 1):
                unwound[chains.ends[k]] = compose(unwound[chains.begins[k]], self.u[:, k])
        return unwound

    def reduced(self, poses: Array) -> 'ReducedChains':
        """Return the measurements between the ends of the chains, linearised at poses (n, 3)."""
        chains, columns, cost = self.chains, np.ascontiguousarray(poses.T), 0.0
        a, b = chains.nodes
        to_end, rho, S = (np.empty((k, len(chains.rows))) for k in (2, 3, 6))
        for part in chains.parts():
            to_end[:, part.rows], rho[:, part.rows], S[:, part.rows], of_part = (
                self._linearized(columns, part))
            cost += of_part
        return ReducedChains(chains, Phi_all(poses[b, :2] - poses[a, :2]), to_end, rho, S, cost)

    def _linearized(
        self, poses: Array, part: PartOfChains
    ) -> tuple[Array, Array, Array, float]:
        """Return `to_end`, `rho`, `S` and `cost` of some chains, linearised at poses (3, n)."""
        begins, ends = self.chains.begins[part.rows], self.chains.ends[part.rows]
        x, y, phi = poses
        x_end, y_end, phi_begin = x[ends], y[ends], phi[begins]
        c, s = np.cos(phi_begin), np.sin(phi_begin)
        moved_x, moved_y = x_end - x[begins], y_end - y[begins]
        u_x, u_y, u_phi = self.u[:, part.rows]
        r_x = u_x - c * moved_x - s * moved_y
        r_y = u_y + s * moved_x - c * moved_y
        r_phi = wrap_all(u_phi - (phi[ends] - phi_begin))
        cost = quadratic(self.information[:, part.rows], r_x, r_y, r_phi)
        last = ends[part.firsts + part.lengths - 1]
        dx, dy = (
            np.repeat(of_pose[last], part.lengths) - of_end
            for of_pose, of_end in ((x, x_end), (y, y_end)))
        rho = np.stack([
            c * r_x - s * r_y - dy * r_phi, s * r_x + c * r_y + dx * r_phi, r_phi])
        S = np.stack(transported(rotated(self.Q[:, part.rows], c, s), dx, dy))
        rho, S = (_sums(values, part.lengths) for values in (rho, S))
        return np.stack([dx, dy]), rho, S, cost


@dataclass(frozen=True, slots=True, eq=False)
class ReducedChains:
    """Linearised chains: their measurements, and the poses in between."""

    chains: OdometryChains
    Phi: Array  #: (c, 3, 3) array, transition of the error over each chain
    to_end: Array  #: (2, m) array, from the end of each factor to that of its chain [m]
    #: rho, S: (3, m) and (6, m) arrays, residuals and covariances, `packed`, from the begin of the
    #: chain to the end of each factor
    rho: Array
    S: Array
    cost: float  #: chi-square of all factors

    @property
    def residuals(self) -> Array:
        """Return the residual (c, 3) of each chain."""
        return self.rho[:, self.chains.lasts].T

    @property
    def covariances(self) -> Array:
        """Return the covariance (c, 3, 3) of each chain."""
        return unpacked(self.S[:, self.chains.lasts])

    @property
    def H(self) -> Array:
        """Return the Jacobians (c, 3, 6) by the errors at both ends."""
        return np.concatenate(
            [-self.Phi, np.broadcast_to(np.eye(3), self.Phi.shape)], axis=2)

    def correct(self, dx: Array, share: float) -> None:
        """
        Set the rows of the poses in between of dx (n, 3), which has those of the ends.

        `share` is that of their way to the best places between ends that do not move.

        """
        chains = self.chains
        a, b = chains.nodes
        dx_b = dx[b]
        moved = (self.Phi @ dx[a, :, None])[:, :, 0]
        rest = dx_b - moved - share * self.residuals
        # W (dx_b - ...) with W = S_i S^-1.
        try:
            whitened = np.linalg.solve(self.covariances, rest[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            raise SingularError(SINGULAR_ODOMETRY) from None
        lengths = chains.lengths
        x, y, phi = np.repeat(whitened.T, lengths, axis=1)
        xi_x, xi_y, xi_phi = np.repeat(moved.T, lengths, axis=1)
        rho_x, rho_y, rho_phi = self.rho
        xx, xy, yy, x_phi, y_phi, phi_phi = self.S
        xi_x += share * rho_x + xx * x + xy * y + x_phi * phi
        xi_y += share * rho_y + xy * x + yy * y + y_phi * phi
        xi_phi += share * rho_phi + x_phi * x + y_phi * y + phi_phi * phi
        to_end_x, to_end_y = self.to_end
        xi_x += to_end_y * xi_phi
        xi_y -= to_end_x * xi_phi
        for k, values in enumerate((xi_x, xi_y, xi_phi)):
            dx[chains.ends, k] = values
        dx[b] = dx_b

    def marginals(self, P_a: Array, P_ab: Array, P_b: Array) -> Array:
        """Return P (m - c, 3, 3) of the poses in between from those (c, 3, 3) of the ends."""
        chain, inner = self.chains.inner
        S = unpacked(self.S[:, inner])
        W = S @ np.linalg.inv(self.covariances)[chain]
        from_a = (np.eye(3) - W) @ self.Phi[chain]
        cross = from_a @ P_ab[chain] @ W.transpose(0, 2, 1)
        given = S - W @ S
        P = (
            from_a @ P_a[chain] @ from_a.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
            + W @ P_b[chain] @ W.transpose(0, 2, 1) + (given + given.transpose(0, 2, 1)) / 2.0)
        back = Phi_all(-self.to_end[:, inner].T)
        return back @ P @ back.transpose(0, 2, 1)


def _sums(values: Array, lengths: Indices) -> Array:
    """
    Return the sums from the first column of each run up to each of its columns.

    Each run is summed by itself: differences of a sum over all would lose the digits of runs after
    one with a large covariance, such as that of a lost robot.
    """
    sums, begin = np.empty_like(values), 0
    for length, count in zip(*np.unique(lengths, return_counts=True)):
        end = begin + length * count
        of_runs, into = (
            columns[:, begin:end].reshape(-1, count, length) for columns in (values, sums))
        np.cumsum(of_runs, axis=2, out=into)
        begin = end
    return sums
