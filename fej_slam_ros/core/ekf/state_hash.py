# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A hash over all estimates, by which two runs are compared bit for bit."""

from collections.abc import Mapping, Sequence
from hashlib import sha256

import numpy as np

from fej_slam_ros.core.ekf.joint_covariance import lower_rows
from fej_slam_ros.core.ekf.state import JointState, Variable
from fej_slam_ros.core.pieces import pause

#: Number of rows of the covariance in a piece: 5 MB at 2,500 landmarks.
ROWS_PER_PIECE = 128


def state_hash(frames: Mapping[str, JointState], robots: Sequence[str]) -> str:
    """
    Return SHA-256 over the states in canonical order, independent of the order of the slots.

    For each frame: its name; name and stamp of each robot in the given order; of each landmark, in
    order of key, the robot whose ID it has ('' for shared IDs) and the ID; of each rendezvous
    point, in order of key, observer, observed and stamp; estimate and first estimate of each of
    these variables in the same order; the lower triangle of their joint covariance, row by row.
    Texts are UTF-8, integers and floats 8 bytes in the byte order of this machine.

    """
    digest = sha256()
    for frame, state in frames.items():
        digest.update(frame.encode())
        variables: list[Variable] = []
        for name in robots:
            if name in state.robots:
                robot = state.robots[name]
                digest.update(name.encode() + np.int64(robot.stamp).tobytes())
                variables.append(robot)
        for key in sorted(state.landmarks):
            digest.update(key[0].encode() + np.int64(key[1]).tobytes())
            variables.append(state.landmarks[key])
        for point in sorted(state.rendezvous_points):
            names = point.observer + point.observed
            digest.update(names.encode() + np.int64(point.stamp).tobytes())
            variables.append(state.rendezvous_points[point])
        if variables:
            for variable in variables:
                digest.update(state.estimate(variable).tobytes())
                digest.update(state.first_estimate(variable).tobytes())
            slots = [variable.slot for variable in variables]
            for number, row in enumerate(lower_rows(state.covariance, slots)):
                digest.update(row.tobytes())
                if number % ROWS_PER_PIECE == ROWS_PER_PIECE - 1:
                    pause()
    return digest.hexdigest()
