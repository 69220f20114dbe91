# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The filters over levels of noise in tables; what is asked of the invariant one."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.common.markdown import table
from fej_slam_ros.experiments.liu.configurations import ENTRIES
from fej_slam_ros.experiments.liu.metrics import Mean
from fej_slam_ros.experiments.liu.noise import Case, DIFFERENCE, FILTERS, Means, RMSE, Samples
from fej_slam_ros.experiments.liu.tables import TITLES

#: What the rows of a case are called.
NAMES = {
    'standard': 'standard', 'fej': 'FEJ', 'ideal': 'ideal', 'invariant': 'invariant',
    DIFFERENCE: 'invariant - FEJ'}
#: Digits after the point, by the end of an entry's name.
DIGITS = {'nees': 2, 'pos': 3, 'head': 4}
#: From here on a number is told by its size: a filter has diverged.
MANY = 1e4
#: What tells a case, in files.
CASE = ('environment', 'landmarks', 'odometry_m', 'odometry_deg', 'sighting_m')

#: Of the invariant filter is asked that the mean of these is in this range, and that its RMSE is
#: above FEJ's by no more than so many standard errors of the paired difference.
ROBOTS_NEES = ('r1_nees', 'r2_nees')
CONSISTENT = (0.9, 1.35)
ERRORS = 2.0

MEANING = f"""\
A level is the standard deviations of the odometry of one step (on x and y, and of the heading)
and those of an observation (on x and y); the filters know them, and all estimate from the same
measurements. NEES of a run is its mean over the steps, RMSE the root mean square of its errors
over them; those of the map are over the landmarks at the last step. The exactly known start of R1
is left out. Told is the mean over runs, ± half the width of its 95 % confidence interval by
Student's t, which is rough where a few bad runs make most of the mean. **{NAMES[DIFFERENCE]}**
is the mean of the differences of RMSE in the same runs, its standard error in parentheses. (RMSE
in `tables` has the mean over runs under the root, where bad runs count more.)"""


def markdown(means: Means, about: str) -> str:
    """Return the tables as a page."""
    parts = ['# The filters over levels of noise', MEANING, f'{about} {verdict(means)}']
    for environment, landmarks in dict.fromkeys(case.configuration for case in means):
        of_it = {
            case: rows for case, rows in means.items()
            if case.configuration == (environment, landmarks)}
        parts += [f'## Environment {environment}, {landmarks} landmarks', _table(of_it)]
    return '\n\n'.join(parts) + '\n'


def verdict(means: Means) -> str:
    """Return in words how often the invariant filter is what is asked."""
    low, high = CONSISTENT
    nees = [rows['invariant'][entry].value for rows in means.values() for entry in ROBOTS_NEES]
    differences = [rows[DIFFERENCE][entry] for rows in means.values() for entry in RMSE]
    consistent = sum(low <= value <= high for value in nees)
    no_worse = sum(d.value <= ERRORS * (d.error or 0.0) for d in differences)
    return (
        f'Of the invariant filter, NEES/3 is within {low:g} to {high:g} in {consistent} of'
        f" {len(nees)} cases of a robot, and RMSE is above FEJ's by no more than {ERRORS:g}"
        f' standard errors of the difference in {no_worse} of {len(differences)} entries.')


def csv_rows(means: Means) -> Iterator[list[str]]:
    """Yield a head and a row for each entry; what a single run cannot tell is empty."""
    yield [*CASE, 'filter', 'entry', 'mean', 'runs', 'standard_error', 'margin_95']
    for case, rows in means.items():
        for name, entries in rows.items():
            for entry, mean in entries.items():
                numbers = asdict(mean).values()
                yield [
                    *_named(case), name, entry,
                    *('' if number is None else repr(number) for number in numbers)]


def runs_csv_rows(samples: Samples, first: int) -> Iterator[list[str]]:
    """Yield a head and a row for each run and filter, the runs numbered from the first."""
    yield [*CASE, 'run', 'filter', *ENTRIES]
    for case, by_filter in samples.items():
        for name, entries in by_filter.items():
            columns = (values.tolist() for values in entries.values())
            for number, row in enumerate(zip(*columns), first):
                yield [*_named(case), str(number), name, *map(repr, row)]


def as_json(means: Means) -> list[dict[str, Any]]:
    """Return the means of each case in a form that JSON knows."""
    return [
        {**_told(case),
         'filters': {
             name: {entry: asdict(mean) for entry, mean in entries.items()}
             for name, entries in rows.items()}}
        for case, rows in means.items()]


def title(case: Case) -> str:
    """Return the noise of a case in words."""
    position, heading, observation = case.sigmas
    return f'{position:g} m, {heading:g} deg; {observation:g} m'


def _table(of_cases: Mapping[Case, Mapping[str, Mapping[str, Mean]]]) -> str:
    """Return a row for each filter at each level of noise, and one for the differences."""
    lines = []
    for case, rows in of_cases.items():
        for name, entries in rows.items():
            runs = next(iter(entries.values())).runs
            head = [title(case), str(runs)] if name == FILTERS[0] else ['', '']
            told = _difference if name == DIFFERENCE else _value
            # Differences are told of RMSE only.
            cells = (told(entries[entry], entry) if entry in entries else '' for entry in ENTRIES)
            lines.append([*head, NAMES[name], *cells])
    return table(['odometry; observations', 'runs', 'filter', *TITLES], lines, words=(0, 2))


def _value(mean: Mean, entry: str) -> str:
    """Return a mean with half the width of its interval, where there is one."""
    margin = '' if mean.margin is None else f' ± {_rounded(mean.margin, entry)}'
    return _rounded(mean.value, entry) + margin


def _difference(mean: Mean, entry: str) -> str:
    """Return a mean with its standard error, where there is one."""
    error = '' if mean.error is None else f' ({_rounded(mean.error, entry)})'
    return _rounded(mean.value, entry) + error


def _rounded(value: float, entry: str) -> str:
    if abs(value) >= MANY:
        return f'{value:.1e}'
    return f'{value:.{DIGITS[entry.partition("_")[2]]}f}'


def _told(case: Case) -> dict[str, float]:
    """Return what tells a case in files."""
    return dict(zip(CASE, (*case.configuration, *case.sigmas)))


def _named(case: Case) -> list[str]:
    return [str(value) for value in _told(case).values()]
