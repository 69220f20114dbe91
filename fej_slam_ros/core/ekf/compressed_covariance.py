# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The compressed filter: steps that cost what the active submap costs, whatever the size of the map.

[Guivant] Guivant, Nebot, Optimization of the simultaneous localization and map-building algorithm
for real-time implementation, 2001. While all motion and all observations concern states of a
submap A only, the other states B follow from three quantities:

    P_AB = Phi P_AB(0),  P_BB = P_BB(0) - P_BA(0) Psi P_AB(0),  x_B = x_B(0) + P_BA(0) theta.

The filter obtains them from proxy states g, the whitened errors of A at the start, which nothing
moves: e_A(0) = L g with P_AA(0) = L L^T. It runs on A and g, with cov(A, g) = L and cov(g) = I at
the start. The errors of B are C g and a rest independent of A, with C = P_BA(0) L^-T, so that

    P_BA = C cov(g, A),  P_BB = P_BB(0) - C (I - cov(g)) C^T,  x_B = x_B(0) + C dg,

where dg is the correction of g. Nothing is approximated, and rounding is that of P: without the
whitening, it would grow with the product of both |P_BA(0)| and the inverse of P_AA(0), where all
share a large error.

A state l of B may enter A at any time, as if it had been in A from the start: it is C_l g and its
rest, which is whitened by proxies of its own. Any state may be removed: the proxies and C stay, by
which the states of B follow.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.ekf.covariance import (
    Correction, Covariance, joint_indices, Projection, Slot, SparseRows, Transport)
from fej_slam_ros.core.ekf.matrix_product import product
from fej_slam_ros.core.ekf.outside_points import OutsidePoints
from fej_slam_ros.core.ekf.symmetric_matrix import SymmetricMatrix
from fej_slam_ros.core.ekf.whitening import whiten, Whitening
from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.core.pieces import pause, PIECE_ELEMENTS, ranges

#: Flops of leaving a submap that take as long as one flop of an update: large products run at a
#: higher rate, and an update has overhead.
LEAVING_RATE = 16.0

#: Number of multiplications above which covariances of many states skip the zeros of their
#: combinations, or are read from a copy that has left the submap; for fewer, the direct product is
#: faster.
MAX_DIRECT = 2e9


