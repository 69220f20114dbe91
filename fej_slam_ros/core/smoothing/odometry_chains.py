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

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices

#: Rows and columns of the elements of a symmetric matrix (3, 3), and the element at each place.
#: Arithmetic on one element of all matrices is an order faster than on one matrix after another.
ROWS, COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
POSITIONS = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])


@dataclass(frozen=True, slots=True, eq=False)
class OdometryChains:
    """Odometry factors in chains of at least two, chain by chain."""

    rows: Indices  #: (m,) array, the factors, each beginning where the one before ends
    firsts: Indices  #: (c,) array, position in `rows` of the first factor of each chain
    #: begins, ends: (m,) arrays, poses of each factor
    begins: Indices
    ends: Indices

    @classmethod
    def of(cls, begins: Indices, ends: Indices, needed: Flags) -> 'OdometryChains':
        """
        Return the chains of odometry factors.

        Parameters
        ----------
        begins, ends : (n,) arrays, poses of the factors; chains lead through successive factors
        needed : for each pose, whether it has other measurements, or stays for another reason

        """
        passed = ~needed
        for of_factors in (begins, ends):
            passed &= np.bincount(of_factors, minlength=len(needed)) == 1
        goes_on = np.append(begins[1:] == ends[:-1], False)[:len(begins)] & passed[ends]
        chains = cls._of_runs(begins, ends, goes_on)
        closed = chains.begins[chains.firsts] == chains.ends[chains.lasts]
        if closed.any():
            # A chain back to its begin has no other end: its first factor stays as it is.
            goes_on[chains.rows[chains.firsts[closed]]] = False
            chains = cls._of_runs(begins, ends, goes_on)
        return chains

    @classmethod
    def _of_runs(cls, begins: Indices, ends: Indices, goes_on: Flags) -> 'OdometryChains':
        follows = np.append(False, goes_on)[:len(goes_on)]
        rows = np.flatnonzero(goes_on | follows)
        return cls(rows, np.flatnonzero(~follows[rows]), begins[rows], ends[rows])

    @property
    def lasts(self) -> Indices:
        """Return the position in `rows` of the last factor of each chain."""
        return np.append(self.firsts[1:], len(self.rows))[:len(self.firsts)] - 1

    @property
    def nodes(self) -> tuple[Indices, Indices]:
        """Return the poses (c,) at the begin and at the end of each chain."""
        return self.begins[self.firsts], self.ends[self.lasts]

    @property
    def eliminated(self) -> Indices:
        """Return the poses (m - c,) in between."""
        return np.delete(self.ends, self.lasts)

    def reduced(self, poses: Array, r: Array, Q: Array) -> 'ReducedChains':
        """
        Return the measurements between the ends of the chains.

        Parameters
        ----------
        poses : (n, 3) array, all poses
        r : (m, 3) array, residuals of the factors in `rows`
        Q : (6, m) array, their covariances as by `packed`

        """
        a, b = self.nodes
        lengths = np.diff(np.append(self.firsts, len(self.rows)))
        to_end = np.repeat(poses[b, :2], lengths, axis=0) - poses[self.ends, :2]
        (dx, dy), headings = np.ascontiguousarray(to_end.T), poses[self.begins, 2]
        c, s = np.cos(headings), np.sin(headings)
        x, y, phi = np.ascontiguousarray(r.T)
        rho = np.stack([c * x - s * y - dy * phi, s * x + c * y + dx * phi, phi])
        # Q turned by the heading, then T Q T^T, element by element.
        xx, xy, yy, x_phi, y_phi, phi_phi = Q
        turned, mixed = c * s, c * s * (xx - yy) + (c * c - s * s) * xy
        xx, yy = c * c * xx - 2.0 * turned * xy + s * s * yy, (
            s * s * xx + 2.0 * turned * xy + c * c * yy)
        x_phi, y_phi = c * x_phi - s * y_phi, s * x_phi + c * y_phi
        S = np.stack([
            xx - 2.0 * dy * x_phi + dy * dy * phi_phi,
            mixed + dx * x_phi - dy * y_phi - dx * dy * phi_phi,
            yy + 2.0 * dx * y_phi + dx * dx * phi_phi,
            x_phi - dy * phi_phi, y_phi + dx * phi_phi, phi_phi])
        return ReducedChains(
            self, _Phi(poses[b, :2] - poses[a, :2]), to_end,
            *(_sums(values, self.firsts, lengths) for values in (rho, S)))


