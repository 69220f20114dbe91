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
        r, Q : (m, 3) and (m, 3, 3) arrays, residuals and covariances of the factors in `rows`

        """
        a, b = self.nodes
        lengths = np.diff(np.append(self.firsts, len(self.rows)))
        to_end = np.repeat(poses[b, :2], lengths, axis=0) - poses[self.ends, :2]
        c, s = np.cos(poses[self.begins, 2]), np.sin(poses[self.begins, 2])
        T = _Phi(to_end)
        turn = np.zeros((len(c), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = c
        turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -s, s, 1.0
        T = T @ turn
        rho = (T @ r[:, :, None])[:, :, 0]
        S = T @ Q @ T.transpose(0, 2, 1)
        return ReducedChains(
            self, _Phi(poses[b, :2] - poses[a, :2]), _Phi(-to_end),
            *(_sums(values, self.firsts, lengths) for values in (rho, S)))


@dataclass(frozen=True, slots=True, eq=False)
class ReducedChains:
    """Linearised chains: their measurements, and the poses in between."""

    chains: OdometryChains
    Phi: Array  #: (c, 3, 3) array, transition of the error over each chain
    back: Array  #: (m, 3, 3) array, from xi to dx at the end of each factor
    #: rho, S: (m, 3) and (m, 3, 3) arrays, residuals and covariances from the begin of the chain
    #: to the end of each factor
    rho: Array
    S: Array

    @property
    def residuals(self) -> Array:
        """Return the residual (c, 3) of each chain."""
        return self.rho[self.chains.lasts]

    @property
    def covariances(self) -> Array:
        """Return the covariance (c, 3, 3) of each chain."""
        return self.S[self.chains.lasts]

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
        moved = (self.Phi @ dx_a[:, :, None])[:, :, 0]
        rest = dx_b - moved - share * self.residuals
        chain, inner, W = self._shares()
        xi = moved[chain] + share * self.rho[inner] + (W @ rest[chain, :, None])[:, :, 0]
        dx: Array = (self.back[inner] @ xi[:, :, None])[:, :, 0]
        return dx

    def marginals(self, P_a: Array, P_ab: Array, P_b: Array) -> Array:
        """Return P (m - c, 3, 3) of the poses in between from those (c, 3, 3) of the ends."""
        chain, inner, W = self._shares()
        from_a = (np.eye(3) - W) @ self.Phi[chain]
        cross = from_a @ P_ab[chain] @ W.transpose(0, 2, 1)
        given = self.S[inner] - W @ self.S[inner]
        P = (
            from_a @ P_a[chain] @ from_a.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
            + W @ P_b[chain] @ W.transpose(0, 2, 1) + (given + given.transpose(0, 2, 1)) / 2.0)
        back = self.back[inner]
        covariances: Array = back @ P @ back.transpose(0, 2, 1)
        return covariances

    def _shares(self) -> tuple[Indices, Indices, Array]:
        """Return the chain, the position in `rows` and the share W of each pose in between."""
        lasts = self.chains.lasts
        chain = np.repeat(np.arange(len(lasts)), lasts - self.chains.firsts)
        inner = np.delete(np.arange(len(self.chains.rows)), lasts)
        W: Array = self.S[inner] @ np.linalg.inv(self.covariances)[chain]
        return chain, inner, W


def _Phi(d: Array) -> Array:
    """Return the transitions (k, 3, 3) of `models.Phi` over displacements (k, 2)."""
    Phi = np.broadcast_to(np.eye(3), (len(d), 3, 3)).copy()
    Phi[:, 0, 2], Phi[:, 1, 2] = -d[:, 1], d[:, 0]
    return Phi


def _sums(values: Array, firsts: Indices, lengths: Indices) -> Array:
    """Return the sums from the first row of each run up to each of its rows."""
    sums = np.cumsum(values, axis=0)
    before = sums[firsts] - values[firsts]
    return sums - np.repeat(before, lengths, axis=0)
