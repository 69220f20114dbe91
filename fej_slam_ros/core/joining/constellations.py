# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks without ID that two frames share, found by the distances between them.

An assignment pairs a landmark of one frame with one of the other. Two assignments are consistent
if the distances between their landmarks are equal, which does not depend on the frames. A set of
assignments of which each two are consistent, a clique of their graph, gives a rigid motion. The
hypothesis is this motion with all landmarks that fit it. The largest one is accepted only if no
other has half as many: in a row of posts, every shift by a post is one.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile, squared_distances
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.state import JointState, Landmark, position_indices
from fej_slam_ros.core.geometry import Array, Flags, Indices, rigid_fit, rotation, transform, wrap
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NO_ID

#: Minimum number of landmarks in a hypothesis: five distances agree by chance in one of 10^6 pairs
#: of maps of twelve landmarks, three in most.
MIN_MATCHES = 5
#: Largest ratio of the numbers of landmarks of the second-best hypothesis and of the best.
MAX_SECOND_BEST = 0.5
#: Probability with which the distances, and the positions after the fit, of one landmark agree.
MATCH_PROBABILITY = 0.999
#: Landmarks that are closer to each other determine no heading [m].
MIN_LANDMARK_DISTANCE = 0.5
#: Hypotheses that differ by less are the same [m], [rad].
SAME_POSITION, SAME_HEADING = 0.5, 0.1
#: Maximum number of landmarks of each frame, those observed last, of consistent pairs of
#: assignments, and of cliques; these bound the time to 0.1 s. Random maps have 1,000 pairs.
MAX_COMPARED_LANDMARKS, MAX_CONSISTENT_PAIRS, MAX_CLIQUES = 40, 20_000, 500