@dataclass(frozen=True, slots=True, eq=False)
class ReducedChains:
    """Linearised chains: their measurements, and the poses in between."""

    chains: OdometryChains
    Phi: Array  #: (c, 3, 3) array, transition of the error over each chain
    to_end: Array  #: (m, 2) array, from the end of each factor to that of its chain [m]
    #: rho, S: (3, m) and (6, m) arrays, residuals and covariances, as by `packed`, from the begin
    #: of the chain to the end of each factor
    rho: Array
    S: Array

    @property
    def residuals(self) -> Array:
        """Return the residual (c, 3) of each chain."""
        return self.rho[:, self.chains.lasts].T

    @property
    def covariances(self) -> Array:
        """Return the covariance (c, 3, 3) of each chain."""
        return _unpacked(self.S[:, self.chains.lasts])

    @property
    def H(self) -> Array:
        """Return the Jacobians (c, 3, 6) by the errors at both ends."""
        return np.concatenate(
            [-self.Phi, np.broadcast_to(np.eye(3), self.Phi.shape)], axis=2)

    def corrections(self, dx_a: Array, dx_b: Array, share: float = 1.0) -> Array:
        """
        Return dx (m - c, 3) of the poses in between from those (c, 3) of the ends.

        `share` is that of their way to the best places between ends that do not move.

        """
        chain, inner = self._inner()
        moved = (self.Phi @ dx_a[:, :, None])[:, :, 0]
        rest = dx_b - moved - share * self.residuals
        # W (dx_b - ...) with W = S_i S^-1.
        x, y, phi = np.linalg.solve(self.covariances, rest[:, :, None])[:, :, 0].T[:, chain]
        xx, xy, yy, x_phi, y_phi, phi_phi = self.S[:, inner]
        xi_x, xi_y, xi_phi = moved.T[:, chain] + share * self.rho[:, inner] + np.stack([
            xx * x + xy * y + x_phi * phi, xy * x + yy * y + y_phi * phi,
            x_phi * x + y_phi * y + phi_phi * phi])
        dx, dy = self.to_end[inner].T
        return np.column_stack([xi_x + dy * xi_phi, xi_y - dx * xi_phi, xi_phi])

    def marginals(self, P_a: Array, P_ab: Array, P_b: Array) -> Array:
        """Return P (m - c, 3, 3) of the poses in between from those (c, 3, 3) of the ends."""
        chain, inner = self._inner()
        S = _unpacked(self.S[:, inner])
        W = S @ np.linalg.inv(self.covariances)[chain]
        from_a = (np.eye(3) - W) @ self.Phi[chain]
        cross = from_a @ P_ab[chain] @ W.transpose(0, 2, 1)
        given = S - W @ S
        P = (
            from_a @ P_a[chain] @ from_a.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
            + W @ P_b[chain] @ W.transpose(0, 2, 1) + (given + given.transpose(0, 2, 1)) / 2.0)
        back = _Phi(-self.to_end[inner])
        covariances: Array = back @ P @ back.transpose(0, 2, 1)
        return covariances

    def _inner(self) -> tuple[Indices, Indices]:
        """Return the chain and the position in `rows` of each pose in between."""
        lasts = self.chains.lasts
        chain = np.repeat(np.arange(len(lasts)), lasts - self.chains.firsts)
        return chain, np.delete(np.arange(len(self.chains.rows)), lasts)


def packed(P: Array) -> Array:
    """Return the elements xx, xy, yy, x phi, y phi, phi phi (6, m) of covariances (m, 3, 3)."""
    return np.ascontiguousarray(P[:, ROWS, COLUMNS].T)


def _unpacked(elements: Array) -> Array:
    """Return the covariances (m, 3, 3) of elements (6, m)."""
    P: Array = elements[POSITIONS].transpose(2, 0, 1)
    return P


def _Phi(d: Array) -> Array:
    """Return the transitions (k, 3, 3) of `models.Phi` over displacements (k, 2)."""
    Phi = np.broadcast_to(np.eye(3), (len(d), 3, 3)).copy()
    Phi[:, 0, 2], Phi[:, 1, 2] = -d[:, 1], d[:, 0]
    return Phi


def _sums(values: Array, firsts: Indices, lengths: Indices) -> Array:
    """Return the sums from the first column of each run up to each of its columns."""
    sums = np.cumsum(values, axis=1)
    sums -= np.repeat(sums[:, firsts] - values[:, firsts], lengths, axis=1)
    return sums
