# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times of whole runs: one through the estimator, and a Monte Carlo campaign."""

from dataclasses import dataclass, replace
import resource
from time import perf_counter

import numpy as np

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.experiments.common.executor import in_order, processes
from fej_slam_ros.experiments.liu.configurations import CONFIGURATIONS, own_world
from fej_slam_ros.experiments.liu.monte_carlo import simulate, table_runs, table_tasks
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure
from fej_slam_ros.sim.world import make_world

#: Number of landmarks and steps of the two-robot Victoria Park run, and a sensor range [m].
PARK_LANDMARKS, PARK_STEPS, PARK_RANGE = 287, 2545, 7.0


@dataclass(frozen=True)
class RunTime:
    """Duration of a run [s], its number of steps and of states at its end."""

    name: str
    seconds: float
    steps: int
    states: int


@dataclass(frozen=True)
class CampaignTime:
    """Duration of the Monte Carlo runs of all experiments of [Liu], with all their filters."""

    runs: int  #: Runs of each experiment
    jobs: int  #: Worker processes
    seconds: float  #: Including start and end of the workers
    memory: int  #: Largest resident size of this process and all workers together [bytes]


def run_time(name: str, records: list[Record], settings: Settings) -> RunTime:
    """Time a run through the estimator, including the ordering of records."""
    estimator = Estimator(settings)
    begin = perf_counter()
    steps = sum(1 for _ in estimator.run(records))
    seconds = perf_counter() - begin
    return RunTime(name, seconds, steps, estimator.groups.team.state.covariance.dimension)


def synthetic_park() -> tuple[list[Record], Settings]:
    """Return a synthetic run of the size of the two-robot Victoria Park run."""
    environment = ENVIRONMENTS['circles']
    loops = -(-PARK_STEPS // environment.world.steps_per_loop)
    rng = np.random.default_rng(1)
    world = make_world(replace(environment.world, landmarks=PARK_LANDMARKS, loops=loops), rng)
    x, y, phi = world.true_poses['r2'][0].tolist()
    robots = RobotSettings('r1', 1), RobotSettings('r2', 2, start_pose=(x, y, phi))
    records = list(measure(world, replace(environment.sensors, range=PARK_RANGE), rng))
    return records, Settings(robots, 'r1', gate_probability=1.0)


def campaign_time(runs: int, jobs: int) -> CampaignTime:
    """Time the runs of ``reproduce tables`` in the worlds of this package."""
    worlds = {configuration: own_world(configuration) for configuration in CONFIGURATIONS}
    tasks = table_tasks(worlds, seed=1, runs=range(1, runs + 1))
    begin = perf_counter()
    with processes(jobs) as executor:
        finished = list(in_order(executor, simulate, tasks))
    seconds = perf_counter() - begin
    table_runs(worlds, finished, runs)
    own, largest = (
        1024 * resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return CampaignTime(runs, jobs, seconds, own + jobs * largest)
