# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lemma 1 of [Liu], measured: what each filter believes that it can know along a run with noise.

Every robot moves and sees every landmark at every step, and in some cases every other robot, so
only what no observation can ever tell stays unknown: where the whole team and its map are, and how
they are turned.
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
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.environments import ENVIRONMENTS

#: How many rigid motions of everything stay unknown to a filter by Lemma 1: the shifts along x and
#: y, and but for the standard filter the turn.
UNKNOWN_MOTIONS = {'standard': 2, 'ideal': 3, 'fej': 3, 'invariant': 3}

HEADINGS = (
    'robots N', 'landmarks n', 'robots seen', 'filter', 'unknowns', 'rank of M', 'Lemma 1',
    'null space', 'sine')

MEANING = """\
M maps the joint error after step 0 to the innovations of m + 1 steps with noise, m = 1 to {steps};
its rank is the number of singular values above 1e-8 of the largest, and the sine is that of the
largest angle between its null space and the rigid motions of the whole team with its map that
Lemma 1 leaves unknown. No observation tells how everything is shifted or turned, nor does one of
another robot, and to the ideal filter, to FEJ and to the invariant filter all three stay unknown.
The standard filter linearises about estimates that its own updates move, and so gains a direction
that it cannot know: the heading of the whole team.
"""


class ObservabilityCase(NamedTuple):
    """N robots and n landmarks, and whether the robots see each other, too."""

    robots: int
    landmarks: int
    robots_seen: bool = False


@dataclass(frozen=True, slots=True)
class Window:
    """
    M over the steps from k to k + m.

    Attributes
    ----------
    m : how many steps follow the first
    rank : how many singular values count
    null_space : how many directions of the joint error are left
    sine : of the largest angle between these and the rigid motions of Lemma 1
    singular_values : relative to the largest

    """

    m: int
    rank: int
    null_space: int
    sine: float
    singular_values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Observability:
    """
    What one filter can know along one run.

    Attributes
    ----------
    filter : its name
    robots, landmarks, robots_seen : the case
    unknowns : size of the joint state, 3N + 2n
    lemma_1 : the rank of M by Lemma 1, whatever m is
    windows : for m = 1, 2, ...

    """

    filter: str
    robots: int
    landmarks: int
    robots_seen: bool
    unknowns: int
    lemma_1: int
    windows: tuple[Window, ...]


def reproduce(cases: Sequence[ObservabilityCase], steps: int, seed: int) -> list[Observability]:
    """Return what each filter can know in each case, given the same measurements."""
    return [observe(name, case, steps, seed) for case in cases for name in UNKNOWN_MOTIONS]


def observe(filter_name: str, case: ObservabilityCase, steps: int, seed: int) -> Observability:
    """
    Return what a filter can know along a run in the first environment of [Liu].

    Parameters
    ----------
    filter_name : one of `UNKNOWN_MOTIONS`
    case : at least 1 robot and 2 landmarks
    steps : the largest m, at least 1
    seed : of the world and of the noise

    Raises
    ------
    UsageError
        If there are too few robots, landmarks or steps.

    """
    estimator = _estimator(filter_name, case, steps, seed)
    results = estimator.release()
    next(results)  # Step 0 starts all robots and landmarks.
    team = estimator.groups.team.filter
    motions = linearized_rigid_motions(team)[:, :UNKNOWN_MOTIONS[filter_name]]
    n, free = motions.shape
    recorder = record_observability(team)
    for _ in islice(results, steps + 1):
        pass
    windows = tuple(_window(m, recorder.rows, motions) for m in range(1, steps + 1))
    return Observability(filter_name, *case, n, n - free, windows)


def markdown(results: Sequence[Observability]) -> str:
    """Return a page: a row for each case and filter, and what it means."""
    rows = [HEADINGS, ('---:', '---:', ':---', ':---', *['---:'] * 5), *map(_cells, results)]
    table = '\n'.join(f'| {" | ".join(row)} |' for row in rows)
    meaning = MEANING.format(steps=results[0].windows[-1].m)
    return f'# Observability, Lemma 1 of [Liu]\n\n{table}\n\n{meaning}'


def csv_rows(results: Sequence[Observability]) -> list[list[Any]]:
    """Return the headings, and a row for each case, filter and m."""
    headings = [
        'robots', 'landmarks', 'robots_seen', 'filter', 'unknowns', 'm', 'rank', 'lemma_1',
        'null_space', 'sine']
    return [headings, *(
        [r.robots, r.landmarks, int(r.robots_seen), r.filter, r.unknowns, w.m, w.rank, r.lemma_1,
         w.null_space, w.sine]
        for r in results for w in r.windows)]


def summary(results: Sequence[Observability]) -> list[dict[str, Any]]:
    """Return everything in a form that JSON knows."""
    return [asdict(result) for result in results]


def _estimator(filter_name: str, case: ObservabilityCase, steps: int, seed: int) -> Estimator:
    """Return an estimator that was given all measurements and has taken no step yet."""
    for what, count in ('robots', case.robots), ('steps', steps):
        if count < 1:
            raise UsageError(f'{what}: {count} are too few to observe anything, use 1 or more')
    team = tuple(RobotSettings(f'r{i}', i) for i in range(1, case.robots + 1))
    estimator = Estimator(Settings(
        team, anchor=team[0].name, filter=filter_name, gate_probability=1.0))
    for record in _records(tuple(robot.name for robot in team), case, steps, seed):
        estimator.add(record)
    return estimator


def _records(robots: tuple[str, ...], case: ObservabilityCase, steps: int, seed: int) -> Iterator[Record]:
    """Yield step 0 and the m + 1 steps of the largest M, and the rest of their last loop."""
    circles = ENVIRONMENTS['circles']
    loops = math.ceil((steps + 1) / circles.world.steps_per_loop)
    seeing_all = replace(
        circles,
        world=replace(circles.world, robots=robots, landmarks=case.landmarks, loops=loops),
        sensors=replace(
            circles.sensors, range=math.inf,
            robot_sigma=circles.sensors.landmark_sigma if case.robots_seen else None))
    return seeing_all.records(np.random.default_rng(seed))


def _window(m: int, rows: Sequence[Array], motions: Array) -> Window:
    M = np.vstack(rows[:m + 1])
    unknown = null_space(M)
    values = tuple(singular_values(M).tolist())
    return Window(m, rank(M), unknown.shape[1], largest_sine(unknown, motions), values)


def _cells(result: Observability) -> tuple[str, ...]:
    windows = result.windows
    return (
        str(result.robots), str(result.landmarks), 'yes' if result.robots_seen else 'no',
        result.filter, str(result.unknowns),
        _in_brief([w.rank for w in windows]), str(result.lemma_1),
        _in_brief([w.null_space for w in windows]), f'{max(w.sine for w in windows):.0e}')


def _in_brief(values: Sequence[int]) -> str:
    """Return the value that all m have, or each with its m."""
    if len(set(values)) == 1:
        return str(values[0])
    return ', '.join(f'{value} (m = {m})' for m, value in enumerate(values, start=1))
