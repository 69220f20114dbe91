# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of the messages for an alignment."""

from dataclasses import replace
import math

import numpy as np
from scipy.sparse import csc_array

from fej_slam_ros.core.csam.base_node import RendezvousInformation, square_root_information
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.geometry import symmetric, upper_triangular
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother


def received(form, message):
    """Return the content of a message, with the poses in the order of their indices."""
    return READERS[form](unpacked(message))


def unpacked(message):
    """Return the arrays of a message."""
    arrays, at = [], 0
    while at < len(message):
        data = message.index(b'\n', at) + 1
        dtype, *shape = message[at:data].decode().strip().split(',')
        lengths = tuple(map(int, shape))
        arrays.append(np.frombuffer(message, dtype, math.prod(lengths), data).reshape(lengths))
        at = data + arrays[-1].nbytes
    return arrays


def read_subset(arrays):
    (middle, start), origin, poses, packed = arrays
    return RendezvousInformation(
        poses, int(middle), int(start), origin, upper_triangular(packed))


def read_log(arrays):
    poses, origin, u, Q, pose, landmark, z, R = arrays
    scans = [
        [Observation(int(landmark[m]), z[m], symmetric(R[m])) for m in np.flatnonzero(pose == k)]
        for k in range(len(u) + 1)]
    smoother = IncrementalSmoother(scans[0])
    for u_k, Q_k, scan in zip(u, Q, scans[1:]):
        smoother.add(u_k, symmetric(Q_k), scan)
    keys = tuple(('', id_) for id_ in smoother.landmark_index)
    local = LocalMap('', smoother.problem(), smoother.values(), keys)
    return replace(JointMap.of(local).rendezvous_information(poses), origin=origin)


def read_map(arrays):
    rendezvous, origin, poses, _, coordinates, *entries = arrays
    R_sqrt = csc_array(tuple(entries), shape=(len(coordinates),) * 2)
    middle = len(rendezvous) // 2
    rows = rendezvous if 0 in rendezvous else np.append(rendezvous, 0)
    index = coordinates.tolist().index
    wanted = [index(3 * pose + k) for pose in np.delete(rows, middle).tolist() for k in range(3)]
    P = np.linalg.inv((R_sqrt.T @ R_sqrt).toarray())[np.ix_(wanted, wanted)]
    return RendezvousInformation(
        poses[rows], middle, rows.tolist().index(0), origin, square_root_information(P))


READERS = {'subset': read_subset, 'log': read_log, 'map': read_map}
