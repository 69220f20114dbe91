# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
How long a step of the filter takes in a map of a given size, dense and compressed.

Two robots at 1 m/s and 10 Hz in a map that they know from the start. Both filters make the same
steps, each by itself, and must end with the same estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.synthetic_drive import drive, Happened, P_0, R, ROBOTS, SyntheticDrive
from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.covariance import SparseRows
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState, observation_columns

#: States and observations.
SIZES = (50, 2), (50, 10), (200, 10), (500, 10), (1000, 10), (2000, 10), (5000, 10)
#: From so many states on the compressed filter is timed as well.
COMPRESSED_FROM = 500
STEPS = 2000
STRIDE = 0.1
#: How often an update is made of the last step's observations.
UPDATES = 200
#: Dense and compressed may differ by so much.
EQUAL = 1e-10


@dataclass(frozen=True)
class CompressedTime:
    """
    What the compressed filter took, and that it is the dense one.

    Attributes
    ----------
    times : of its steps, those included that enter a region, and leaving the last one
    regions : how often it entered one
    difference : the largest from the dense filter at the end, in any element of x and P

    """

    times: Times
    regions: int
    difference: float


@dataclass(frozen=True)
class StepTime:
    """
    What steps took with so many states and observations; of small states only the dense filter.

    Attributes
    ----------
    update : of what the covariance has to do for an update, again and again
    dense, compressed : of whole steps

    """

    states: int
    observations: int
    steps: int
    update: Times
    dense: Times
    compressed: CompressedTime | None


def step_time(states: int, observations: int, steps: int) -> StepTime:
    """
    Time steps in which each of two robots moves and sees half of the observations.

    Raises
    ------
    ArithmeticError
        If the compressed filter is another than the dense one.

    """
    rng = np.random.default_rng(states)
    landmarks = (states - 3 * len(ROBOTS)) // 2
    made = drive(landmarks, steps, STRIDE, observations // len(ROBOTS), rng)
    dense = _mapped(made, WHOLE_MAP)
    seconds, _ = _timed(dense, made.happened)
    compressed = None
    if states >= COMPRESSED_FROM:
        compressed = _compressed_time(made, dense.state)
    update = _update_time(dense, made.happened[-1])
    return StepTime(states, observations, steps, update, Times.of(seconds), compressed)


def difference(a: JointState, b: JointState) -> float:
    """Return the largest difference of two states in any element of x_hat and P."""
    P_a, P_b, n = a.whole(), b.whole(), len(b.x_hat)
    parts = np.array_split(np.arange(n), 1 + n // 100)
    of_P = (np.abs(P_a.matrix.columns(part)[:n] - P_b.matrix.columns(part)[:n]).max() for part in parts)
    return float(max(np.abs(a.x_hat - b.x_hat).max(), *of_P))


def exponent(times: Sequence[StepTime]) -> float:
    """Return p of the power law n^p that the medians of the compressed filter follow best."""
    n, medians = zip(*(
        (step.states, step.compressed.times.median) for step in times if step.compressed))
    return float(np.polyfit(np.log(n), np.log(medians), 1)[0])


def _compressed_time(made: SyntheticDrive, dense: JointState) -> CompressedTime:
    team = _mapped(made, replace(AROUND_ROBOTS, min_states=0))
    seconds, entered = _timed(team, made.happened)
    apart = difference(team.state, dense)
    if apart > EQUAL:
        raise ArithmeticError(
            f'with {len(dense.x_hat)} states the compressed filter is off by {apart}')
    return CompressedTime(Times.of(seconds), entered, apart)


def _update_time(team: Filter, happened: Happened) -> Times:
    """Time the update of the covariance by a step's observations, of which there are few new ones."""
    state, (_, scans) = team.state, happened
    pairs = [
        (state.robots[scan.robot], state.landmarks[team.landmark_key(scan.robot, observation.id)])
        for scan in scans for observation in scan.observations]
    sighted = observation_columns(*zip(*pairs))
    H = SparseRows(
        sighted.columns, models.H(*team.linearization.observation_points(state, sighted)))
    noise, r = np.tile(R, (len(pairs), 1, 1)), np.zeros(2 * len(pairs))
    covariance, seconds = state.whole(), []
    for _ in range(UPDATES):
        begin = perf_counter()
        covariance.condition(covariance.correction(covariance.project(H, noise), r))
        seconds.append(perf_counter() - begin)
    return Times.of(seconds)


def _mapped(made: SyntheticDrive, regions: ActiveSubmap) -> Filter:
    """Return a filter that has seen all landmarks once."""
    team = Filter(JointState(), FirstEstimates(), Gate(1.0), submap=regions)
    for name, pose in made.starts.items():
        team.state.insert_robot(name, 0, pose, P_0)
    team.start_landmarks([made.survey])
    return team


def _timed(team: Filter, happened: Sequence[Happened]) -> tuple[list[float], int]:
    """Return the times of all steps, and in how many a region was entered; leave the last one."""
    seconds, entered, last = [], 0, team.state.covariance
    for motions, scans in happened:
        begin = perf_counter()
        team.step(motions, scans)
        seconds.append(perf_counter() - begin)
        now = team.state.covariance
        entered += isinstance(now, CompressedCovariance) and now is not last
        last = now
    begin = perf_counter()
    team.state.whole()
    seconds[-1] += perf_counter() - begin
    return seconds, entered
