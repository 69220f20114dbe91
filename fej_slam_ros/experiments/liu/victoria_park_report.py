# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the Victoria Park experiment, comparisons of the filters, and the paper's results."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.liu.victoria_park import (
    CAUSAL_STRIDE, MaxDifference, OBSERVATION_SIGMAS, PARK_FILTERS, REFERENCES, Rmse, VictoriaPark)
from fej_slam_ros.tables import markdown_table

#: The entries with their titles, units and digits.
PARK_ENTRIES = {
    'r1_pos': ('R1 pos', 'm', 3), 'r1_head': ('R1 head', 'rad', 4),
    'r2_pos': ('R2 pos', 'm', 3), 'r2_head': ('R2 head', 'rad', 4), 'f_pos': ('map pos', 'm', 3)}
#: RMSE against X_GNI [m] of the better of the two filters of [Liu].
PAPER_RMSE = {'r1_pos': 0.217, 'r2_pos': 1.25, 'f_pos': 0.40}

PARK_NOTES = """\
One car's log stands for two robots. There is no ground truth; least squares over all measurements
stands for it: over both robots with the noise that the filters assume, and over the whole log
without weights, as in the paper. A filter's poses are those right after each step, its map is the
final one; RMSE is the root mean square over all steps, or all landmarks. The ideal filter is
linearised at the two-robot batch, which is its reference and no ground truth. Causal least squares
uses the measurements up to a step only, which is all that a filter can know at that step; it is
computed at every 50th step.
"""


def markdown(result: VictoriaPark) -> str:
    """Return the tables and notes as a page."""
    titles = [f'{title} [{unit}]' for title, unit, _ in PARK_ENTRIES.values()]
    names = PARK_FILTERS | REFERENCES
    rows = [
        [REFERENCES[reference], names[name], str(sigma),
         *(_rounded(entries, entry) for entry in PARK_ENTRIES)]
        for reference, name, sigma, entries in _rows(result)]
    two, one = result.two_robots, result.one_robot
    batches = [
        [*words, str(batch.unknowns), str(batch.iterations)] for batch, words in (
            (two, ('two robots', 'as the filters', f'{two.cost:.3f}')),
            (one, ('one robot', 'none', f'{one.cost:.10f}')))]
    return '\n'.join([
        '# Victoria Park, two robots\n', PARK_NOTES,
        markdown_table(
            ['RMSE against', 'filter', 'observation sigma [m]', *titles], rows, (0, 1)), '',
        _verdict(result.rmse[OBSERVATION_SIGMAS[0]]), _beside_the_paper(result),
        markdown_table(
            ['least squares', 'weights', 'cost', 'unknowns', 'iterations'], batches, (0, 1)), '',
        _beside_the_file(result.x_gni)])


def csv_rows(result: VictoriaPark) -> list[list[str]]:
    """Return a head and a row for each reference and filter."""
    return [['reference', 'filter', 'sighting_sigma', *PARK_ENTRIES], *(
        [reference, name, str(sigma), *(repr(entries[entry]) for entry in PARK_ENTRIES)]
        for reference, name, sigma, entries in _rows(result))]


def summary(result: VictoriaPark) -> dict[str, Any]:
    """Return all results but poses and landmarks for a JSON file."""
    return {
        'rmse': result.rmse,
        'bounds': result.bounds,
        'batch': {
            name: {'cost': batch.cost, 'unknowns': batch.unknowns, 'iterations': batch.iterations}
            for name, batch in result.batches().items()},
        'x_gni_difference': None if result.x_gni is None else asdict(result.x_gni)}


def pose_rows(result: VictoriaPark) -> Iterator[list[str]]:
    """Yield a head and a row for each pose of each solution."""
    yield ['solution', 'robot', 'step', 'x', 'y', 'phi']
    for solution, estimate in result.solutions().items():
        for robot, poses in estimate.poses.items():
            for step, pose in enumerate(poses.tolist()):
                yield [solution, robot, str(step), *map(repr, pose)]


def landmark_rows(result: VictoriaPark) -> Iterator[list[str]]:
    """Yield a head and a row for each landmark of each solution."""
    yield ['solution', 'id', 'x', 'y']
    for solution, estimate in result.solutions().items():
        for id_, point in sorted(estimate.points.items()):
            yield [solution, str(id_), *map(repr, point.tolist())]


def _rows(result: VictoriaPark) -> Iterator[tuple[str, str, float, Mapping[str, float]]]:
    """Yield the entries of each reference, filter or bound, and noise."""
    for sigma, by_reference in result.rmse.items():
        for reference, by_filter in by_reference.items():
            for name, entries in by_filter.items():
                yield reference, name, sigma, entries
    for name, entries in result.bounds.items():
        yield 'one_robot_batch', name, OBSERVATION_SIGMAS[0], entries


def _rounded(entries: Mapping[str, float], entry: str) -> str:
    *_, digits = PARK_ENTRIES[entry]
    return f'{entries[entry]:.{digits}f}'


def _verdict(rmse: Rmse) -> str:
    """Return in words in which entries one filter is better than another."""
    return '\n'.join([
        'FEJ is **not** better than the standard filter in all entries of this data set:', '',
        *_compared(rmse, 'fej', 'standard'), '', 'The invariant filter compared with FEJ:', '',
        *_compared(rmse, 'invariant', 'fej'), ''])


def _compared(rmse: Rmse, name: str, other: str) -> Iterator[str]:
    for reference, by_filter in rmse.items():
        titles: dict[bool, list[str]] = {True: [], False: []}
        for entry, (title, *_) in PARK_ENTRIES.items():
            titles[by_filter[name][entry] < by_filter[other][entry]].append(title)
        better, worse = (', '.join(titles[is_better]) or 'nothing' for is_better in (True, False))
        yield f'- against {REFERENCES[reference]} better in {better}; worse in {worse}'


def _beside_the_paper(result: VictoriaPark) -> str:
    """Return which filter is closer to X_GNI than those of the paper, and what limits it."""
    paper = ', '.join(
        f'{PARK_ENTRIES[entry][0]} {value:.3f} m' for entry, value in PAPER_RMSE.items())
    lines = [f'RMSE against X_GNI below the best of the paper ({paper}):', '']
    for sigma, by_reference in result.rmse.items():
        for name, entries in by_reference['one_robot_batch'].items():
            below = ', '.join(
                PARK_ENTRIES[entry][0] for entry, value in PAPER_RMSE.items()
                if float(_rounded(entries, entry)) < value)
            lines.append(
                f'- {PARK_FILTERS[name]}, observations of {sigma} m: {below or "nothing"}')
    causal, batch = result.bounds['until_then'], result.bounds['two_robot_batch']
    limit = (
        'A filter cannot be expected to do better: causal least squares over both robots itself'
        f' differs from X_GNI by {causal["r1_pos"]:.2f} m (R1) and {causal["r2_pos"]:.2f} m (R2),'
        f' at every {CAUSAL_STRIDE}th step, and its final map by {batch["f_pos"]:.2f} m. A filter'
        ' with that noise that is closer has no more information; its linearisation errors happen'
        ' to point towards X_GNI.\n')
    return '\n'.join([*lines, '', limit])


def _beside_the_file(difference: MaxDifference | None) -> str:
    if difference is None:
        return 'There was no X_GNI.mat to compare the one-robot batch with.\n'
    return (
        f"The one-robot batch is the authors' X_GNI.mat: they differ by {difference.position:.0e}"
        f' m and {difference.heading:.0e} rad at most.\n')
