# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks without ID that two frames share, found by the distances between them.

An assignment pairs a landmark of one frame with one of the other. Two assignments are consistent
if the distances between their landmarks are equal, which does not depend on the frames; they are
an edge of a graph. The same k landmarks in both frames are a clique, each edge of which is in
k - 2 triangles, whereas distances that are equal by chance rarely form any: the densest part of
the graph gives a rigid motion. The hypothesis is this motion with all landmarks that fit it. It is
accepted only if no other has half as many: in a row of posts, every shift by a post is one.

The part in which each edge is in k - 2 triangles is the k-truss, [Cohen] J. Cohen, Trusses:
cohesive subgraphs for social network analysis, 2008.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from fej_slam_ros.core.chi_square import chi_square_quantile, squared_distances
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.state import JointState, Landmark, position_indices
from fej_slam_ros.core.geometry import Array, Indices, rigid_fit, rotation, transform, wrap
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.pieces import pause
from fej_slam_ros.core.records import LandmarkKey, NO_ID
from fej_slam_ros.core.sentences import counted

#: Minimum number of landmarks in a hypothesis: five distances agree by chance in one of 10^6 pairs
#: of maps of twelve landmarks, three in most.
MIN_MATCHES = 5
#: Smallest clique that determines a rigid motion.
MIN_CLIQUE = 3
#: Largest ratio of the numbers of landmarks of the second-best hypothesis and of the best.
MAX_SECOND_BEST = 0.5
#: Probability with which the distances, and the positions after the fit, of one landmark agree.
MATCH_PROBABILITY = 0.999
#: Landmarks that are closer to each other determine no heading [m].
MIN_LANDMARK_DISTANCE = 0.5
#: Hypotheses that differ by less are the same [m], [rad].
SAME_POSITION, SAME_HEADING = 0.5, 0.1
#: Maximum numbers of landmarks of the smaller and of the larger map, those observed last: the
#: first pair is used whose graph has at most MAX_PATHS paths of two edges, and whose truss at most
#: MAX_EDGES edges. With MAX_HYPOTHESES, this bounds the time to some tenths of a second.
MAX_LANDMARKS = (40, 300), (20, 300), (20, 150), (20, 75)
MAX_PATHS, MAX_EDGES, MAX_HYPOTHESES = 4_000_000, 5_000, 10
#: Number of fits of a hypothesis, each to the landmarks that fit the one before.
FITS = 3

TOO_MANY = (
    'too many distances between landmarks without ID agree with those of another map: they are'
    ' symmetric or repeated, or uncertain for how close together they are')


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

    def __len__(self) -> int:
        return len(self.ours)

    def assignments(self, theirs: _Map) -> Indices:
        """Return the numbers (k,) of its assignments, row by row."""
        return len(theirs.landmarks) * self.ours + self.theirs


def count_without_id(state: JointState) -> int:
    """Return the number of confirmed landmarks without ID."""
    return sum(landmark.key[1] < NO_ID for landmark in state.confirmed_landmarks())


def can_be_found(state: JointState) -> bool:
    """Return whether another frame may join that of a state by landmarks without ID."""
    return count_without_id(state) >= MIN_MATCHES


def shared_landmarks(
    team: JointState, group: JointState
) -> Mapping[LandmarkKey, LandmarkKey] | JoinFailure:
    """
    Return the team's key of each landmark of a group that the team has, too, by the group's key.

    Only confirmed landmarks that were observed without ID are compared. The reason for a failure
    is a sentence for users.

    """
    without_id = _latest_without_id(team, group), _latest_without_id(group, team)
    fewer = min(map(len, without_id))
    if fewer < MIN_MATCHES:
        return JoinFailure(f'{counted(fewer, "landmark")} without ID, needs {MIN_MATCHES}')
    for of_smaller, of_larger in MAX_LANDMARKS:
        ours, theirs = (
            _map(state, landmarks[-(of_smaller if len(landmarks) == fewer else of_larger):])
            for state, landmarks in zip((team, group), without_id))
        graph = _consistent(ours, theirs)
        truss = _bounded_truss(graph)
        if truss is not None:
            best = _best_hypothesis(ours, theirs, graph, truss)
            return best if isinstance(best, JoinFailure) else {
                theirs.landmarks[j].key: ours.landmarks[i].key
                for i, j in zip(best.ours, best.theirs)}
    return JoinFailure(TOO_MANY)


def renamed(state: JointState, new_keys: Mapping[LandmarkKey, LandmarkKey]) -> JointState:
    """Return a copy of a state with other keys of some landmarks."""
    def with_key(landmark: Landmark) -> Landmark:
        other = copy(landmark)
        other.key = new_keys.get(landmark.key, landmark.key)
        other.distinct = {new_keys.get(key, key) for key in landmark.distinct}
        return other

    variables = [
        with_key(variable) if isinstance(variable, Landmark) else variable
        for variable in state.variables()]
    covariance = Covariance()
    covariance.insert(state.marginal(variables))
    return JointState(variables, state.estimates(), state.x_first.copy(), covariance)


