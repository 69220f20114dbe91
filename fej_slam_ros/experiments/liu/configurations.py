# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated experiments of [Liu], section 4.1: what was run, and what was printed."""

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

#: By the names of the tables' rows, those of our filters.
FILTERS = {'std': 'standard', 'ideal': 'ideal', 'fej': 'fej'}

#: Columns of Tables 1 and 2: NEES divided by the dimension, RMSE in m and in rad.
ENTRIES = ('r1_nees', 'r1_pos', 'r1_head', 'r2_nees', 'r2_pos', 'r2_head', 'f_nees', 'f_pos')


class Configuration(NamedTuple):
    """A simulated experiment: environment 1 or 2, and how many landmarks it has."""

    environment: int
    landmarks: int

    def __str__(self) -> str:
        return f'{self.environment}/{self.landmarks}'

    @property
    def simulated(self) -> Environment:
        """Return noise, loops and steps, with a world of our own."""
        environment = (ENVIRONMENTS['circles'], ENVIRONMENTS['figure_eight'])[self.environment - 1]
        return replace(environment, world=replace(environment.world, landmarks=self.landmarks))


CONFIGURATIONS = tuple(
    Configuration(environment, landmarks) for environment in (1, 2) for landmarks in (20, 60, 100))


#: Seeds of our worlds, chosen of 1 to 300 by what is published of the paper's: as many landmarks
#: shared at step 0, and then nearest in how many each robot sees in the mean.
WORLD_SEEDS = {(1, 20): 23, (1, 60): 155, (1, 100): 153, (2, 20): 292, (2, 60): 118, (2, 100): 229}


def own_world(configuration: Configuration) -> World:
    """Return our world of an experiment: always the same one, as in the paper."""
    rng = np.random.default_rng(WORLD_SEEDS[configuration])
    return configuration.simulated.true_world(rng)


def authors_world(folder: Path, configuration: Configuration) -> World:
    """
    Return the authors' world of an experiment, from a folder with their files.

    Raises
    ------
    UserError
        A file is missing or not theirs.

    """
    truth = simulated_worlds.read(folder, *configuration)
    stamps = configuration.simulated.world.stamps
    numbers = [*range(1, configuration.landmarks + 1)]
    steps = {len(poses) for poses in truth.poses.values()}
    if steps != {len(stamps)} or [*truth.landmarks] != numbers:
        path = simulated_worlds.file_of(folder, *configuration)
        raise UserError(
            f'{path}: it has other than the {len(stamps) - 1} steps and {configuration.landmarks}'
            ' landmarks of the experiment; fetch the file again')
    return World(tuple(truth.poses), stamps, truth.poses, truth.landmarks)


@dataclass(frozen=True)
class PublishedRange:
    """
    What chance does to an entry made of 100 runs.

    Attributes
    ----------
    mean : of such entries
    sd100 : their standard deviation
    lo95, hi95, lo997, hi997 : where 95 % and 99.7 % of them lie

    """

    mean: float
    sd100: float
    lo95: float
    hi95: float
    lo997: float
    hi997: float


@dataclass(frozen=True)
class Published:
    """
    An entry of the tables in the authors' worlds.

    Attributes
    ----------
    paper : as [Liu] prints it
    chance : what it may be, from 2000 runs of a program independent of this one

    """

    paper: float
    chance: PublishedRange


def published() -> dict[str, Published]:
    """Return all entries by ``environment/landmarks/filter/entry``."""
    text = (files(__package__) / 'published.json').read_text(encoding='utf-8')
    return {
        key: Published(paper, PublishedRange(**chance))
        for key, (paper, chance) in json.loads(text).items()}
