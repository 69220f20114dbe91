# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated experiments of [Andersson], section V, by seed, with what is true of them."""

from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.records import Record
from fej_slam_ros.sim.encounters import Encounter
from fej_slam_ros.sim.environments import ENCOUNTERS


class Scene(NamedTuple):
    """One run: what is true, also of each robot's own numbers, and what the robots measured."""

    truth: Encounter
    records: tuple[Record, ...]


def scene(experiment: str, seed: int) -> Scene:
    """Return a run of ``map_joining`` or ``sensor_extension``, as ``simulate`` makes it."""
    environment = ENCOUNTERS[experiment]
    return Scene(
        environment.true_world(np.random.default_rng(seed)),
        tuple(environment.records(np.random.default_rng(seed))))
