# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A hash over all that is estimated, to tell at a glance whether two runs gave the same bits."""

from collections.abc import Mapping, Sequence
from hashlib import sha256

import numpy as np

from fej_slam_ros.core.ekf.state import JointState, Variable


def state_hash(frames: Mapping[str, JointState], robots: Sequence[str]) -> str:
    """
    Return SHA-256 over the states in canonical order, which is independent of that of the slots.

    For each frame: its name; name and stamp of each robot in the given order; of each landmark,
    by identity, whose number it has ('' where numbers are shared) and the number; of each place
    where a robot was seen, by identity, seer, seen and stamp; estimate and first estimate of each
    of these in the same order; the lower triangle of their joint covariance, row by row. Texts
    are UTF-8, integers and floats 8 bytes of this machine's order.

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
        for place in sorted(state.places):
            digest.update((place.observer + place.seen).encode() + np.int64(place.stamp).tobytes())
            variables.append(state.places[place])
        if variables:
            for variable in variables:
                digest.update(state.estimate(variable).tobytes())
                digest.update(state.first_estimate(variable).tobytes())
            P = state.marginal(variables)
            digest.update(P[np.tril_indices(len(P))].tobytes())
    return digest.hexdigest()
