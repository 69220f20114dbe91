# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pairs of a sighting without identity and a landmark that it may be of.

To believe a pair is to condition the innovations of all others on its own: what is left of them
tells how well they go with it. What a pair speaks for itself is how much likelier its innovation
is than a sighting of something unknown there, as a log.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.gating import own_blocks
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.linearization import Linearization
from fej_slam_ros.core.records import Sighting
from fej_slam_ros.core.state import JointState, Landmark, Robot

#: A sighting is of something else than what is so far from it, as a squared distance: one right
#: pair in a million is.
FAR = float(chdtri(2, 1e-6))

#: Indices of a sighting and of a landmark.
Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """
    Pairs that may be right, given those that are believed already.

    Attributes
    ----------
    sighting, landmark : (k,) arrays, their indices
    odds : (k,) array, log of how often the landmark is seen for once that something unknown is
        seen in 2 pi m^2
    most : (k,) array, what each can speak for itself at most, whatever else is right
    r : (2 k,) array, the innovations
    S : (2 k, 2 k) array, their joint covariance; between pairs of one sighting without meaning

    """

    sighting: Indices
    landmark: Indices
    odds: Array
    most: Array
    r: Array
    S: Array

    def __len__(self) -> int:
        return len(self.sighting)

    def __getitem__(self, p: int) -> Pair:
        return int(self.sighting[p]), int(self.landmark[p])

    def index(self, pair: Pair) -> int | None:
        """Return which pair a sighting and a landmark are, None where they are not left."""
        found = np.flatnonzero((self.sighting == pair[0]) & (self.landmark == pair[1]))
        return int(found[0]) if len(found) else None

    def weighed(self) -> tuple[Array, Array]:
        """Return the squared distance of each and what it speaks for itself, (k,) each."""
        return weighed(self.r.reshape(-1, 2), own_blocks(self.S), self.odds)

    def most_to_gain(self) -> float:
        """Return what those that can be right together may speak for themselves at most."""
        most = np.zeros(self.sighting.max(initial=-1) + 1)
        np.maximum.at(most, self.sighting, self.most)
        return float(most.sum())

    def believing(self, p: int) -> 'Pairs':
        """
        Return what is left when pair p is right, conditioned on it.

        A sighting is of one landmark only, and what is far then is of something else.

        """
        others = (self.sighting != self.sighting[p]) & (self.landmark != self.landmark[p])
        left, cross = self._some(others), self.S[2 * p:2 * p + 2, np.repeat(others, 2)]
        gain = np.linalg.solve(self.S[2 * p:2 * p + 2, 2 * p:2 * p + 2], cross)
        given = Pairs(
            left.sighting, left.landmark, left.odds, left.most,
            left.r - self.r[2 * p:2 * p + 2] @ gain, left.S - cross.T @ gain)
        near = given.weighed()[0] < FAR
        return given if near.all() else given._some(near)

    def _some(self, which: Flags) -> 'Pairs':
        rows = np.flatnonzero(np.repeat(which, 2))
        return Pairs(
            self.sighting[which], self.landmark[which], self.odds[which], self.most[which],
            self.r[rows], self.S[rows[:, None], rows])


def weighed(r: Array, S: Array, odds: Array) -> tuple[Array, Array]:
    """
    Return r^T S^-1 r and log N(r; 0, S) + odds + log 2 pi.

    Parameters
    ----------
    r, S : (k, 2) and (k, 2, 2) arrays, innovations and their covariances
    odds : (k,) array, as in `Pairs`

    """
    det = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] * S[:, 1, 0]
    d2: Array = (
        S[:, 1, 1] * r[:, 0] ** 2 - (S[:, 0, 1] + S[:, 1, 0]) * r[:, 0] * r[:, 1]
        + S[:, 0, 0] * r[:, 1] ** 2) / det
    gains: Array = odds - 0.5 * (d2 + np.log(det))
    return d2, gains


def possible_pairs(
    state: JointState, linearization: Linearization, robot: Robot,
    sightings: Sequence[Sighting], landmarks: Sequence[Landmark], odds: Array,
) -> Pairs:
    """
    Return all pairs that are not far from each other.

    Parameters
    ----------
    state, linearization : of the filter, with all that follows
    robot : who saw
    sightings : m that it made
    landmarks : l that these may be of
    odds : (l,) array, as in `Pairs`

    """
    z, R = np.array([s.z for s in sightings]), np.array([s.R for s in sightings])
    sighting, landmark = np.nonzero(
        _maybe_near(state, linearization, robot, z, R, landmarks))
    seen, place = np.unique(landmark, return_inverse=True)
    of = [landmarks[f] for f in seen]
    if not of:
        nothing = np.empty(0, np.intp)
        return Pairs(nothing, nothing, odds[:0], odds[:0], np.empty(0), np.empty((0, 0)))
    by = [robot] * len(of)
    H = models.H(*linearization.sighting_points(state, by, of))
    columns = np.hstack([state.indices(by), state.positions(of)])
    h = models.h(state.x_hat[columns[:, :3]], state.x_hat[columns[:, 3:]])
    own = H @ state.covariance.blocks(columns) @ H.transpose(0, 2, 1)
    r = z[sighting] - h[place]
    near = weighed(r, own[place] + R[sighting], odds[landmark])[0] < FAR
    sighting, landmark, place, r = sighting[near], landmark[near], place[near], r[near]
    return Pairs(
        sighting, landmark, odds[landmark], weighed(0.0 * r, R[sighting], odds[landmark])[1],
        r.ravel(), _joint(state, H[place], columns[place], R[sighting]))


def _maybe_near(
    state: JointState, linearization: Linearization, robot: Robot, z: Array, R: Array,
    landmarks: Sequence[Landmark],
) -> Flags:
    """
    Return for sightings (m,) and landmarks (l,) which a coarse test cannot tell apart, (m, l).

    The innovation e = C^T (df - dp - J (f - p) dphi) is known to E |e|^2 <= 3 (E |df|^2 +
    E |dp|^2 + |f - p|^2 E dphi^2), and d2 is at least |r|^2 over the trace of its covariance.

    """
    if not landmarks:
        return np.zeros((len(z), 0), bool)
    x, of = state.estimate(robot), state.positions(landmarks)
    poses, points = linearization.sighting_points(state, [robot] * len(landmarks), landmarks)
    variances = state.covariance.variances()
    var_x, var_y, var_phi = variances[robot.slot.start:robot.slot.stop]
    away = points - poses[:, :2]
    trace = 3.0 * (
        variances[of].sum(axis=1) + var_x + var_y + (away * away).sum(axis=1) * var_phi)
    r = z[:, None] - models.h(x[None], state.x_hat[of])
    limit = trace + np.trace(R, axis1=1, axis2=2)[:, None]
    flags: Flags = (r * r).sum(axis=2) < FAR * limit
    return flags


def _joint(state: JointState, H: Array, columns: Indices, R: Array) -> Array:
    """Return the covariance (2 k, 2 k) of the innovations of k pairs."""
    touched, place = np.unique(columns, return_inverse=True)
    k = len(H)
    compact = np.zeros((2 * k, len(touched)))
    rows = np.arange(2 * k).reshape(k, 2, 1)
    compact[rows, place.reshape(k, 1, 5)] = H
    S: Array = compact @ state.covariance.blocks(touched[None])[0] @ compact.T
    S[rows, rows.reshape(k, 1, 2)] += R
    return S
