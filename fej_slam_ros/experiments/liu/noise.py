# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The filters at several levels of noise, in the worlds of [Liu].

In a run all filters estimate from the same measurements, so comparisons are paired. Run k draws
the same random numbers at every level, those of run k of Tables 1 and 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.experiments.liu.configurations import Configuration, TABLE_ENTRIES
from fej_slam_ros.experiments.liu.metrics import entries_of_run, sample_mean, SampleMean
from fej_slam_ros.experiments.liu.monte_carlo import MonteCarloTask, simulate
from fej_slam_ros.sim.sensors import SensorSettings
from fej_slam_ros.sim.world import World

NOISE_FILTERS = ('standard', 'fej', 'ideal', 'invariant')
#: The two filters that are compared run by run.
COMPARED = ('invariant', 'fej')
DIFFERENCE = ' - '.join(COMPARED)
RMSE_ENTRIES = tuple(entry for entry in TABLE_ENTRIES if not entry.endswith('nees'))
#: The experiments of [Liu] that provide the worlds.
NOISE_CONFIGURATIONS = (Configuration(1, 20), Configuration(2, 20))


class NoiseLevel(NamedTuple):
    """Standard deviations of all measurements."""

    #: Of the odometry of one step, in x and y [m] and in heading [deg].
    position: float
    heading: float
    #: Of an observation in x and y [m]; None for that of the environment.
    observation: float | None = None


#: The first is that of environment 1 in the paper.
LEVELS = (
    NoiseLevel(0.3, 2.0), NoiseLevel(0.3, 4.0), NoiseLevel(0.5, 5.0), NoiseLevel(1.0, 10.0, 1.0))


class NoiseCase(NamedTuple):
    """An experiment of [Liu] at a level of noise."""

    configuration: Configuration
    level: NoiseLevel

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
NoiseRun = Mapping[str, Mapping[str, float]]
#: The values (n,) of each entry over n runs, by case and filter.
Samples = Mapping[NoiseCase, Mapping[str, Mapping[str, Array]]]
#: The mean of each entry by filter, and of the differences under the key `DIFFERENCE`.
CaseMeans = Mapping[str, Mapping[str, SampleMean]]
Means = Mapping[NoiseCase, CaseMeans]


def cases(configurations: Sequence[Configuration]) -> list[NoiseCase]:
    """Return each experiment at each level."""
    return [
        NoiseCase(configuration, level) for configuration in configurations for level in LEVELS]


def tasks(
    worlds: Mapping[Configuration, World], seed: int, runs: Sequence[int]
) -> list[MonteCarloTask]:
    """Return the tasks of the given runs, each run in all cases before the next one."""
    return [
        MonteCarloTask(worlds[case.configuration], case.sensors, NOISE_FILTERS,
                       (seed, *case.configuration, run))
        for run in runs for case in cases([*worlds])]


def run(task: MonteCarloTask) -> NoiseRun:
    """Return the entries of each filter in a run."""
    return {name: entries_of_run(errors) for name, errors in simulate(task).items()}


def gathered(configurations: Sequence[Configuration], finished: Sequence[NoiseRun]) -> Samples:
    """Group the results of the finished tasks, the first ones of all, by case."""
    all_cases = cases(configurations)
    return {
        case: {
            name: {entry: np.array([one[name][entry] for one in done]) for entry in TABLE_ENTRIES}
            for name in NOISE_FILTERS}
        for k, case in enumerate(all_cases) if (done := finished[k::len(all_cases)])}


def means(samples: Samples) -> Means:
    """Return means over runs: of each filter's entries, and of the paired differences of RMSE."""
    one, other = COMPARED
    return {
        case: {
            **{name: {entry: sample_mean(values) for entry, values in entries.items()}
               for name, entries in by_filter.items()},
            DIFFERENCE: {
                entry: sample_mean(by_filter[one][entry] - by_filter[other][entry])
                for entry in RMSE_ENTRIES}}
        for case, by_filter in samples.items()}


def by_configuration(means: Means) -> dict[Configuration, dict[NoiseCase, CaseMeans]]:
    """Return the cases of each experiment."""
    configurations = dict.fromkeys(case.configuration for case in means)
    return {
        chosen: {case: rows for case, rows in means.items() if case.configuration == chosen}
        for chosen in configurations}
