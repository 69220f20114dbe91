# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated experiments of [Liu], section 4.1: their worlds and published results."""

from dataclasses import dataclass, replace
from importlib.resources import files
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fej_slam_ros.datasets.liu import simulated_worlds
from fej_slam_ros.errors import UserError
from fej_slam_ros.sim.environments import Environment, ENVIRONMENTS
from fej_slam_ros.sim.world import World

#: Names of the filters in the tables, with those of this package.
TABLE_FILTERS = {'std': 'standard', 'ideal': 'ideal', 'fej': 'fej'}
#: Entries of Tables 1 and 2 with their titles.
TABLE_ENTRIES = {
    'r1_nees': 'R1 NEES/3', 'r1_pos': 'R1 pos [m]', 'r1_head': 'R1 head [rad]',
    'r2_nees': 'R2 NEES/3', 'r2_pos': 'R2 pos [m]', 'r2_head': 'R2 head [rad]',
    'f_nees': 'map NEES/2', 'f_pos': 'map pos [m]'}


class Configuration(NamedTuple):
    """A simulated experiment: environment 1 or 2, and its number of landmarks."""

    environment: int
    landmarks: int

    def __str__(self) -> str:
        return f'{self.environment}/{self.landmarks}'

    @property
    def simulated(self) -> Environment:
        """Return noise, loops and steps of the paper, with a world of this package."""
        environment = (ENVIRONMENTS['circles'], ENVIRONMENTS['figure_eight'])[self.environment - 1]
        return replace(environment, world=replace(environment.world, landmarks=self.landmarks))


CONFIGURATIONS = tuple(
    Configuration(environment, landmarks) for environment in (1, 2) for landmarks in (20, 60, 100))


#: Seeds of the worlds of this package, from 1 to 300: those with the paper's number of landmarks
#: shared at step 0, and then the closest mean number of landmarks in each robot's view.
WORLD_SEEDS = {(1, 20): 23, (1, 60): 155, (1, 100): 153, (2, 20): 292, (2, 60): 118, (2, 100): 229}


def own_world(configuration: Configuration) -> World:
    """Return this package's world of an experiment, the same for all runs, as in the paper."""
    rng = np.random.default_rng(WORLD_SEEDS[configuration])
    return configuration.simulated.true_world(rng)


def authors_world(folder: Path, configuration: Configuration) -> World:
    """Return the authors' world of an experiment, from a folder with their files."""
    truth = simulated_worlds.read(folder, *configuration)
    stamps = configuration.simulated.world.stamps
    steps = {len(poses) for poses in truth.poses.values()}
    if steps != {len(stamps)} or [*truth.landmarks] != [*range(1, configuration.landmarks + 1)]:
        path = simulated_worlds.file_of(folder, *configuration)
        raise UserError(
            f'{path}: it does not have the {len(stamps) - 1} steps and {configuration.landmarks}'
            ' landmarks of the experiment; fetch the file again')
    return World(tuple(truth.poses), stamps, truth.poses, truth.landmarks)


@dataclass(frozen=True)
class EntryRange:
    """Distribution of an entry made of 100 runs."""

    #: Mean and standard deviation of such entries.
    mean: float
    sd100: float
    #: Bounds of the central 95 % and 99.7 % of them.
    lo95: float
    hi95: float
    lo997: float
    hi997: float


@dataclass(frozen=True)
class PublishedEntry:
    """An entry of the tables in the authors' worlds."""

    paper: float  #: Value printed in [Liu]
    expected: EntryRange  #: Its distribution, from 2000 runs of an independent program


def published() -> dict[str, PublishedEntry]:
    """Return all entries by ``environment/landmarks/filter/entry``."""
    text = (files(__package__) / 'published.json').read_text(encoding='utf-8')
    return {
        key: PublishedEntry(paper, EntryRange(**expected))
        for key, (paper, expected) in json.loads(text).items()}
