# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables 1 and 2 of [Liu] beside the results of this package.

In the authors' worlds an entry is compared with its distribution over 2000 runs of an independent
program; in the worlds of this package the distribution comes from resampling the same runs.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.experiments.liu import metrics
from fej_slam_ros.experiments.liu.configurations import (
    authors_world, Configuration, EntryRange, own_world, published, TABLE_ENTRIES)
from fej_slam_ros.experiments.liu.monte_carlo import Errors, TableRuns
from fej_slam_ros.sim.world import World
from fej_slam_ros.tables import markdown_table

#: Function of a row's key and runs that returns the distribution of each of its entries.
RangesOf = Callable[[str, Errors], Mapping[str, EntryRange]]
#: Variance of the reference, the mean of 2000 runs, relative to sd100^2.
REFERENCE_VARIANCE = 100 / 2000
EKF_TITLES = {'std': 'standard', 'ideal': 'ideal', 'fej': 'FEJ'}
#: Mark of an entry outside of its range of 99.7 %.
OUTSIDE = '!'
IN_AUTHORS_WORLDS = f"""\
The worlds are the authors'; the noise of their runs is not available. 95 %: range of an entry
made of 100 runs, by 2000 runs of an independent program; {OUTSIDE}: outside of the range of
99.7 %."""
IN_OWN_WORLDS = """\
The worlds are this package's, with the steps, lengths, ranges and noise of the paper but other
landmarks and curves: the values of the paper are for orientation only. 95 %: range of an entry
made of 100 runs, by resampling these runs."""


@dataclass(frozen=True)
class TableEntry:
    """An entry of the tables."""

    paper: float  #: The printed value
    ours: float  #: The value over our runs
    runs: int  #: Number of our runs
    expected: EntryRange  #: Distribution of the entry made of 100 runs

    @property
    def is_outside(self) -> bool:
        """Return whether our value, if made of enough runs, is outside of its 99.7 % range."""
        inside = self.expected.lo997 <= self.ours <= self.expected.hi997
        return self.runs >= metrics.RUNS_PER_ENTRY and not inside

    def is_farther(self, deviations: float) -> bool:
        """Return whether our value is farther from the mean than some standard deviations."""
        variance = metrics.RUNS_PER_ENTRY / self.runs + REFERENCE_VARIANCE
        sd = self.expected.sd100 * math.sqrt(variance)
        return abs(self.ours - self.expected.mean) > deviations * sd


@dataclass(frozen=True)
class WorldSource:
    """Source of the worlds."""

    world: Callable[[Configuration], World]  #: World of an experiment
    ranges_of: RangesOf  #: Distributions of the entries in it
    about: Callable[[Mapping[str, TableEntry]], str]  #: Notes for the reader


def authors(folder: Path) -> WorldSource:
    """Return the source of the paper's worlds, from the authors' files in a folder."""
    printed = published()
    return WorldSource(
        lambda configuration: authors_world(folder, configuration),
        lambda row, _: {entry: printed[f'{row}/{entry}'].expected for entry in TABLE_ENTRIES},
        lambda entries: f'{IN_AUTHORS_WORLDS} {verdict(entries)}')


#: The worlds of this package.
OWN_WORLDS = WorldSource(
    own_world,
    lambda row, errors: metrics.ranges(errors, np.random.default_rng(list(row.encode()))),
    lambda _: IN_OWN_WORLDS)


def entries(runs: TableRuns, ranges_of: RangesOf) -> dict[str, TableEntry]:
    """Return the entries by ``environment/landmarks/filter/entry``."""
    table = {}
    printed = published()
    for configuration, by_filter in runs.items():
        for name, errors in by_filter.items():
            row = f'{configuration}/{name}'
            expected = ranges_of(row, errors)
            for entry, ours in metrics.entries(errors).items():
                key = f'{row}/{entry}'
                table[key] = TableEntry(
                    printed[key].paper, ours, len(errors.landmarks), expected[entry])
    return table


def summary(table: Mapping[str, TableEntry]) -> dict[str, dict[str, Any]]:
    """Return the content of ``tables.json``."""
    return {
        key: {
            'paper': entry.paper, 'ours': entry.ours, 'runs': entry.runs, **asdict(entry.expected),
            'outside': entry.is_outside}
        for key, entry in table.items()}


def csv_rows(table: Mapping[str, TableEntry]) -> Iterator[list[str]]:
    """Yield a head and a row for each entry."""
    rows = summary(table)
    yield ['environment', 'landmarks', 'filter', 'entry', *next(iter(rows.values()), {})]
    for key, entry in rows.items():
        yield [*key.split('/'), *map(repr, entry.values())]


def runs_csv_rows(runs: TableRuns, first: int) -> Iterator[list[str]]:
    """Yield a head and a row for each run and filter, the runs numbered from the first."""
    yield ['environment', 'landmarks', 'run', 'filter', *TABLE_ENTRIES]
    for (environment, landmarks), by_filter in runs.items():
        for name, errors in by_filter.items():
            for run, entries in enumerate(metrics.entries_of_each(errors), first):
                yield [
                    str(environment), str(landmarks), str(run), name,
                    *map(repr, entries.values())]


def markdown(table: Mapping[str, TableEntry], about: str) -> str:
    """Return the tables as a page."""
    parts = ['# Tables 1 and 2 of [Liu]', about]
    for environment in dict.fromkeys(key.partition('/')[0] for key in table):
        of_environment = {k: e for k, e in table.items() if k.startswith(f'{environment}/')}
        parts += [f'## Table {environment}: environment {environment}', _table(of_environment)]
    return '\n\n'.join(parts) + '\n'


def verdict(table: Mapping[str, TableEntry]) -> str:
    """Return a sentence that counts the entries that chance alone does not explain."""
    enough = [entry for entry in table.values() if entry.runs >= metrics.RUNS_PER_ENTRY]
    outside = sum(entry.is_outside for entry in enough)
    far = [sum(entry.is_farther(limit) for entry in table.values()) for limit in (3.0, 5.0)]
    return (
        f'Outside of the 99.7 % range: {outside} of the {len(enough)} entries made of'
        f' {metrics.RUNS_PER_ENTRY} runs or more. Farther than 3 standard deviations from the mean'
        f' of the independent runs: {far[0]} of all {len(table)}, farther than 5: {far[1]}.')


def _table(table: Mapping[str, TableEntry]) -> str:
    """Return three lines for each row: paper, ours and the 95 % range."""
    lines = []
    for row in dict.fromkeys(key.rpartition('/')[0] for key in table):
        _, landmarks, name = row.split('/')
        of_row = [table[f'{row}/{entry}'] for entry in TABLE_ENTRIES]
        lines += [
            [landmarks, EKF_TITLES[name], 'paper', *(f'{e.paper:.4f}' for e in of_row)],
            ['', '', f'ours, {of_row[0].runs} runs', *(
                f'**{e.ours:.4f}**{OUTSIDE if e.is_outside else ""}' for e in of_row)],
            ['', '', '95 %', *map(_range, of_row)]]
    return markdown_table(['landmarks', 'EKF', '', *TABLE_ENTRIES.values()], lines, (1, 2))


def _range(entry: TableEntry) -> str:
    expected = entry.expected
    # A single run of our own has no distribution.
    return f'{expected.lo95:.4g} to {expected.hi95:.4g}' if expected.sd100 else '-'
