# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables 1 and 2 of [Liu] beside our own runs.

In the authors' worlds an entry is held against the range of such entries over 2000 runs of an
independent program; in our own worlds the range comes from the very runs, by resampling them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.experiments.common.markdown import table
from fej_slam_ros.experiments.liu import metrics
from fej_slam_ros.experiments.liu.configurations import (
    authors_world, Configuration, ENTRIES, own_world, published, PublishedRange)
from fej_slam_ros.experiments.liu.monte_carlo import Errors
from fej_slam_ros.experiments.liu.simulated_runs import Runs
from fej_slam_ros.sim.world import World

#: Given a row's key and its runs, what chance does to its entries.
Chance = Callable[[str, Errors], Mapping[str, PublishedRange]]

#: The mean of 2000 runs, which an entry is compared with, is uncertain by this part of sd100^2.
REFERENCE_VARIANCE = 100 / 2000

TITLES = (
    'R1 NEES/3', 'R1 pos [m]', 'R1 head [rad]', 'R2 NEES/3', 'R2 pos [m]', 'R2 head [rad]',
    'map NEES/2', 'map pos [m]')
NAMES = {'std': 'standard', 'ideal': 'ideal', 'fej': 'FEJ'}
OUTSIDE = '!'

IN_AUTHORS_WORLDS = f"""\
The worlds are the authors'; the noise of their runs is lost. 95 %: where an entry made of 100
runs lies, by 2000 runs of an independent program; {OUTSIDE}: outside of the range of 99.7 %."""
IN_OWN_WORLDS = """\
The worlds are this package's, with the steps, lengths, ranges and noise of the paper's but with
other landmarks and curves: the values of the paper stand here for orientation. 95 %: where an
entry made of 100 runs lies, by resampling these runs."""


@dataclass(frozen=True)
class Entry:
    """
    An entry of the tables.

    Attributes
    ----------
    paper : the printed value
    ours : the value over our runs
    runs : how many they are
    chance : what an entry made of 100 runs may be

    """

    paper: float
    ours: float
    runs: int
    chance: PublishedRange

    @property
    def is_outside(self) -> bool:
        """Return whether our value, if made of enough runs, is outside of its 99.7 % range."""
        inside = self.chance.lo997 <= self.ours <= self.chance.hi997
        return self.runs >= metrics.RUNS and not inside

    def is_farther(self, deviations: float) -> bool:
        """Return whether more standard deviations lie between our value and the mean."""
        sd = self.chance.sd100 * math.sqrt(metrics.RUNS / self.runs + REFERENCE_VARIANCE)
        return abs(self.ours - self.chance.mean) > deviations * sd


@dataclass(frozen=True)
class Source:
    """
    Where the worlds come from.

    Attributes
    ----------
    world : gives the world of an experiment
    chance : what chance does to an entry in it
    about : tells, given the entries, what a reader must know of them

    """

    world: Callable[[Configuration], World]
    chance: Chance
    about: Callable[[Mapping[str, Entry]], str]


def authors(folder: Path) -> Source:
    """Return the source that has the worlds of the paper, from the authors' files in a folder."""
    printed = published()

    def chance(row: str, _: Errors) -> dict[str, PublishedRange]:
        return {entry: printed[f'{row}/{entry}'].chance for entry in ENTRIES}

    return Source(
        lambda configuration: authors_world(folder, configuration), chance,
        lambda made: f'{IN_AUTHORS_WORLDS} {verdict(made)}')


def _resampled(row: str, errors: Errors) -> dict[str, PublishedRange]:
    return metrics.ranges(errors, np.random.default_rng(list(row.encode())))


#: The worlds that this package makes.
OWN = Source(
    own_world, _resampled,
    lambda _: IN_OWN_WORLDS)


def entries(runs: Runs, chance: Chance) -> dict[str, Entry]:
    """Return the entries by ``environment/landmarks/filter/entry``."""
    made = {}
    printed = published()
    for configuration, by_filter in runs.items():
        for name, errors in by_filter.items():
            row = f'{configuration}/{name}'
            ranges = chance(row, errors)
            for entry, ours in metrics.entries(errors).items():
                key = f'{row}/{entry}'
                made[key] = Entry(printed[key].paper, ours, len(errors.landmarks), ranges[entry])
    return made


def as_json(made: Mapping[str, Entry]) -> dict[str, dict[str, Any]]:
    """Return what goes into ``tables.json``."""
    return {
        key: {
            'paper': entry.paper, 'ours': entry.ours, 'runs': entry.runs, **asdict(entry.chance),
            'outside': entry.is_outside}
        for key, entry in made.items()}


def csv_rows(made: Mapping[str, Entry]) -> Iterator[list[str]]:
    """Yield a head and a row for each entry."""
    for number, (key, entry) in enumerate(as_json(made).items()):
        if number == 0:
            yield ['environment', 'landmarks', 'filter', 'entry', *entry]
        yield [*key.split('/'), *map(repr, entry.values())]


def runs_csv_rows(runs: Runs, first: int) -> Iterator[list[str]]:
    """Yield a head and a row for each run and filter, the runs numbered from the first."""
    yield ['environment', 'landmarks', 'run', 'filter', *ENTRIES]
    for (environment, landmarks), by_filter in runs.items():
        for name, errors in by_filter.items():
            columns = metrics.entries_of_each(errors).values()
            for number, row in enumerate(zip(*(column.tolist() for column in columns)), first):
                yield [str(environment), str(landmarks), str(number), name, *map(repr, row)]


def markdown(made: Mapping[str, Entry], about: str) -> str:
    """Return the tables as a page."""
    parts = ['# Tables 1 and 2 of [Liu]', about]
    for environment in dict.fromkeys(key.partition('/')[0] for key in made):
        of_environment = {k: e for k, e in made.items() if k.startswith(f'{environment}/')}
        parts += [f'## Table {environment}: environment {environment}', _table(of_environment)]
    return '\n\n'.join(parts) + '\n'


def verdict(made: Mapping[str, Entry]) -> str:
    """Return in a sentence how many entries are where chance alone hardly puts them."""
    enough = [entry for entry in made.values() if entry.runs >= metrics.RUNS]
    outside = sum(entry.is_outside for entry in enough)
    far = [sum(entry.is_farther(limit) for entry in made.values()) for limit in (3.0, 5.0)]
    return (
        f'Outside of the 99.7 % range: {outside} of the {len(enough)} entries that are made of'
        f' {metrics.RUNS} runs or more. Farther than 3 standard deviations from the mean of the'
        f' independent runs: {far[0]} of all {len(made)}, farther than 5: {far[1]}.')


def _table(made: Mapping[str, Entry]) -> str:
    """Return three lines for each row: paper, ours and the 95 % range."""
    lines = []
    for row in dict.fromkeys(key.rpartition('/')[0] for key in made):
        _, landmarks, name = row.split('/')
        of_row = [made[f'{row}/{entry}'] for entry in ENTRIES]
        lines += [
            [landmarks, NAMES[name], 'paper', *(f'{e.paper:.4f}' for e in of_row)],
            ['', '', f'ours, {of_row[0].runs} runs', *map(_ours, of_row)],
            ['', '', '95 %', *map(_range, of_row)]]
    return table(['landmarks', 'EKF', '', *TITLES], lines, words=(1, 2))


def _ours(entry: Entry) -> str:
    return f'**{entry.ours:.4f}**{OUTSIDE if entry.is_outside else ""}'


def _range(entry: Entry) -> str:
    chance = entry.chance
    # One run of our own tells nothing of chance.
    return f'{chance.lo95:.4g} to {chance.hi95:.4g}' if chance.sd100 else '-'