def _best_hypothesis(
    ours: _Map, theirs: _Map, graph: csr_array, truss: csr_array
) -> _Hypothesis | JoinFailure:
    """
    Return the hypothesis with the most landmarks, if no other has nearly as many.

    The graph is that of consistent assignments, of which the truss is that of `MIN_MATCHES`.

    """
    none = np.empty(0, np.intp)
    best, needed = _Hypothesis(none, none, np.zeros(3)), MIN_MATCHES
    for _ in range(MAX_HYPOTHESES):
        if truss.nnz:
            clique = _clique(_densest(truss, needed))
            found = _fitted(ours, theirs, clique)
            graph = _without(graph, np.append(clique, found.assignments(theirs)))
            best, other = sorted([best, found], key=len, reverse=True)
        elif len(best) < MIN_MATCHES:
            return JoinFailure(
                f'fewer than {MIN_MATCHES} landmarks without ID are where another map has some')
        else:
            return best
        if len(best) >= MIN_MATCHES:
            if len(other) > MAX_SECOND_BEST * len(best) and _differ(best, other, theirs.points):
                return JoinFailure(
                    f'{len(best)} landmarks without ID fit another map, but {len(other)} fit'
                    ' elsewhere, too: they are symmetric or repeated')
            # Rivals with fewer landmarks do not matter.
            needed = max(MIN_CLIQUE, int(MAX_SECOND_BEST * len(best)) + 1)
        truss = _truss(graph, needed)
    return JoinFailure(TOO_MANY)


def _latest_without_id(state: JointState, other: JointState) -> list[Landmark]:
    """Return the landmarks of a state that another may have, too, by their last observations."""
    landmarks = [
        landmark for landmark in state.confirmed_landmarks()
        if landmark.key[1] < NO_ID and landmark.key not in other.landmarks]
    return sorted(landmarks, key=lambda landmark: landmark.last_accepted)


def _map(state: JointState, landmarks: Sequence[Landmark]) -> _Map:
    n = len(landmarks)
    P = state.marginal(landmarks).reshape(n, 2, n, 2).transpose(0, 2, 1, 3)
    points = state.estimates_of(position_indices(landmarks)).reshape(-1, 2)
    return _Map(landmarks, points, P)


def _consistent(ours: _Map, theirs: _Map) -> csr_array:
    """Return the graph of consistent assignments, numbered row by row, as adjacency matrix."""
    (D, variance), (D_theirs, variance_theirs) = ours.distances(), theirs.distances()
    limit, count = chi_square_quantile(1, MATCH_PROBABILITY), len(D_theirs)
    i, j = np.nonzero(np.triu(D > MIN_LANDMARK_DISTANCE))
    distance, of_distance = D[i, j], variance[i, j]
    edges = [np.empty((2, 0), np.intp)]
    for a, b in np.argwhere(np.triu(D_theirs > MIN_LANDMARK_DISTANCE)).tolist():
        k = np.flatnonzero((distance - D_theirs[a, b]) ** 2 <= limit * (
            of_distance + variance_theirs[a, b]))
        first, second = count * i[k], count * j[k]
        edges += [np.array([first + a, second + b]), np.array([first + b, second + a])]
    rows, columns = np.hstack(edges)
    shape = (len(D) * count, len(D) * count)
    half = csr_array((np.ones(len(rows), np.int32), (rows, columns)), shape)
    return half + half.T


def _densest(truss: csr_array, k: int) -> csr_array:
    """Return the truss of the largest k in a k-truss that has edges."""
    densest = truss
    while truss.nnz:
        densest, k = truss, k + 1
        truss = _truss(truss, k)
    return densest


def _truss(graph: csr_array, k: int) -> csr_array:
    """Return the largest part of a graph in which each edge is in k - 2 triangles, k > 2."""
    while True:
        kept = csr_array(_triangles(graph) >= k - 2, dtype=np.int32)
        if kept.nnz == graph.nnz:
            return graph
        graph = kept
        pause()


def _bounded_truss(graph: csr_array) -> csr_array | None:
    """Return the truss of `MIN_MATCHES`, None if it or the graph is too large to be searched."""
    if np.square(graph.sum(axis=0)).sum() > MAX_PATHS:
        return None
    truss = _truss(graph, MIN_MATCHES)
    return truss if truss.nnz <= 2 * MAX_EDGES else None


def _triangles(graph: csr_array) -> csr_array:
    """Return in how many triangles each edge of a graph is."""
    return (graph @ graph) * graph


def _clique(graph: csr_array) -> Indices:
    """Return the nodes of the edge in most triangles and of these triangles."""
    triangles = _triangles(graph).tocoo()
    edge = triangles.data.argmax()
    ends = triangles.row[edge], triangles.col[edge]
    return np.append(ends, (graph[[ends[0]]] * graph[[ends[1]]]).indices)


def _without(graph: csr_array, nodes: Indices) -> csr_array:
    """Return a graph without the edges between some of its nodes."""
    edges = graph.tocoo()
    kept = ~(np.isin(edges.row, nodes) & np.isin(edges.col, nodes))
    return csr_array((edges.data[kept], (edges.row[kept], edges.col[kept])), graph.shape)


def _fitted(ours: _Map, theirs: _Map, assignments: Indices) -> _Hypothesis:
    """Return the rigid motion of assignments, fitted to all landmarks that fit it."""
    i, j = np.divmod(assignments, len(theirs.landmarks))
    for _ in range(FITS):
        hypothesis = _verified(ours, theirs, rigid_fit(theirs.points[j], ours.points[i]))
        if len(hypothesis) < MIN_CLIQUE:
            break
        i, j = hypothesis.ours, hypothesis.theirs
    return hypothesis


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
