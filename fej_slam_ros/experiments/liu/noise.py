# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The filters over levels of noise, in the worlds of [Liu].

In a run all filters estimate from the same measurements, so what is compared is paired. Run k
draws the same random numbers at every level, those of run k of Tables 1 and 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.experiments.liu.configurations import Configuration, ENTRIES
from fej_slam_ros.experiments.liu.metrics import entries_of_run, Mean, mean
from fej_slam_ros.experiments.liu.monte_carlo import MonteCarloTask, simulate
from fej_slam_ros.sim.sensors import SensorSettings
from fej_slam_ros.sim.world import World

FILTERS = ('standard', 'fej', 'ideal', 'invariant')
#: The two that are compared run by run.
COMPARED = ('invariant', 'fej')
DIFFERENCE = ' - '.join(COMPARED)
RMSE = tuple(entry for entry in ENTRIES if not entry.endswith('nees'))
#: The experiments of [Liu] whose worlds it is about.
CONFIGURATIONS = (Configuration(1, 20), Configuration(2, 20))


class Level(NamedTuple):
    """
    How noisy all measurements are.

    Attributes
    ----------
    position, heading : standard deviations of the odometry of one step, [m] on x and on y, [deg]
    observation : of an observation on x and on y [m]; None where it is the environment's own

    """

    position: float
    heading: float
    observation: float | None = None


#: The first is that of environment 1 in the paper.
LEVELS = (Level(0.3, 2.0), Level(0.3, 4.0), Level(0.5, 5.0), Level(1.0, 10.0, 1.0))


class Case(NamedTuple):
    """An experiment of [Liu] at a level of noise."""

    configuration: Configuration
    level: Level

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """Return the standard deviations of odometry [m], [deg] and of observations [m]."""
        position, heading, observation = self.level
        if observation is None:
            observation, _ = self.configuration.simulated.sensors.landmark_sigma
        return position, heading, observation

    @property
    def sensors(self) -> SensorSettings:
        """Return the sensors of the experiment, with the noise of the level."""
        position, heading, observation = self.sigmas
        return replace(
            self.configuration.simulated.sensors,
            odometry_sigma=(position, position, math.radians(heading)),
            landmark_sigma=(observation, observation))


#: The entries of a run of each filter.
Run = Mapping[str, Mapping[str, float]]
#: The values (n,) of each entry over n runs, by case and filter.
Samples = Mapping[Case, Mapping[str, Mapping[str, Array]]]
#: The mean of each entry by case and filter, and those of the differences under their own name.
Means = Mapping[Case, Mapping[str, Mapping[str, Mean]]]


def cases(configurations: Sequence[Configuration]) -> list[Case]:
    """Return each experiment at each level."""
    return [Case(configuration, level) for configuration in configurations for level in LEVELS]


def tasks(
    worlds: Mapping[Configuration, World], seed: int, numbers: Sequence[int]
) -> list[MonteCarloTask]:
    """Return the runs of given numbers of all cases, number by number."""
    return [
        MonteCarloTask(worlds[configuration], Case(configuration, level).sensors, FILTERS,
             (seed, *configuration, number))
        for number in numbers for configuration, level in cases([*worlds])]


def run(task: MonteCarloTask) -> Run:
    """Make a run."""
    return {name: entries_of_run(errors) for name, errors in simulate(task).items()}


def gathered(configurations: Sequence[Configuration], finished: Sequence[Run]) -> Samples:
    """Return what the tasks have given, of which only the first may be finished."""
    of_cases = cases(configurations)
    return {
        case: {
            name: {entry: np.array([one[name][entry] for one in done]) for entry in ENTRIES}
            for name in FILTERS}
        for k, case in enumerate(of_cases) if (done := finished[k::len(of_cases)])}


def means(samples: Samples) -> Means:
    """Return means over runs: of each filter's entries, and of the paired differences of RMSE."""
    one, other = COMPARED
    return {
        case: {
            **{name: {entry: mean(values) for entry, values in entries.items()}
               for name, entries in by_filter.items()},
            DIFFERENCE: {
                entry: mean(by_filter[one][entry] - by_filter[other][entry]) for entry in RMSE}}
        for case, by_filter in samples.items()}
