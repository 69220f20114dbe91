# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What a filter believes that it can know: its local observability matrix M, section 3 of [Liu].

M maps the joint error at a moment to the innovations of all updates since. Nothing but the points
of linearisation decides its null space, so it is kept where these are chosen.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import orth

from fej_slam_ros.core import models
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.geometry import Array, perpendicular
from fej_slam_ros.core.linearization import Linearization, Points, Poses
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.state import JointState, Landmark, Robot, Variable

#: Singular values above this part of the largest count: what should be zero is 1e-16 of it.
RELATIVE = 1e-8


class ObservabilityRecorder:
    """
    A linearisation policy that hands on the points of another, and keeps the M that they make.

    Put in the place of a filter's policy it changes nothing of the estimate. All robots and
    landmarks must have been started before.

    Parameters
    ----------
    policy : the one that chooses
    n : size of the joint state

    Attributes
    ----------
    rows : (2 m, n) array of each update with m sightings, H_k Phi_k-1 ... Phi_0 of eq. (13); those
        of sightings that the gate refused are not among them

    """

    def __init__(self, policy: Linearization, n: int) -> None:
        self.rows: list[Array] = []
        self._policy = policy
        self._transition: Array = np.eye(n)
        self._proposed: Array = np.empty((0, n))

    def displacement(self, state: JointState, robot: Robot, x_pred: Array, stamp: int) -> Array:
        """Multiply the robot's rows of Phi_k-1 ... Phi_0 by its Phi_k."""
        d = self._policy.displacement(state, robot, x_pred, stamp)
        place = robot.slot.indices
        self._transition[place] = models.Phi(d) @ self._transition[place]
        return d

    def sighting_points(
        self, state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
    ) -> tuple[Array, Array]:
        """Form the rows of an update that the gate may still refuse."""
        poses, points = self._policy.sighting_points(state, robots, landmarks)
        columns = np.hstack([state.indices(robots), state.indices(landmarks)])
        rows = models.H(poses, points) @ self._transition[columns]
        self._proposed = rows.reshape(-1, rows.shape[-1])
        return poses, points

    def retract(self, state: JointState, dx: Array) -> Array:
        """Keep the rows: the update has taken place."""
        self.rows.append(self._proposed)
        return self._policy.retract(state, dx)

    def offset(self, state: JointState, robot: Robot, key: LandmarkKey, point: Array) -> Array:
        """Hand on."""
        return self._policy.offset(state, robot, key, point)

    def start_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Hand on."""
        return self._policy.start_points(state, poses, points, stamp)

    def joining_points(
        self, state: JointState, shared: Sequence[Variable], new: Sequence[Variable],
        carried: Array,
    ) -> tuple[Array, Array]:
        """Hand on."""
        return self._policy.joining_points(state, shared, new, carried)

    def transport(self, state: JointState, x_prior: Array) -> tuple[Indices, Array] | None:
        """Hand on."""
        return self._policy.transport(state, x_prior)


def singular_values(M: Array) -> Array:
    """Return the singular values of M, relative to the largest and in falling order."""
    s = np.linalg.svd(M, compute_uv=False)
    relative: Array = s / s[0]
    return relative


def rank(M: Array) -> int:
    """Return how many directions of the joint error the updates have told of."""
    return int(np.count_nonzero(singular_values(M) > RELATIVE))


def null_space(M: Array) -> Array:
    """Return the directions (n, k) of the joint error that no update has told of, orthonormal."""
    # The triangle has the null space of M and spares the SVD a basis as large as M is tall.
    Vt = np.linalg.svd(np.linalg.qr(M, mode='r'))[2]
    unknown: Array = Vt[rank(M):].T
    return unknown


def rigid_motions(state: JointState, x: Array) -> Array:
    """
    Return how the joint state changes when everything moves: by x, by y, and turns.

    Parameters
    ----------
    state : where robots and landmarks have their slots
    x : (n,) array, what turns about the origin

    Returns
    -------
    (n, 3) array
        Derivatives of the moved x by the shift along x [m], that along y [m] and the turn [rad].

    """
    variables: list[Variable] = [*state.robots.values(), *state.landmarks.values()]
    positions = np.array([variable.slot.indices[:2] for variable in variables])
    motions = np.zeros((len(x), 3))
    motions[positions, :2] = np.eye(2)
    motions[positions, 2] = perpendicular(x[positions])
    motions[state.headings(), 2] = 1.0
    return motions


def largest_sine(a: Array, b: Array) -> float:
    """Return that of the principal angles of two subspaces given by columns; 1 if sizes differ."""
    Q_a, Q_b = orth(a), orth(b)
    return float(np.linalg.norm(Q_a @ Q_a.T - Q_b @ Q_b.T, 2))
