# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long whole runs take, the matching of observations, the smoother, and Monte Carlo runs."""

from dataclasses import dataclass, replace
from itertools import pairwise
import resource
from time import perf_counter

import numpy as np

from fej_slam_ros.benchmark.machine import best
from fej_slam_ros.core.data_association.joint_compatibility import JointCompatibilityMatcher
from fej_slam_ros.core.data_association.landmark_manager import LandmarkManager
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, between, wrap_all
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import Motion, NO_ID, Observation, Record, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.core.smoothing.least_squares import (
    information, LandmarkFactors, OdometryFactors, Problem, Values)
from fej_slam_ros.core.smoothing.normal_equations import Cholesky
from fej_slam_ros.experiments.common.executor import in_order, processes
from fej_slam_ros.experiments.liu.configurations import CONFIGURATIONS, own_world
from fej_slam_ros.experiments.liu.monte_carlo import simulate
from fej_slam_ros.experiments.liu.simulated_runs import gathered, tasks
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure
from fej_slam_ros.sim.world import make_world

#: As many landmarks and steps as the two-robot Victoria Park run has.
PARK_LANDMARKS, PARK_STEPS, PARK_RANGE = 287, 2545, 7.0
#: The whole log has as many poses and landmarks, and 6.6 observations a pose.
LOG_POSES, LOG_LANDMARKS, LOG_OBSERVATIONS = 6899, 299, 7

#: A scan of so many observations without identity, by a robot that is not sure of where it is.
UNKNOWN, KNOWN_LANDMARKS, SCANS = 20, 1000, 100
DRIFT = np.diag([0.2, 0.2, 0.02]) ** 2

ROBOTS = ('r1', 'r2')
Q = np.diag([0.01, 0.01, 0.001]) ** 2
R = np.diag([0.1, 0.1]) ** 2


@dataclass(frozen=True)
class MatchingTime:
    """
    Times of finding the landmarks of a scan without identity [s].

    Attributes
    ----------
    observations, landmarks : of the scan, and of the map
    median, p99 : over scans
    matched : which part of the observations was matched, and rightly

    """

    observations: int
    landmarks: int
    median: float
    p99: float
    matched: float


@dataclass(frozen=True)
class RunTime:
    """Duration of a whole run [s], its number of steps and of states at its end."""

    name: str
    seconds: float
    steps: int
    states: int


@dataclass(frozen=True)
class SmootherTime:
    """
    Times of least squares over all poses of a robot and all landmarks [s].

    Attributes
    ----------
    name : of the data
    unknowns : coordinates that are solved for
    begin : from the measurements to the first square root: order, Jacobians, factorisation
    factorisation : of one more matrix of that pattern
    marginals : covariances of every pose and every landmark

    """

    name: str
    unknowns: int
    begin: float
    factorisation: float
    marginals: float


@dataclass(frozen=True)
class CampaignTime:
    """
    Duration of the Monte Carlo runs of all experiments of [Liu], with all their filters.

    Attributes
    ----------
    runs : of each experiment
    jobs : worker processes
    seconds : from the first worker's start to the last one's end
    memory : largest resident size of this process and all workers together [bytes]

    """

    runs: int
    jobs: int
    seconds: float
    memory: int


def matching_time() -> MatchingTime:
    """Time what it takes to find the landmarks of scans without identity."""
    rng = np.random.default_rng(1)
    team, points = _mapped_world(KNOWN_LANDMARKS, rng)
    team.predict(Motion('r1', 1, np.zeros(3), DRIFT))
    identities, matcher, times, matched = LandmarkManager(), JointCompatibilityMatcher(0.99), [], 0
    seen = np.argsort(np.hypot(*points.T))[:UNKNOWN]
    for k in range(SCANS):
        z = points[seen] + rng.normal(0.0, 0.1, (UNKNOWN, 2))
        scan = Scan('r1', k, tuple(Observation(NO_ID, z_k, R) for z_k in z))
        begin = perf_counter()
        named = identities.named(team, matcher, scan)
        times.append(perf_counter() - begin)
        given = {id_: z_k.tobytes() for id_, z_k in zip(seen.tolist(), z)}
        matched += sum(given.get(s.id) == s.z.tobytes() for s in named.numbered.observations)
    return MatchingTime(
        UNKNOWN, KNOWN_LANDMARKS, float(np.median(times)), float(np.percentile(times, 99)),
        matched / (SCANS * UNKNOWN))


