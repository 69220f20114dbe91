# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All runs of the simulated experiments of [Liu]: which there are, and what came of them."""

from collections.abc import Mapping, Sequence

from fej_slam_ros.experiments.liu.configurations import Configuration, FILTERS
from fej_slam_ros.experiments.liu.monte_carlo import Errors, MonteCarloTask, stack
from fej_slam_ros.sim.world import World

#: The errors of all runs, stacked, by experiment and by the filter's name in the tables.
Runs = Mapping[Configuration, Mapping[str, Errors]]


def tasks(
    worlds: Mapping[Configuration, World], seed: int, numbers: Sequence[int]
) -> list[MonteCarloTask]:
    """Return the runs of given numbers in each world, experiment by experiment."""
    return [
        MonteCarloTask(world, configuration.simulated.sensors, tuple(FILTERS.values()),
             (seed, *configuration, number))
        for configuration, world in worlds.items() for number in numbers]


def gathered(
    worlds: Mapping[Configuration, World], finished: Sequence[Mapping[str, Errors]], runs: int
) -> Runs:
    """Return what the tasks have given, of which only the first may be finished."""
    of_each = [finished[k * runs:(k + 1) * runs] for k in range(len(worlds))]
    return {
        configuration: {
            name: stack([run[filter_name] for run in done])
            for name, filter_name in FILTERS.items()}
        for configuration, done in zip(worlds, of_each) if done}
