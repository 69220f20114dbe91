# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the filters at several levels of noise, and requirements on the invariant one."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.liu.configurations import TABLE_ENTRIES
from fej_slam_ros.experiments.liu.metrics import SampleMean
from fej_slam_ros.experiments.liu.noise import (
    by_configuration, CaseMeans, DIFFERENCE, Means, NOISE_FILTERS, NoiseCase, RMSE_ENTRIES,
    Samples)
from fej_slam_ros.tables import markdown_table

#: Titles of the rows of a case.
ROW_TITLES = {
    'standard': 'standard', 'fej': 'FEJ', 'ideal': 'ideal', 'invariant': 'invariant',
    DIFFERENCE: 'invariant - FEJ'}
#: Digits after the point, by the end of an entry's name.
DIGITS = {'nees': 2, 'pos': 3, 'head': 4}
#: Values from here on are in exponential notation: the filter has diverged.
DIVERGED = 1e4
#: Columns of a case in files.
CASE_COLUMNS = ('environment', 'landmarks', 'odometry_m', 'odometry_deg', 'sighting_m')
#: Requirements on the invariant filter: means of these entries within this range, and RMSE above
#: FEJ's by at most this number of standard errors of the paired difference.
NEES_ENTRIES = ('r1_nees', 'r2_nees')
CONSISTENT_RANGE = (0.9, 1.35)
MAX_STANDARD_ERRORS = 2.0

NOISE_NOTES = f"""\
A level is the standard deviations of the odometry of one step (in x and y, and of the heading)
and of an observation (in x and y). The filters know them, and all filters estimate from the same
measurements. NEES of a run is the mean over its steps, RMSE the root mean square of its errors
over them; those of the map are over the landmarks at the last step. The exactly known start of R1
is excluded. Values are means over runs ± half the width of the 95 % confidence interval by
Student's t, which is coarse where a few bad runs dominate the mean. **{ROW_TITLES[DIFFERENCE]}**
is the mean difference of RMSE in the same runs, with its standard error in parentheses. (RMSE in
`tables` takes the mean over runs under the root, which gives bad runs more weight.)"""


def markdown(means: Means, about: str) -> str:
    """Return the tables as a page."""
    parts = ['# Filters at several levels of noise', NOISE_NOTES, f'{about} {verdict(means)}']
    for (environment, landmarks), of_cases in by_configuration(means).items():
        parts += [f'## Environment {environment}, {landmarks} landmarks', _table(of_cases)]
    return '\n\n'.join(parts) + '\n'


def verdict(means: Means) -> str:
    """Return a sentence that says how often the invariant filter meets the requirements."""
    low, high = CONSISTENT_RANGE
    nees = [rows['invariant'][entry].value for rows in means.values() for entry in NEES_ENTRIES]
    differences = [rows[DIFFERENCE][entry] for rows in means.values() for entry in RMSE_ENTRIES]
    consistent = sum(low <= value <= high for value in nees)
    no_worse = sum(d.value <= MAX_STANDARD_ERRORS * (d.error or 0.0) for d in differences)
    return (
        f'NEES/3 of the invariant filter is within {low:g} to {high:g} in {consistent} of'
        f" {len(nees)} cases of a robot, and its RMSE is above FEJ's by at most"
        f' {MAX_STANDARD_ERRORS:g} standard errors of the difference in {no_worse} of'
        f' {len(differences)} entries.')


def csv_rows(means: Means) -> Iterator[list[str]]:
    """Yield a head and a row for each entry; intervals of a single run are empty."""
    yield [*CASE_COLUMNS, 'filter', 'entry', 'mean', 'runs', 'standard_error', 'margin_95']
    for case, rows in means.items():
        for name, entries in rows.items():
            for entry, mean in entries.items():
                numbers = asdict(mean).values()
                yield [
                    *map(str, _case(case).values()), name, entry,
                    *('' if number is None else repr(number) for number in numbers)]


def runs_csv_rows(samples: Samples, first: int) -> Iterator[list[str]]:
    """Yield a head and a row for each run and filter, the runs numbered from the first."""
    yield [*CASE_COLUMNS, 'run', 'filter', *TABLE_ENTRIES]
    for case, by_filter in samples.items():
        for name, entries in by_filter.items():
            columns = (values.tolist() for values in entries.values())
            for run, row in enumerate(zip(*columns), first):
                yield [*map(str, _case(case).values()), str(run), name, *map(repr, row)]


def summary(means: Means) -> list[dict[str, Any]]:
    """Return the means of each case for a JSON file."""
    return [
        {**_case(case),
         'filters': {
             name: {entry: asdict(mean) for entry, mean in entries.items()}
             for name, entries in rows.items()}}
        for case, rows in means.items()]


def title(case: NoiseCase) -> str:
    """Return the noise of a case in words."""
    position, heading, observation = case.sigmas
    return f'{position:g} m, {heading:g} deg; {observation:g} m'


def _table(of_cases: Mapping[NoiseCase, CaseMeans]) -> str:
    """Return a row for each filter at each level of noise, and one for the differences."""
    lines = []
    for case, rows in of_cases.items():
        for name, entries in rows.items():
            runs = next(iter(entries.values())).runs
            head = [title(case), str(runs)] if name == NOISE_FILTERS[0] else ['', '']
            # Differences have RMSE only.
            lines.append([*head, ROW_TITLES[name], *(
                _cell(name, entries[entry], entry) if entry in entries else ''
                for entry in TABLE_ENTRIES)])
    return markdown_table(
        ['odometry; observations', 'runs', 'filter', *TABLE_ENTRIES.values()], lines, (0, 2))


def _cell(name: str, mean: SampleMean, entry: str) -> str:
    """Return a mean ± half the width of its interval, or a difference (its standard error)."""
    spread, form = (mean.error, ' ({})') if name == DIFFERENCE else (mean.margin, ' ± {}')
    value = _rounded(mean.value, entry)
    return value if spread is None else value + form.format(_rounded(spread, entry))


def _rounded(value: float, entry: str) -> str:
    if abs(value) >= DIVERGED:
        return f'{value:.1e}'
    return f'{value:.{DIGITS[entry.partition("_")[2]]}f}'


def _case(case: NoiseCase) -> dict[str, float]:
    """Return the columns of a case in files."""
    return dict(zip(CASE_COLUMNS, (*case.configuration, *case.sigmas)))