def run_time(name: str, records: list[Record], settings: Settings) -> RunTime:
    """Time a whole run through the estimator, the ordering in time included."""
    estimator = Estimator(settings)
    begin = perf_counter()
    steps = sum(1 for _ in estimator.run(records))
    seconds = perf_counter() - begin
    return RunTime(name, seconds, steps, estimator.groups.team.dimension)


def synthetic_park() -> tuple[list[Record], Settings]:
    """Return a synthetic run of the size of the two-robot Victoria Park run."""
    environment = ENVIRONMENTS['circles']
    loops = -(-PARK_STEPS // environment.world.steps_per_loop)
    world = replace(environment.world, landmarks=PARK_LANDMARKS, loops=loops)
    sensors = replace(environment.sensors, range=PARK_RANGE)
    rng = np.random.default_rng(1)
    made = make_world(world, rng)
    x, y, phi = made.true_poses['r2'][0].tolist()
    robots = RobotSettings('r1', 1), RobotSettings('r2', 2, start_pose=(x, y, phi))
    records = list(measure(made, sensors, rng))
    return records, Settings(robots, 'r1', gate_probability=1.0)


def smoother_time(name: str, problem: Problem, values: Values) -> SmootherTime:
    """Time the parts of a smoother's work, each the best of three."""
    known = information(problem, values)
    return SmootherTime(
        name, len(known.coordinates), best(lambda: information(problem, values), 3),
        best(lambda: Cholesky(known.matrix), 3), best(known.marginals, 3))


def synthetic_log() -> tuple[Problem, Values]:
    """Return one robot's loops and observations, as many as the whole log of Victoria Park has."""
    steps, rng = np.arange(LOG_POSES), np.random.default_rng(1)
    angles = np.linspace(0.0, 0.02 * LOG_POSES, LOG_POSES)
    # Each loop is beside the one before.
    positions = (60.0 + 20.0 * np.sin(angles / 7.0)) * np.array([np.cos(angles), np.sin(angles)])
    poses = np.column_stack([*positions, wrap_all(angles + np.pi / 2.0)])
    points = poses[::LOG_POSES // LOG_LANDMARKS, :2][:LOG_LANDMARKS]
    points = points + rng.normal(0.0, 5.0, points.shape)
    distances = np.linalg.norm(poses[:, None, :2] - points, axis=2)
    landmark = np.argsort(distances, axis=1)[:, :LOG_OBSERVATIONS].ravel()
    pose = np.repeat(steps, LOG_OBSERVATIONS)
    u = np.array([between(a, b) for a, b in pairwise(poses)])
    z = h(poses[pose], points[landmark])
    problem = Problem(
        OdometryFactors(steps[:-1], steps[1:], u, Q), LandmarkFactors(pose, landmark, z, R))
    return problem, Values(poses, points)


def campaign_time(runs: int, jobs: int) -> CampaignTime:
    """Time the runs behind ``reproduce tables`` in our own worlds."""
    worlds = {configuration: own_world(configuration) for configuration in CONFIGURATIONS}
    todo = tasks(worlds, seed=1, numbers=range(1, runs + 1))
    begin = perf_counter()
    with processes(jobs) as executor:
        finished = list(in_order(executor, simulate, todo))
    seconds = perf_counter() - begin
    gathered(worlds, finished, runs)
    own, largest = (
        1024 * resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return CampaignTime(runs, jobs, seconds, own + jobs * largest)


def _mapped_world(landmarks: int, rng: np.random.Generator) -> tuple[Filter, Array]:
    """Return a filter that knows all landmarks of a square, and their true positions."""
    points = rng.uniform(-50.0, 50.0, (landmarks, 2))
    team = Filter(JointState(), FirstEstimates(), Gate(1.0))
    for name in ROBOTS:
        team.state.insert_robot(name, 0, np.zeros(3), np.zeros((3, 3)))
    team.start_landmarks([
        Scan('r1', 0, tuple(Observation(k, point, R) for k, point in enumerate(points)))])
    return team, points
