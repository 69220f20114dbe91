# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The compressed filter: steps that cost what a region costs, whatever the size of the map.

[Guivant] Guivant, Nebot, Optimization of the simultaneous localization and map-building algorithm
for real-time implementation, 2001. As long as robots move in a region A and see nothing else, all
that happens to the rest B follows from three things, for which nobody has to look at B:

    P_AB = Phi P_AB(0),  P_BB = P_BB(0) - P_BA(0) Psi P_AB(0),  x_B = x_B(0) + P_BA(0) theta.

They come about by themselves where the filter runs on the region and a ghost of it, variables g
with covariance 0 that are correlated with the region by I at first: then cov(A, g) is Phi, cov(g)
is -Psi and the correction of g is theta. Nothing is approximated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dpstrf

from fej_slam_ros.core.ekf.covariance import (
    Correction, Covariance, joint_indices, Projection, Slot, SparseRows)
from fej_slam_ros.core.geometry import Array, Flags, Indices


class CompressedCovariance:
    """
    A joint covariance in a region of which everything happens.

    Variables have the slots that they have in the whole; whoever comes is in the region.

    Parameters
    ----------
    whole : the joint covariance, which is used up; `leave` returns it
    members : (a,) array, the indices of the states of the region, in order

    """

    def __init__(self, whole: Covariance, members: Indices) -> None:
        a = len(members)
        self._whole = whole
        self._entered = self._members = members
        # In the core are those who have entered, their ghosts, and whoever came later.
        self._core = Covariance()
        P, alike = whole.at(members, members), np.eye(a)
        self._core.insert_joint(np.block([[P, alike], [alike, np.zeros((a, a))]]), [a, a])
        self._ghosts = np.arange(a, 2 * a)
        self._place = np.full(whole.dimension, -1)
        self._place[members] = np.arange(a)
        self._theta = np.zeros(a)

    @property
    def dimension(self) -> int:
        """Return how many states there are."""
        return self._whole.dimension

    def has(self, slot: Slot) -> bool:
        """Return whether a variable is in the region."""
        return bool(self._place[slot.start] >= 0)

    def holds(self, indices: Indices) -> bool:
        """Return whether all these states are in the region."""
        return bool((self._place[indices] >= 0).all())

    def is_outgrown(self) -> bool:
        """Return whether most states of the region came after it was entered."""
        return len(self._members) > 2 * len(self._entered)

    def marginal(self, slots: Sequence[Slot]) -> Array:
        """Return the symmetric joint covariance of the variables, in the order given."""
        lower = np.tril(self.cross(slots, slots))
        return lower + np.tril(lower, -1).T

    def cross(self, a: Sequence[Slot], b: Sequence[Slot]) -> Array:
        """Return the cross-covariance of the variables a (rows) and b (columns)."""
        rows, columns = joint_indices(a), joint_indices(b)
        if self.holds(rows) and self.holds(columns):
            return self._core.at(self._place[rows], self._place[columns])
        by_row, by_column = self._in_core(rows), self._in_core(columns)
        P: Array = by_row @ self._core.at(*2 * [np.arange(self._core.dimension)]) @ by_column.T
        outside = np.ix_(self._is_outside(rows), self._is_outside(columns))
        P[outside] += self._whole.at(rows, columns)[outside]
        return P

    def blocks(self, indices: Indices) -> Array:
        """Return the covariances (k, d, d) of d states each, given by their indices (k, d)."""
        if self.holds(indices):
            return self._core.blocks(self._place[indices])
        k, d = indices.shape
        core = np.arange(self._core.dimension)
        rows = self._in_core(indices.ravel())
        through = (rows @ self._core.at(core, core)).reshape(k, d, -1)
        outside = self._is_outside(indices)
        both = outside[:, :, None] & outside[:, None, :]
        P: Array = through @ rows.reshape(k, d, -1).transpose(0, 2, 1)
        return P + np.where(both, self._whole.blocks(indices), 0.0)

    def owed(self, indices: Indices) -> Array:
        """Return by how much estimates have changed since the region was entered, if outside."""
        change, outside = np.zeros(len(indices)), self._is_outside(indices)
        change[outside] = self._whole.at(indices[outside], self._entered) @ self._theta
        return change

    def insert(self, P: Array) -> Slot:
        """Add a variable with covariance P, independent of all others."""
        return self._grown(self._core.insert(P))

    def augment(self, parent: Slot, F: Array, N: Array) -> Slot:
        """Add a variable that is F (k, parent size) times its parent plus noise N (k, k)."""
        return self._grown(self._core.augment(self._slot(parent), F, N))

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Move one variable by the transition Phi with noise N; all others stand still."""
        self._core.propagate(self._slot(slot), Phi, N)

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Return P H^T and S in the region, which H must not leave."""
        return self._core.project(SparseRows(self._place[H.columns], H.blocks), R)

    def correction(self, prior: Projection, r: Array) -> Correction:
        """Return what observations with innovation r (2 m,) say; outside dx is zero, but `owed`."""
        of_core = self._core.correction(prior, r)
        dx = np.zeros(self.dimension)
        dx[self._members] = of_core.dx[self._place[self._members]]
        return replace(of_core, dx=dx)

    def condition(self, correction: Correction) -> None:
        """Let the region know, and its ghost."""
        self._core.condition(correction)
        a = len(self._ghosts)
        self._theta += correction.W[a:2 * a] @ correction.y

    def leave(self) -> tuple[Covariance, Array]:
        """Return the whole, up to date, and what is owed to the estimates (n,); end this."""
        n, members = self.dimension, self._members
        here = self._place[members]
        P_BA = self._whole.columns(self._entered)
        Phi = self._core.at(here, self._ghosts)
        L, pivots, rank, _ = dpstrf(-self._core.at(self._ghosts, self._ghosts), lower=1)
        root = np.zeros((len(L), rank))
        root[pivots - 1] = np.tril(L)[:, :rank]
        W = P_BA @ root
        across, dx = P_BA @ Phi.T, P_BA[:n] @ self._theta
        W[members] = dx[members] = 0.0
        across[members] = self._core.at(here, here)
        self._whole.reduce(np.asfortranarray(W))
        self._whole.replace_columns(members, across)
        return self._whole, dx

    def _in_core(self, indices: Indices) -> Array:
        """Return states as combinations (k, core) of the core's; of those outside, by ghosts."""
        inside = ~self._is_outside(indices)
        rows = np.zeros((len(indices), self._core.dimension))
        rows[inside, self._place[indices[inside]]] = 1.0
        rows[np.ix_(~inside, self._ghosts)] = self._whole.at(indices[~inside], self._entered)
        return rows

    def _is_outside(self, indices: Indices) -> Flags:
        outside: Flags = self._place[indices] < 0
        return outside

    def _slot(self, slot: Slot) -> Slot:
        return Slot(int(self._place[slot.start]), slot.size)

    def _grown(self, in_core: Slot) -> Slot:
        """Return the slot, in the whole, of what has come into the core."""
        slot = self._whole.insert(np.zeros((in_core.size, in_core.size)))
        self._members = np.append(self._members, slot.indices)
        self._place = np.append(self._place, in_core.indices)
        return slot
