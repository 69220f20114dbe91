# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lemma 1 of [Liu], measured: the directions that each filter holds for observable in a noisy run.

Every robot moves and observes every landmark at every step, in some cases every other robot, too.
Only the position and the heading of the whole team with its map are unobservable then.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
import math
from typing import Any, NamedTuple

import numpy as np

from fej_slam_ros.core.ekf.observability import (
    largest_sine, linearized_rigid_motions, null_space, rank, record_observability,
    singular_values)
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import numbered_robots, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.tables import markdown_table

#: Number of rigid motions that are unobservable to a filter by Lemma 1: translation in x and y,
#: and except for the standard filter the rotation.
UNOBSERVABLE_MOTIONS = {'standard': 2, 'ideal': 3, 'fej': 3, 'invariant': 3}
OBSERVABILITY_TITLES = (
    'robots N', 'landmarks n', 'robots seen', 'filter', 'unknowns', 'rank of M', 'Lemma 1',
    'null space', 'sine')

OBSERVABILITY_COLUMNS = [
    'robots', 'landmarks', 'robots_seen', 'filter', 'unknowns', 'm', 'rank', 'lemma_1',
    'null_space', 'sine']
OBSERVABILITY_NOTES = """\
M maps the joint error after step 0 to the innovations of m + 1 noisy steps, m = 1 to {steps}. Its
rank is the number of singular values above 1e-8 of the largest. The sine is that of the largest
angle between its null space and the rigid motions of the whole team with its map that are
unobservable by Lemma 1. No observation, of a landmark or of a robot, depends on where the whole
team is or on its heading: for the ideal filter, FEJ and the invariant filter all three directions
stay unobservable. The standard filter linearises about estimates that its own updates move, and
so gains spurious information on the heading of the whole team.
"""


class ObservabilityCase(NamedTuple):
    """N robots and n landmarks, and whether the robots observe each other, too."""

    robots: int
    landmarks: int
    robots_seen: bool = False


@dataclass(frozen=True, slots=True)
class ObservabilityWindow:
    """M over the steps from k to k + m."""

    m: int  #: Number of steps after the first
    rank: int  #: Number of nonzero singular values
    null_space: int  #: Dimension of the null space
    sine: float  #: Of the largest angle between it and the rigid motions of Lemma 1
    singular_values: tuple[float, ...]  #: Relative to the largest


@dataclass(frozen=True, slots=True)
class Observability:
    """Observability of one filter along one run."""

    filter: str  #: Name
    #: The case.
    robots: int
    landmarks: int
    robots_seen: bool
    unknowns: int  #: Size of the joint state, 3N + 2n
    lemma_1: int  #: The rank of M by Lemma 1 for any m
    windows: tuple[ObservabilityWindow, ...]  #: For m = 1, 2, ...


def reproduce(cases: Sequence[ObservabilityCase], steps: int, seed: int) -> list[Observability]:
    """Return the observability of each filter in each case, from the same measurements."""
    return [measure(name, case, steps, seed) for case in cases for name in UNOBSERVABLE_MOTIONS]


def measure(filter_name: str, case: ObservabilityCase, steps: int, seed: int) -> Observability:
    """
    Return the observability of a filter along a run in the first environment of [Liu].

    `steps` is the largest m, at least 1. A case needs at least 1 robot and 2 landmarks; if it has
    fewer, a `UsageError` is raised.
    """
    estimator = _estimator(filter_name, case, steps, seed)
    results = estimator.release()
    next(results)  # Step 0 starts all robots and landmarks.
    team = estimator.groups.team.filter
    motions = linearized_rigid_motions(team)[:, :UNOBSERVABLE_MOTIONS[filter_name]]
    n, unobservable = motions.shape
    recorder = record_observability(team)
    for _ in islice(results, steps + 1):
        pass
    windows = tuple(_window(m, recorder.rows, motions) for m in range(1, steps + 1))
    return Observability(filter_name, *case, n, n - unobservable, windows)


def markdown(results: Sequence[Observability]) -> str:
    """Return a page with a row for each case and filter."""
    table = markdown_table(OBSERVABILITY_TITLES, map(_cells, results), (2, 3))
    notes = OBSERVABILITY_NOTES.format(steps=results[0].windows[-1].m)
    return f'# Observability, Lemma 1 of [Liu]\n\n{table}\n\n{notes}'


def csv_rows(results: Sequence[Observability]) -> list[list[Any]]:
    """Return a head, and a row for each case, filter and m."""
    return [OBSERVABILITY_COLUMNS, *(
        [r.robots, r.landmarks, int(r.robots_seen), r.filter, r.unknowns, w.m, w.rank, r.lemma_1,
         w.null_space, w.sine]
        for r in results for w in r.windows)]


def summary(results: Sequence[Observability]) -> list[dict[str, Any]]:
    """Return the results for a JSON file."""
    return [asdict(result) for result in results]


def _estimator(filter_name: str, case: ObservabilityCase, steps: int, seed: int) -> Estimator:
    """Return an estimator that has all measurements and has made no step yet."""
    for what, count in ('robots', case.robots), ('steps', steps):
        if count < 1:
            raise UsageError(f'{what}: {count} are too few to observe anything, use 1 or more')
    team = numbered_robots(f'r{i}' for i in range(1, case.robots + 1))
    estimator = Estimator(Settings(
        team, anchor=team[0].name, filter=filter_name, gate_probability=1.0))
    for record in _records(tuple(robot.name for robot in team), case, steps, seed):
        estimator.add(record)
    return estimator


def _records(
    robots: tuple[str, ...], case: ObservabilityCase, steps: int, seed: int
) -> Iterator[Record]:
    """Yield step 0 and the m + 1 steps of the largest M, to the end of their last loop."""
    circles = ENVIRONMENTS['circles']
    loops = math.ceil((steps + 1) / circles.world.steps_per_loop)
    all_in_view = replace(
        circles,
        world=replace(circles.world, robots=robots, landmarks=case.landmarks, loops=loops),
        sensors=replace(
            circles.sensors, range=math.inf,
            robot_sigma=circles.sensors.landmark_sigma if case.robots_seen else None))
    return all_in_view.records(np.random.default_rng(seed))


def _window(m: int, rows: Sequence[Array], motions: Array) -> ObservabilityWindow:
    M = np.vstack(rows[:m + 1])
    unobservable = null_space(M)
    return ObservabilityWindow(
        m, rank(M), unobservable.shape[1], largest_sine(unobservable, motions),
        tuple(singular_values(M).tolist()))


def _cells(result: Observability) -> tuple[str, ...]:
    windows = result.windows
    return (
        str(result.robots), str(result.landmarks), 'yes' if result.robots_seen else 'no',
        result.filter, str(result.unknowns),
        _values_by_m([w.rank for w in windows]), str(result.lemma_1),
        _values_by_m([w.null_space for w in windows]), f'{max(w.sine for w in windows):.0e}')


def _values_by_m(values: Sequence[int]) -> str:
    """Return the common value of all m, or each value with its m."""
    if len(set(values)) == 1:
        return str(values[0])
    return ', '.join(f'{value} (m = {m})' for m, value in enumerate(values, start=1))
