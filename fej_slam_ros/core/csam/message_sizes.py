# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What a robot sends so that another one can align their maps, as few bytes as can be.

Section I of [Andersson]: before any map is shared, the poses that met and the square-root
information of them suffice. For a short meeting that is the least; the subset is dense, so that
for a long one the log of all measurements is shorter. All forms lead to the same base node.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from fej_slam_ros.core.csam.base_node import RendezvousInformation
from fej_slam_ros.core.csam.joining import alignment_window, RendezvousMeasurement
from fej_slam_ros.core.csam.maps import JointMap, LocalMap, subset
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import concatenated
from fej_slam_ros.core.smoothing.marginals import Information

Arrays = list[NDArray[Any]]


def forms(alone: JointMap, met: Indices) -> dict[str, bytes]:
    """
    Return the messages that a robot may choose from, by the name of their form.

    Parameters
    ----------
    alone : the map of the robot alone
    met : (k,) array, numbers of the poses that met

    Returns
    -------
    dict
        ``subset``: the poses that met and the square-root information of them; ``log``: all that
        was measured; ``map``: the square-root information of the whole map

    """
    return {form: _packed(write(alone, met)) for form, (write, _) in FORMS.items()}


def sizes(
    maps: Sequence[LocalMap], meetings: Sequence[RendezvousMeasurement]
) -> dict[tuple[str, str], dict[str, int]]:
    """
    Return how many bytes each form takes, for each sender and receiver who met.

    The poses that are sent are those in the middle of all observations that the two had of each
    other: those that `join` aligns by, where they met once.

    Parameters
    ----------
    maps : of the robots alone
    meetings : of these robots, in the order of time

    Returns
    -------
    dict
        Bytes by the name of the form, for each (sender, receiver).

    """
    pairs: dict[frozenset[str], list[RendezvousMeasurement]] = {}
    for met in meetings:
        pairs.setdefault(frozenset((met.observer, met.seen)), []).append(met)
    alone = {local.robot: JointMap.of(local) for local in maps}
    return {
        (sender, receiver): {
            form: len(message)
            for form, message in forms(alone[sender], _poses_of(sender, alignment_window(of_pair))).items()}
        for pair, of_pair in pairs.items()
        for sender, receiver in permutations(sorted(pair))}


def _poses_of(robot: str, meetings: Sequence[RendezvousMeasurement]) -> Indices:
    """Return the numbers of a robot's poses that saw or were seen."""
    return np.unique([
        met.pose if met.observer == robot else met.seen_pose for met in meetings])


def smallest(by_form: Mapping[str, float]) -> str:
    """Return the form that takes the fewest bytes."""
    return min(by_form, key=by_form.__getitem__)


def received(form: str, message: bytes) -> RendezvousInformation:
    """Return what a message says of the poses that met, in the order of their numbers."""
    _, read = FORMS[form]
    return read(_unpacked(message))


def _write_subset(alone: JointMap, met: Indices) -> Arrays:
    sent = alone.subset(met)
    rows = np.array([sent.middle, sent.start], np.int32)
    return [rows, sent.origin, sent.poses, sent.R_sqrt[np.triu_indices(len(sent.R_sqrt))]]


def _read_subset(arrays: Arrays) -> RendezvousInformation:
    (alignment_window, start), origin, poses, packed = arrays
    R_sqrt = np.zeros((3 * len(poses) - 3,) * 2)
    R_sqrt[np.triu_indices(len(R_sqrt))] = packed
    return RendezvousInformation(poses, int(alignment_window), int(start), origin, R_sqrt)


def _write_log(alone: JointMap, met: Indices) -> Arrays:
    ways, seen = concatenated(alone.problem.increments), concatenated(alone.problem.observations)
    in_Q, in_R = np.triu_indices(3), np.triu_indices(2)
    return [
        met.astype(np.int32), alone.values.poses[0], ways.u, ways.Q[:, in_Q[0], in_Q[1]],
        seen.pose.astype(np.int32), seen.landmark.astype(np.int32), seen.z,
        seen.R[:, in_R[0], in_R[1]]]


def _read_log(arrays: Arrays) -> RendezvousInformation:
    met, origin, u, Q, pose, landmark, z, R = arrays
    scans = [
        [Observation(int(landmark[m]), z[m], _symmetric(R[m])) for m in np.flatnonzero(pose == k)]
        for k in range(len(u) + 1)]
    smoother = IncrementalSmoother(scans[0])
    for u_k, Q_k, scan in zip(u, Q, scans[1:]):
        smoother.add(u_k, _symmetric(Q_k), scan)
    keys = tuple(('', number) for number in smoother.numbers)
    local = LocalMap('', smoother.problem(), smoother.values(), keys)
    sent: RendezvousInformation = JointMap.of(local).subset(met)
    return replace(sent, origin=origin)


def _write_map(alone: JointMap, met: Indices) -> Arrays:
    there = alone.in_frame_of(int(met[len(met) // 2]))
    R_sqrt, coordinates = there.information().square_root()
    return [
        met.astype(np.int32), alone.values.poses[0], there.values.poses,
        np.array(len(there.values.points)), coordinates.astype(np.int32), R_sqrt.data,
        R_sqrt.indices, R_sqrt.indptr]


def _read_map(arrays: Arrays) -> RendezvousInformation:
    met, origin, poses, points, coordinates, *entries = arrays
    R_sqrt = csc_array(tuple(entries), shape=(len(coordinates),) * 2)
    known = Information((R_sqrt.T @ R_sqrt).tocsc(), coordinates, len(poses), int(points))
    return subset(poses, met, 0, origin, known)


#: How each form is written and read.
FORMS: dict[str, tuple[Callable[[JointMap, Indices], Arrays], Callable[[Arrays], RendezvousInformation]]] = {
    'subset': (_write_subset, _read_subset),
    'log': (_write_log, _read_log),
    'map': (_write_map, _read_map)}


def _packed(arrays: Arrays) -> bytes:
    """Return arrays as bytes, before each its type and shape in a line of text."""
    return b''.join(
        ','.join([array.dtype.str, *map(str, array.shape)]).encode() + b'\n' + array.tobytes()
        for array in arrays)


def _unpacked(message: bytes) -> Arrays:
    arrays: Arrays = []
    at = 0
    while at < len(message):
        data = message.index(b'\n', at) + 1
        kind, *shape = message[at:data].decode().strip().split(',')
        lengths = tuple(map(int, shape))
        arrays.append(np.frombuffer(message, kind, math.prod(lengths), data).reshape(lengths))
        at = data + arrays[-1].nbytes
    return arrays


def _symmetric(upper: Array) -> Array:
    """Return the matrix (n, n) of which the upper triangle is given, row by row."""
    n = int(np.sqrt(2 * len(upper)))
    full = np.zeros((n, n))
    full[np.triu_indices(n)] = upper
    return full + np.triu(full, 1).T