@dataclass(frozen=True, slots=True, eq=False)
class _Map:
    """Landmarks without ID of a frame."""

    landmarks: Sequence[Landmark]
    points: Array  #: (n, 2) array [m]
    P: Array  #: (n, n, 2, 2) array, their joint covariance by pairs

    def distances(self) -> tuple[Array, Array]:
        """Return how far apart the landmarks are (n, n), and the variances of this."""
        d = self.points[:, None] - self.points
        distance = np.hypot(*d.transpose(2, 0, 1))
        u = d / np.maximum(distance, MIN_LANDMARK_DISTANCE)[:, :, None]
        own = self.P[np.arange(len(d)), np.arange(len(d))]
        of_difference = own[:, None] + own - self.P - self.P.transpose(1, 0, 2, 3)
        return distance, np.einsum('ija,ijab,ijb->ij', u, of_difference, u)


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Landmarks of both frames that are the same, and the pose of the other frame."""

    ours: Indices  #: (k,) array
    theirs: Indices  #: (k,) array
    g: Array  #: (3,) array, pose of the other frame in ours


def any_without_id(state: JointState) -> bool:
    """Return whether a state has confirmed landmarks without ID."""
    return any(
        landmark.key[1] < NO_ID and landmark.tentative is None
        for landmark in state.landmarks.values())


def with_shared_landmarks(team: JointState, group: JointState) -> JointState | JoinFailure:
    """
    Return a state in which the landmarks that the team has, too, have the team's IDs.

    Neither state is changed. Only confirmed landmarks that were observed without ID are compared.
    The reason for a failure is a sentence for users.

    """
    without_id = _latest_without_id(team, group), _latest_without_id(group, team)
    fewer = min(map(len, without_id))
    if fewer < MIN_MATCHES:
        return JoinFailure(f'{fewer} landmarks without ID, needs {MIN_MATCHES}')
    ours, theirs = _map(team, without_id[0]), _map(group, without_id[1])
    best = _best_hypothesis(ours, theirs)
    if isinstance(best, JoinFailure):
        return best
    new_keys = {
        theirs.landmarks[j].key: ours.landmarks[i].key for i, j in zip(best.ours, best.theirs)}
    return _renamed(group, new_keys)


def _best_hypothesis(ours: _Map, theirs: _Map) -> _Hypothesis | JoinFailure:
    """Return the hypothesis with the most landmarks, if no other has nearly as many."""
    # Its import takes a fifth of a second, and few runs need it.
    from networkx import find_cliques, Graph  # noqa: PLC0415

    pairs = _consistent(ours, theirs)
    cliques = [*islice(find_cliques(Graph(pairs.tolist())), MAX_CLIQUES)] if (
        len(pairs) <= MAX_CONSISTENT_PAIRS) else []
    if len(pairs) > MAX_CONSISTENT_PAIRS or len(cliques) == MAX_CLIQUES:
        return JoinFailure(
            'too many distances between landmarks without ID agree with those of another map: they'
            ' are symmetric or repeated, or uncertain for how close together they are')
    found = sorted(
        _hypotheses(ours, theirs, cliques), key=lambda hypothesis: -len(hypothesis.ours))
    if not found or len(found[0].ours) < MIN_MATCHES:
        most = len(found[0].ours) if found else 0
        return JoinFailure(
            f'{most} landmarks without ID are where another map has some, needs {MIN_MATCHES}')
    best = found[0]
    others = (len(other.ours) for other in found[1:] if _differ(best, other, theirs.points))
    second = next(others, 0)
    if second > MAX_SECOND_BEST * len(best.ours):
        return JoinFailure(
            f'{len(best.ours)} landmarks without ID fit another map, but {second} fit elsewhere,'
            ' too: they are symmetric or repeated')
    return best


def _latest_without_id(state: JointState, other: JointState) -> list[Landmark]:
    """Return the landmarks of a state that were observed last and that another may have, too."""
    landmarks = [
        landmark for landmark in state.confirmed_landmarks()
        if landmark.key[1] < NO_ID and landmark.key not in other.landmarks]
    return sorted(landmarks, key=lambda landmark: landmark.last_accepted)[-MAX_COMPARED_LANDMARKS:]


def _map(state: JointState, landmarks: Sequence[Landmark]) -> _Map:
    n = len(landmarks)
    P = state.marginal(landmarks).reshape(n, 2, n, 2).transpose(0, 2, 1, 3)
    points = state.estimates_of(position_indices(landmarks)).reshape(-1, 2)
    return _Map(landmarks, points, P)


def _consistent(ours: _Map, theirs: _Map) -> Indices:
    """Return the pairs (k, 2) of consistent assignments, numbered row by row."""
    (D, variance), (D_theirs, variance_theirs) = ours.distances(), theirs.distances()
    limit = chi_square_quantile(1, MATCH_PROBABILITY)
    r2 = (D[:, None, :, None] - D_theirs[None, :, None, :]) ** 2
    agree: Flags = r2 <= limit * (
        variance[:, None, :, None] + variance_theirs[None, :, None, :])
    agree &= (D > MIN_LANDMARK_DISTANCE)[:, None, :, None]
    agree &= (D_theirs > MIN_LANDMARK_DISTANCE)[None, :, None, :]
    size = len(D) * len(D_theirs)
    edges = agree.reshape(size, size)
    # An assignment in a clique of k has k - 1 neighbours.
    while True:
        useless = (edges.sum(axis=1) < MIN_MATCHES // 2) & edges.any(axis=1)
        if not useless.any():
            break
        edges[useless] = edges[:, useless] = False
    return np.argwhere(np.triu(edges))


def _hypotheses(
    ours: _Map, theirs: _Map, cliques: Sequence[Sequence[int]]
) -> Iterator[_Hypothesis]:
    """Yield the rigid motion of each clique with all landmarks that fit it."""
    for clique in cliques:
        if len(clique) > MIN_MATCHES // 2:
            i, j = np.divmod(np.sort(clique), len(theirs.landmarks))
            yield _verified(ours, theirs, rigid_fit(theirs.points[j], ours.points[i]))


def _verified(ours: _Map, theirs: _Map, g: Array) -> _Hypothesis:
    """Return the landmarks of which each is the nearest to the other, and inside the gate."""
    n, m, C = len(ours.landmarks), len(theirs.landmarks), rotation(g[2])
    own, own_theirs = (np.einsum('iiab->iab', map_.P) for map_ in (ours, theirs))
    S = own[:, None] + C @ own_theirs @ C.T
    r = ours.points[:, None] - transform(g, theirs.points)
    d2 = squared_distances(r.reshape(-1, 2), S.reshape(-1, 2, 2)).reshape(n, m)
    nearest = d2.argmin(axis=1)
    fits = (d2.argmin(axis=0)[nearest] == np.arange(n)) & (
        d2.min(axis=1) <= chi_square_quantile(2, MATCH_PROBABILITY))
    return _Hypothesis(np.flatnonzero(fits), nearest[fits], g)


def _differ(one: _Hypothesis, other: _Hypothesis, points: Array) -> bool:
    """Return whether two hypotheses place the points of a map differently."""
    centre = points.mean(axis=0, keepdims=True)
    moved = transform(one.g, centre) - transform(other.g, centre)
    return bool(
        np.hypot(*moved[0]) > SAME_POSITION or abs(wrap(one.g[2] - other.g[2])) > SAME_HEADING)


def _renamed(state: JointState, new_keys: dict[tuple[str, int], tuple[str, int]]) -> JointState:
    """Return a copy of a state with other keys of its landmarks."""
    def with_key(landmark: Landmark) -> Landmark:
        renamed = copy(landmark)
        renamed.key = new_keys.get(landmark.key, landmark.key)
        renamed.distinct = {new_keys.get(key, key) for key in landmark.distinct}
        return renamed

    variables = [
        with_key(variable) if isinstance(variable, Landmark) else variable
        for variable in state.variables()]
    covariance = Covariance()
    covariance.insert(state.marginal(variables))
    return JointState(variables, state.estimates(), state.x_first.copy(), covariance)