class CompressedCovariance:
    """
    A joint covariance of which only a submap is propagated and updated.

    Variables keep their slots in the whole; new variables belong to the submap. Costs are in flops
    for n states, a of them in the submap at its start.

    Parameters
    ----------
    whole : joint covariance of all states, owned from now on; `leave` returns it
    members : (a,) array, the indices of the submap's states, in order
    outside : how the errors and estimates outside follow from the proxies

    """

    def __init__(self, whole: Covariance, members: Indices, outside: OutsidePoints) -> None:
        # States outside are read often from now on.
        whole.matrix.settle()
        self._whole = whole
        self._outside = outside
        #: covariance of the members and proxies, each group of members before its proxies
        self._core = Covariance()
        self._core_index = np.full(whole.dimension, -1)
        self._members = self._proxies = np.empty(0, np.intp)
        #: C with zero rows for states and zero columns for proxies to come
        self._C = np.zeros((len(whole.matrix.lower), 0), order='F')
        #: first variance of the proxies, and their correction, which `transport` has used up
        self._prior = self._dg = np.empty(0)
        P = whole.matrix.at(members[:, None], members)
        cross = whole.matrix.columns(members)[:whole.dimension]
        self._add_members(members, np.empty((len(members), 0)), P, whiten(P, cross, np.diag(P)))
        self._dimension_at_start = self._core.dimension
        #: Flops of updates that a submap without the states that entered would not have cost
        self._flops_of_growth = 0.0

    def __copy__(self) -> 'CompressedCovariance':
        """Return a copy for an update of the submap; both share the states outside."""
        copied = object.__new__(CompressedCovariance)
        vars(copied).update(vars(self) | {'_core': copy(self._core), '_dg': self._dg.copy()})
        return copied

    @property
    def dimension(self) -> int:
        """Return n, the number of states."""
        return self._whole.dimension

    @property
    def matrices(self) -> Sequence[SymmetricMatrix]:
        """Return those of all states and of the submap with its proxies."""
        return [self._whole.matrix, self._core.matrix]

    def with_states(self, indices: Indices, x_hat: Array) -> Array | None:
        """
        Add states to the submap; return the estimate (n,) with them, or None if it is to be left.

        That is when its growth has cost as many flops as leaving it, the least total for steady
        growth, or when it would exceed the joint state.

        """
        n, a, members = self.dimension, len(self._proxies), len(self._members)
        leaving = n * a * (n + 2 * (a + members)) + self._outside.added_flops(n)
        if LEAVING_RATE * self._flops_of_growth >= leaving:
            return None
        if self._contains(indices):
            return x_hat
        # Faster than np.unique for the few states of a scan.
        states = np.array(sorted({*indices[self._is_outside(indices)].tolist()}))
        if self._core.dimension + 2 * len(states) > n:
            return None
        return self._entered(states, x_hat)

    def _entered(self, states: Indices, x_hat: Array) -> Array:
        """Let states from outside enter; return the estimate (n,) with them."""
        P, core, x_hat = self._whole.matrix, self._core.matrix, x_hat.copy()
        C_l, k = self._combination(states), core.dimension
        x_hat[states] += self._correction(states)
        cross = product(C_l, core.columns(self._proxies)[:k].T)
        C, P_l = self._C[:P.dimension, :len(self._proxies)], P.at(states[:, None], states)
        first = C_l * self._prior
        rest = P_l - first @ C_l.T
        of_rest = whiten(rest, P.columns(states)[:len(C)] - product(C, first.T), np.diag(P_l))
        self._add_members(states, cross, product(cross[:, self._proxies], C_l.T) + rest, of_rest)
        return x_hat

    def _add_members(
        self, states: Indices, cross: Array, P: Array, of_rest: Whitening
    ) -> None:
        """
        Add states and their proxies to the core.

        Parameters
        ----------
        states : (b,) array, the states
        cross : (b, k) array, their covariance with the k states of the core
        P : (b, b) array, their covariance
        of_rest : whitening of what is independent of the proxies so far

        """
        matrix, (b, k), g = self._core.matrix, cross.shape, of_rest.L.shape[1]
        start = matrix.append(b + g)
        proxies = np.arange(start + b, start + b + g)
        lower = matrix.lower
        lower[start:start + b, :k] = cross
        lower[start:start + b, start:start + b] = P
        lower[start + b:start + b + g, start:start + b] = of_rest.L.T
        lower[proxies, proxies] = 1.0
        self._core_index[states] = np.arange(start, start + b)
        self._members = np.concatenate([self._members, states])
        self._add_proxies(proxies, of_rest.C, np.ones(g))

    def _add_proxies(self, in_core: Indices, C: Array, variances: Array) -> None:
        """Add proxies of the core with their columns of C and their first variances."""
        self._add_combinations(C)
        self._proxies = np.concatenate([self._proxies, in_core])
        self._dg = np.concatenate([self._dg, np.zeros(len(in_core))])
        self._prior = np.concatenate([self._prior, variances])

    def current_estimates(self, x: Array, indices: Indices) -> Array:
        """Return estimates x of the states `indices`, with the corrections of those of B."""
        return x if self._contains(indices) else x + self._pending(indices)

    def marginal(self, slots: Sequence[Slot]) -> Array:
        """Return the symmetric joint covariance (k, k) of the variables, in the order given."""
        in_core = [self._slot(slot) for slot in slots]
        if all(slot.start >= 0 for slot in in_core):
            return self._core.marginal(in_core)
        lower = np.tril(self._joint(joint_indices(slots)))
        return lower + np.tril(lower, -1).T

    def blocks(self, indices: Indices) -> Array:
        """Return the covariances (k, d, d) of k groups of d states, given by indices (k, d)."""
        if self._contains(indices):
            return self._core.blocks(self._core_index[indices])
        k, d = indices.shape
        outside = self._is_outside(indices)
        is_large = indices.size * self._core.dimension ** 2 > MAX_DIRECT
        if is_large and (outside == outside[:, :1]).all():
            return self._many_blocks(indices, outside[:, 0])
        rows = self._combinations(indices.ravel())
        rows_P = (rows @ self._P_core()).reshape(k, d, -1)
        both = outside[:, :, None] & outside[:, None, :]
        P: Array = rows_P @ rows.reshape(k, d, -1).transpose(0, 2, 1)
        return P + np.where(both, self._whole.blocks(indices), 0.0)

    def variance_bounds(self, indices: Indices) -> Array:
        """
        Return upper bounds (k,) of the traces of `blocks`.

        Outside, those are the traces at the start, or the traces where corrections turn points.

        """
        variances, inside = self._whole.matrix.at(indices, indices), ~self._is_outside(indices)
        if self._outside.are_turned:
            C = self._combination(indices[~inside])
            variances[~inside] += (product(C, self._change_of_proxies()) * C).sum(axis=1)
        in_core = self._core_index[indices[inside]]
        variances[inside] = self._core.matrix.at(in_core, in_core)
        bounds: Array = variances.sum(axis=1)
        return bounds

    def augment(self, parent: Slot, F: Array, N: Array) -> Slot:
        """Add a variable with error F (d, parent size) times its parent's plus noise N (d, d)."""
        in_core = self._core.augment(self._slot(parent), F, N)
        slot = Slot(self._whole.matrix.append(in_core.size), in_core.size)
        self._members = np.concatenate([self._members, slot.indices])
        self._core_index = np.concatenate([self._core_index, in_core.indices])
        return slot

    def remove(self, slots: Sequence[Slot], others: Iterable[Slot]) -> None:
        """Marginalise variables out; `others` are the slots of all others, which move up."""
        removed = np.sort(joint_indices(slots))
        in_core = np.sort(self._core_index[removed])
        in_core = in_core[in_core >= 0]
        place, place_in_core = (
            np.cumsum(~np.isin(np.arange(n), gone)) - 1
            for n, gone in ((self.dimension, removed), (self._core.dimension, in_core)))
        self._whole.remove(slots, others)
        self._outside.remove(removed, place)
        if len(in_core):
            self._core.matrix.remove(in_core)
        rows = removed[removed < len(self._C)]
        if len(rows):
            self._C = np.delete(self._C, rows, axis=0)
        self._members = place[np.setdiff1d(self._members, removed)]
        self._proxies = place_in_core[self._proxies]
        core_index = np.delete(self._core_index, removed)
        self._core_index = np.where(core_index < 0, -1, place_in_core[core_index])

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Apply P <- Phi P Phi^T + N, eq. (4), to a variable of the submap."""
        self._core.propagate(self._slot(slot), Phi, N)

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Return S = H P H^T + R and its parts; H touches states of the submap only."""
        return self._core.project(SparseRows(self._core_index.take(H.columns), H.blocks), R)

    def correction(self, prior: Projection, r: Array) -> Correction:
        """Return the gain in factored form and K r, which is zero outside the submap."""
        of_core = self._core.correction(prior, r)
        dx = np.zeros(self.dimension)
        dx[self._members] = of_core.dx[self._core_index[self._members]]
        return of_core._replace(dx=dx)

    def condition(self, correction: Correction) -> None:
        """Apply P <- P - W W^T to the submap and its proxies: 2 m (2 a)^2 flops."""
        self._core.condition(correction)
        self._dg += (correction.W @ correction.y)[self._proxies]
        self._flops_of_growth += len(correction.y) * (
            self._core.dimension ** 2 - self._dimension_at_start ** 2)

    def leave(self, x_hat: Array, may_end: bool = False) -> tuple[Covariance, Array]:
        """
        Return the covariance of all states and the estimate (n,); this object is of no more use.

        With p proxies this takes n p (n + 2 (p + members)) flops, and those that turning adds.
        If it may end early, it raises EndedError then and changes nothing.

        """
        n, members = self.dimension, self._members
        core, P = self._core_index[members], self._core.matrix
        P.settle()
        g, capacity = len(self._proxies), len(self._whole.matrix.lower)
        C = self._C[:, :g] if len(self._C) == capacity else _extended(self._C, capacity, g)
        change = self._outside.change(C, self._change_of_proxies(), self._prior, may_end)
        P_gA = P.at(self._proxies[:, None], core)
        P_A, dx = product(P_gA.T, C.T, may_end).T, np.zeros(n)  # 2 n a (members)
        dx[:len(self._C)] = self._outside.correction(slice(n), self._C[:, :g], self._dg)
        dx[members] = 0.0
        P_A[members] = P.at(core[:, None], core)
        pause()
        change(self._whole.matrix)  # what it changes elsewhere than in P_BB is replaced
        self._whole.matrix.replace_columns(members, P_A)
        return self._whole, x_hat + dx

    def transport(self, A: Transport) -> None:
        """Apply P <- A P A^T to the submap after a correction, and turn the points outside."""
        core, members = self._core, self._members
        V = np.zeros((core.dimension, len(A.columns)))
        V[self._core_index[members]] = A.V[members]
        core.transport(replace(A, columns=self._core_index[A.columns], V=V))
        turned = self._outside.turn(self._C[:, :len(self._proxies)] @ self._dg, A)
        self._dg = np.zeros(len(self._dg))
        for heading, J_df in turned:
            copied = core.augment(self._slot(Slot(heading, 1)), np.eye(1), np.zeros((1, 1)))
            self._add_proxies(copied.indices, J_df, np.zeros(1))

    def _change_of_proxies(self) -> Array:
        """Return the covariance of the proxies less what it was at first, cov(g) - I."""
        change = self._core.matrix.at(self._proxies[:, None], self._proxies)
        change[np.diag_indices(len(change))] -= self._prior
        return change

    def _many_blocks(self, indices: Indices, outside: Flags) -> Array:
        """Return `blocks` of groups that are all outside, by P_BB, or inside."""
        k, d = indices.shape
        P, others = np.empty((k, d, d)), indices[outside]
        P[~outside] = self._core.blocks(self._core_index[indices[~outside]])
        C = self._combination(others.ravel())
        C_learnt = product(C, self._change_of_proxies()).reshape(len(others), d, -1)
        C_T = C.reshape(len(others), d, -1).transpose(0, 2, 1)
        P[outside] = self._whole.blocks(others) + C_learnt @ C_T
        return P

    def _joint(self, indices: Indices) -> Array:
        """Return the covariance (k, k) of some states, symmetric but for rounding."""
        rows = self._combinations(indices)
        P: Array = rows @ self._P_core() @ rows.T
        outside = self._is_outside(indices)
        of_both = indices[outside]
        P[np.ix_(outside, outside)] += self._whole.matrix.at(of_both[:, None], of_both)
        return P

    def _pending(self, indices: Indices) -> Array:
        """Return the corrections of states outside the submap, and 0 inside."""
        change, outside = np.zeros(indices.shape), self._is_outside(indices)
        change[outside] = self._correction(indices[outside])
        return change

    def _combinations(self, indices: Indices) -> Array:
        """Return states as linear combinations (k, core) of the core's, but for their rest."""
        outside = self._is_outside(indices)
        rows = np.zeros((len(indices), self._core.dimension))
        rows[~outside, self._core_index[indices[~outside]]] = 1.0
        rows[np.ix_(outside, self._proxies)] = self._combination(indices[outside])
        return rows

    def _correction(self, outside: Indices) -> Array:
        """Return the correction of k states outside."""
        return self._outside.correction(outside, self._C[:, :len(self._proxies)], self._dg)

    def _combination(self, outside: Indices) -> Array:
        """Return C (k, p) of k states outside, in the order of the proxies."""
        return self._C[outside, :len(self._proxies)]

    def _add_combinations(self, columns: Array) -> None:
        """Add columns of C for proxies that are to be added."""
        count, needed = len(self._proxies), len(self._proxies) + columns.shape[1]
        if needed > self._C.shape[1]:
            self._C = _extended(self._C, len(self._C), 2 * needed)
        self._C[:len(columns), count:needed] = columns

    def _P_core(self) -> Array:
        """Return the change of P by the states of the core: their P, less that at first."""
        every = np.arange(self._core.dimension)
        P = self._core.matrix.at(every[:, None], every)
        P[self._proxies, self._proxies] -= self._prior
        return P

    def _contains(self, indices: Indices) -> bool:
        # States outside have the index -1; faster than a comparison of each.
        return int(self._core_index.take(indices).min(initial=0)) >= 0

    def _is_outside(self, indices: Indices) -> Flags:
        return self._core_index[indices] < 0

    def _slot(self, slot: Slot) -> Slot:
        return Slot(int(self._core_index[slot.start]), slot.size)


def _extended(C: Array, rows: int, columns: int) -> Array:
    """Return C (n, g) in a Fortran array of more rows and other columns, zero beyond C."""
    extended = np.zeros((rows, columns), order='F')
    for part in ranges(min(C.shape[1], columns), PIECE_ELEMENTS / max(rows, 1)):
        extended[:len(C), part] = C[:, part]
    return extended
