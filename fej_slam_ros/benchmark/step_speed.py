# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of a filter step by the size of the map, dense and compressed.

Two robots at 1 m/s and 10 Hz with a map that is known from the start. Both filters make the same
steps and must end with the same estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.synthetic_drive import (
    drive, DRIVE_ROBOTS, fej_filter, Measurements, START_P, SyntheticDrive)
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.covariance import SparseRows
from fej_slam_ros.core.ekf.filter import Filter, stacked
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.state import JointState

#: Numbers of states and observations.
SIZES = (50, 2), (50, 10), (200, 10), (500, 10), (1000, 10), (2000, 10), (5000, 10)
#: Number of states from which the compressed filter is timed, too.
COMPRESSED_FROM = 500
TIMED_STEPS = 2000
#: Motion of a robot in a step [m].
STEP_LENGTH = 0.1
#: Repetitions of the update with the last step's observations.
UPDATES = 200
#: Maximum difference of the dense and the compressed estimate.
MAX_DIFFERENCE = 1e-10


@dataclass(frozen=True)
class CompressedTime:
    """Step times of the compressed filter, and its difference from the dense one."""

    times: Times  #: Of its steps, with the changes of the submap and the final expansion
    regions: int  #: Number of submaps that it entered
    difference: float  #: Largest difference at the end in any element of x and P


@dataclass(frozen=True)
class StepTime:
    """Times for a number of states and observations; small states are timed dense only."""

    states: int
    observations: int
    steps: int
    update: Times  #: Of the covariance update alone
    dense: Times  #: Of whole steps
    compressed: CompressedTime | None


def step_time(states: int, observations: int, steps: int) -> StepTime:
    """
    Time steps in which each of two robots moves and makes half of the observations.

    If the compressed filter differs from the dense one, raise an `ArithmeticError`.
    """
    rng = np.random.default_rng(states)
    landmarks = (states - 3 * len(DRIVE_ROBOTS)) // 2
    measured = drive(landmarks, steps, STEP_LENGTH, observations // len(DRIVE_ROBOTS), rng)
    dense = _mapped(measured, WHOLE_MAP)
    seconds, _ = _timed(dense, measured.steps)
    compressed = None
    if states >= COMPRESSED_FROM:
        compressed = _compressed_time(measured, dense.state)
    update = _update_time(dense, measured.steps[-1])
    return StepTime(states, observations, steps, update, Times.of(seconds), compressed)


def difference(a: JointState, b: JointState) -> float:
    """Return the largest difference of two states in any element of x_hat and P."""
    P_a, P_b, n = a.whole().matrix, b.whole().matrix, len(b.x_hat)
    parts = np.array_split(np.arange(n), 1 + n // 100)
    of_P = (np.abs(P_a.columns(part)[:n] - P_b.columns(part)[:n]).max() for part in parts)
    return float(max(np.abs(a.x_hat - b.x_hat).max(), *of_P))


def exponent(times: Sequence[StepTime]) -> float:
    """Return p of the power law n^p fitted to the medians of the compressed filter."""
    return power(*zip(*(
        (step.states, step.compressed.times.median) for step in times if step.compressed)))


def power(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Return p of the power law n^p fitted to times (k,) of sizes n (k,), k >= 2."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def _compressed_time(measured: SyntheticDrive, dense: JointState) -> CompressedTime:
    team = _mapped(measured, replace(AROUND_ROBOTS, min_states=0))
    seconds, entered = _timed(team, measured.steps)
    largest = difference(team.state, dense)
    if largest > MAX_DIFFERENCE:
        raise ArithmeticError(
            f'with {len(dense.x_hat)} states the compressed filter is off by {largest}')
    return CompressedTime(Times.of(seconds), entered, largest)


def _update_time(team: Filter, measurements: Measurements) -> Times:
    """Time the covariance update by the observations of a step."""
    state, (_, scans) = team.state, measurements
    columns, _, noise = stacked(team.start_landmarks(scans))
    H = SparseRows(columns, KERNEL.H(team.linearization.observation_points(state, columns)))
    r = np.zeros(2 * len(noise))
    covariance, seconds = state.whole(), []
    for _ in range(UPDATES):
        begin = perf_counter()
        covariance.condition(covariance.correction(covariance.project(H, noise), r))
        seconds.append(perf_counter() - begin)
    return Times.of(seconds)


def _mapped(measured: SyntheticDrive, submap: ActiveSubmap) -> Filter:
    """Return a filter that has observed all landmarks once."""
    team = fej_filter(measured.starts, START_P, submap)
    team.start_landmarks([measured.survey])
    return team


def _timed(team: Filter, steps: Sequence[Measurements]) -> tuple[list[float], int]:
    """Return the times of all steps and the number of submaps entered; expand the last one."""
    seconds, entered, last = [], 0, team.state.covariance
    for motions, scans in steps:
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
