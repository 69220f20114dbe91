# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joint state of a frame group L and another one T, e.g. the team, in the frame of T.

The variables in both states determine the pose g = (t, alpha) of the frame of L in that of T: each
shared variable, x in T and x' in L, gives the condition x = g o x'. g has no prior, so three
combinations of the conditions determine g and the others correct both maps. The joined state must
contain no information about the global position and heading; that depends on the linearisation
points, which the policy chooses.
"""

import numpy as np
from scipy.linalg import block_diag, cholesky, qr, solve_triangular

from fej_slam_ros.core.ekf.covariance import Covariance, Slot
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.matrix_product import product
from fej_slam_ros.core.ekf.state import at_slot, JointState, Landmark, Variable, Variables
from fej_slam_ros.core.geometry import Array, poses_plus, wrap_all
from fej_slam_ros.core.joining.frame_fit import shared_variables, StackedVariables
from fej_slam_ros.core.joining.rendezvous_points import marginalize
from fej_slam_ros.core.pieces import pause, PIECE_FLOPS, ranges


def joined_state(
    team: JointState, group: JointState, g: Array, linearization: Linearization
) -> JointState:
    """
    Return the joint state of team and group in the team's frame, given the group's pose g (3,).

    Shared variables keep the team's slots and first estimates. The first estimate of a new
    variable is that of the group transformed by g: at others, the covariance of the group would
    make a rotation of all its variables observable by each other. Where the join corrects a
    heading far, the policy may renew first estimates, also shared ones. Neither state is changed.

    """
    ours, theirs = map(StackedVariables, shared_variables(team, group))
    new = StackedVariables([v for v in group.variables() if v not in theirs.variables])
    carried = new.carried(g, group.estimates_of(new.indices))
    first = new.carried(g, group.x_first[new.indices])
    at, new_at = linearization.joining_points(
        team, ours.variables, new.variables, carried, first)
    # The conditions are A dz - D dg = r, for z = [x_T, x_L] and A = [E_T, -C E_L], where E_T and
    # E_L select the shared variables and C turns them.
    x_carried = ours.carried(g, group.estimates_of(theirs.indices))
    r = ours.difference(x_carried, team.estimates_of(ours.indices))
    dz, dg, P_z, P_gz, P_g = _conditioned(
        *_prior(team, group, ours, theirs, g), ours.derivative(g, at), r)
    pause()

    # New variables are C x + D g of those of the group and of g.
    n = len(team.x_hat)
    in_z, D = n + new.indices, new.derivative(g, new_at)
    P_new = new.turned(g, P_z[in_z]) + D @ P_gz
    P_new_g = new.turned(g, P_gz[:, in_z].T) + D @ P_g
    own = new.turned(g, P_new[:, in_z].T) + D @ P_new_g.T
    x_new = (group.estimates() + dz[n:])[new.indices]
    g = poses_plus(g[None], dg)[0]
    x_hat = np.concatenate([team.estimates() + dz[:n], new.carried(g, x_new)])
    x_first = np.concatenate([team.x_first, first])
    pause()
    state = _combined(team, new.variables, x_hat, x_first, np.block([
        [P_z[:n, :n], P_new[:, :n].T], [P_new[:, :n], own]]))
    for key in team.landmarks.keys() & group.landmarks.keys():
        state.landmarks[key].absorb(group.landmarks[key])
    before = np.concatenate([team.estimates(), carried])
    linearization.transport_errors(state, before, state.x_hat - before)
    headings = state.headings()
    if linearization.corrects_far(wrap_all(state.x_hat[headings] - before[headings])):
        linearization.renew_displaced_points(state)
    # The rendezvous points of the two frames are no longer needed.
    marginalize(
        [key for key in team.rendezvous_points if key in group.rendezvous_points], [state])
    return state


def _prior(
    team: JointState, group: JointState, ours: StackedVariables, theirs: StackedVariables,
    g: Array,
) -> tuple[Array, Array, Array]:
    """Return the covariance P of z, A P and A P A^T."""
    P_T, P_L = team.marginal(team.variables()), group.marginal(group.variables())
    pause()
    P_LL = P_L[np.ix_(theirs.indices, theirs.indices)]
    APA = P_T[np.ix_(ours.indices, ours.indices)] + ours.turned_covariance(g, P_LL)
    AP = np.hstack([P_T[ours.indices], -ours.turned(g, P_L[theirs.indices])])
    return block_diag(P_T, P_L), AP, APA


def _conditioned(
    P: Array, AP: Array, APA: Array, D: Array, r: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """
    Return dz, dg, P_z, P_gz and P_g given A dz - D dg = r.

    z has had the covariance P, which becomes P_z. A itself is mostly zero: AP and APA are A P and
    A P A^T.

    """
    L = cholesky(APA, lower=True)
    pause()
    W = _solved(L, AP)
    B, y = (solve_triangular(L, x, lower=True) for x in (-D, r))
    # Rotated by Q^T, only the first three whitened conditions depend on g.
    Q, R = qr(B)
    pause()
    W, y = product(Q.T, W, may_end=True), Q.T @ y
    R_inverse = solve_triangular(R[:3], np.eye(3))
    P_gz = -R_inverse @ W[:3]
    P -= product(W[3:].T, W[3:], may_end=True)
    pause()
    return W[3:].T @ y[3:], R_inverse @ y[:3], P, P_gz, R_inverse @ R_inverse.T


def _solved(L: Array, A: Array) -> Array:
    """Return L^-1 A."""
    size = PIECE_FLOPS / len(L) ** 2
    if A.shape[1] <= size:
        return np.asarray(solve_triangular(L, A, lower=True), float)
    solved = np.empty(A.shape, order='F')
    for part in ranges(A.shape[1], size):
        solved[:, part] = solve_triangular(L, A[:, part], lower=True)
    return solved


def _combined(
    team: JointState, new: Variables, x_hat: Array, x_first: Array, P: Array
) -> JointState:
    """Return the state of the team's variables followed by the new ones."""
    covariance = Covariance()
    own = team.variables()
    slots = covariance.insert(P).split([v.slot.size for v in [*own, *new]])
    state = JointState([
        *(at_slot(variable, slot) for variable, slot in zip(own, slots)),
        *map(_brought, new, slots[len(own):])], x_hat, x_first, covariance)
    headings = state.headings()
    state.x_hat[headings] = wrap_all(state.x_hat[headings])
    return state


def _brought(variable: Variable, slot: Slot) -> Variable:
    """Return a variable of the other frame; evidence of a move refers to positions in that."""
    brought = at_slot(variable, slot)
    if isinstance(brought, Landmark):
        brought.moved_evidence = None
    return brought
