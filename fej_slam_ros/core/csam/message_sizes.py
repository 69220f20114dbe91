# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages by which a robot lets another one align their maps, and their sizes.

Section I of [Andersson]: before any map is shared, the rendezvous poses and their square-root
information suffice. These are smallest for a short rendezvous; the information is dense, so that
for a long one the log of all measurements is smaller. All forms lead to the same base node.
"""

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.rendezvous import Measurements, RendezvousMeasurement
from fej_slam_ros.core.csam.rendezvous_alignment import alignment_window
from fej_slam_ros.core.csam.team_solution import SmoothingTask, solve, TeamMap
from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.geometry import Indices
from fej_slam_ros.core.smoothing.factors import concatenated
from fej_slam_ros.core.smoothing.marginals import Information

#: Sizes [bytes] of the messages that align two maps by form, for each (sender, receiver).
MessageSizes = Mapping[tuple[str, str], Mapping[str, int]]


def solution_and_sizes(task: SmoothingTask) -> tuple[TeamMap, MessageSizes]:
    """Return the solution of a task, and the sizes of messages between the solved robots."""
    team_map = solve(task)
    maps = [local for local in task.maps if local.robot not in team_map.unsolved]
    names = {local.robot for local in maps}
    return team_map, sizes(
        maps, [m for m in task.measurements if {m.observer, m.observed} <= names])


def sizes(maps: Sequence[LocalMap], measurements: Measurements) -> MessageSizes:
    """
    Return the size of each form [bytes] for each (sender, receiver) with a rendezvous.

    The poses sent are those in the middle of all observations of the two robots, given in the
    order of time; `join_maps` aligns by the same ones if there was one rendezvous. A map is sent
    once, with the poses for all receivers. A sender is left out if its information is singular
    within rounding.

    """
    poses = _sent_poses(measurements)
    of_all: dict[tuple[str, str], Mapping[str, int]] = {}
    for local in maps:
        of_sender = {pair: sent for pair, sent in poses.items() if pair[0] == local.robot}
        try:
            # Sizes do not depend on the values, and outliers would keep a map from a minimum.
            of_all.update(_sizes_of_sender(JointMap.unsolved(local), of_sender))
        except SingularError:
            continue
    return {pair: of_all[pair] for pair in poses if pair in of_all}


def _sizes_of_sender(local: JointMap, poses: Mapping[tuple[str, str], Indices]) -> MessageSizes:
    """Return the sizes of the messages of a robot, given the poses (k,) that it sends."""
    if not poses:
        return {}
    sent = np.unique(np.concatenate([*poses.values()]))
    size_of_map = len(map_message(local, sent))
    # Factored once for all receivers.
    information = local.information([*local.problem.fixed_poses, *sent])
    return {
        pair: {
            'subset': len(subset_message(local, of_pair, information)),
            'log': len(log_message(local, of_pair)), 'map': size_of_map}
        for pair, of_pair in poses.items()}


def _sent_poses(measurements: Measurements) -> dict[tuple[str, str], Indices]:
    """Return the poses (k,) that are sent, by sender and receiver."""
    pairs: dict[frozenset[str], list[RendezvousMeasurement]] = {}
    for m in measurements:
        pairs.setdefault(frozenset((m.observer, m.observed)), []).append(m)
    return {
        (sender, receiver): np.unique([
            m.pose if m.observer == sender else m.observed_pose
            for m in alignment_window(of_pair)])
        for pair, of_pair in pairs.items() for sender, receiver in permutations(sorted(pair))}


def smallest(by_form: Mapping[str, float]) -> str:
    """Return the form with the fewest bytes."""
    return min(by_form, key=by_form.__getitem__)


def subset_message(
    local: JointMap, poses: Indices, information: Information | None = None
) -> bytes:
    """Return rendezvous poses (k,) and their square-root information."""
    sent = local.rendezvous_information(poses, information)
    rows = np.array([sent.middle, sent.start], np.int32)
    return _packed([
        rows, sent.origin, sent.poses, sent.R_sqrt[np.triu_indices(len(sent.R_sqrt))]])


def log_message(local: JointMap, poses: Indices) -> bytes:
    """Return all measurements of a robot, and which of its poses (k,) are rendezvous poses."""
    odometry = concatenated(local.problem.odometry)
    landmarks = concatenated(local.problem.landmarks)
    in_Q, in_R = np.triu_indices(3), np.triu_indices(2)
    return _packed([
        poses.astype(np.int32), local.values.poses[0],
        odometry.z, odometry.R[:, in_Q[0], in_Q[1]],
        landmarks.pose.astype(np.int32), landmarks.target.astype(np.int32), landmarks.z,
        landmarks.R[:, in_R[0], in_R[1]]])


def map_message(local: JointMap, poses: Indices) -> bytes:
    """Return the square-root information of the whole map, with rendezvous poses (k,)."""
    centred = local.in_frame_of(int(poses[len(poses) // 2]))
    R_sqrt, coordinates = centred.information(range(len(centred.values.poses))).square_root()
    return _packed([
        poses.astype(np.int32), local.values.poses[0], centred.values.poses,
        np.array(len(centred.values.points)), coordinates.astype(np.int32), R_sqrt.data,
        R_sqrt.indices, R_sqrt.indptr])


def _packed(arrays: Sequence[NDArray[Any]]) -> bytes:
    """Return arrays as bytes, each after a line of text with its type and shape."""
    return b''.join(
        ','.join([array.dtype.str, *map(str, array.shape)]).encode() + b'\n' + array.tobytes()
        for array in arrays)
