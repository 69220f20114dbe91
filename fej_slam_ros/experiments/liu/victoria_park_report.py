# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Victoria Park in words and tables: which filter is better where, and what was to be reached."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.common.markdown import table
from fej_slam_ros.experiments.liu.victoria_park import (
    Difference, EVERY, FILTERS, OBSERVATION_SIGMAS, REFERENCES, Rmse, VictoriaPark)

#: The entries with their titles, units and digits.
ENTRIES = {
    'r1_pos': ('R1 pos', 'm', 3), 'r1_head': ('R1 head', 'rad', 4),
    'r2_pos': ('R2 pos', 'm', 3), 'r2_head': ('R2 head', 'rad', 4), 'f_pos': ('map pos', 'm', 3)}

#: What the better of the two filters of [Liu] reaches against X_GNI [m]; less was the aim.
AIMS = {'r1_pos': 0.217, 'r2_pos': 1.25, 'f_pos': 0.40}

MEANING = """\
One car's log stands for two robots. Nobody knows the truth, so least squares over all that was
measured stands for it: over both robots with the noise that the filters assume, and over the
whole log without weights, as in the paper. A filter's pose counts as it was right after each
step, its map as it was in the end; RMSE is one root over all steps, or all landmarks. The ideal
filter is linearised at the two-robot batch, which is no truth but the reference. Right after a
step nobody can know more than least squares over what was measured until then, which is told of
every 50th step.
"""


def markdown(result: VictoriaPark) -> str:
    """Return the tables, and what they mean."""
    titles = [f'{title} [{unit}]' for title, unit, _ in ENTRIES.values()]
    names = FILTERS | REFERENCES
    rows = [
        [REFERENCES[reference], names[name], str(sigma),
         *(_rounded(entries, entry) for entry in ENTRIES)]
        for reference, name, sigma, entries in _rows(result)]
    two, one = result.two_robots, result.one_robot
    batches = [
        [*told, str(of.unknowns), str(of.iterations)] for of, told in (
            (two, ('two robots', 'as the filters', f'{two.cost:.3f}')),
            (one, ('one robot', 'none', f'{one.cost:.10f}')))]
    return '\n'.join([
        '# Victoria Park, two robots\n',
        MEANING,
        table(['RMSE against', 'filter', 'observation sigma [m]', *titles], rows, (0, 1)), '',
        _verdict(result.rmse[OBSERVATION_SIGMAS[0]]),
        _reached(result),
        table(['least squares', 'weights', 'cost', 'unknowns', 'iterations'], batches, (0, 1)), '',
        _beside_the_file(result.batch_solution)])


def csv_rows(result: VictoriaPark) -> list[list[str]]:
    """Return a head and a row for each reference and filter."""
    return [['reference', 'filter', 'sighting_sigma', *ENTRIES], *(
        [reference, name, str(sigma), *(repr(entries[entry]) for entry in ENTRIES)]
        for reference, name, sigma, entries in _rows(result))]


def summary(result: VictoriaPark) -> dict[str, Any]:
    """Return all but poses and landmarks, in a form that JSON knows."""
    return {
        'rmse': result.rmse,
        'bounds': result.bounds,
        'batch': {
            name: {'cost': of.cost, 'unknowns': of.unknowns, 'iterations': of.iterations}
            for name, of in result.batches().items()},
        'x_gni_difference': None if result.batch_solution is None else asdict(result.batch_solution)}


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
    *_, digits = ENTRIES[entry]
    return f'{entries[entry]:.{digits}f}'


def _verdict(rmse: Rmse) -> str:
    """Return in words where a filter is better than another and where it is not."""
    lines = ['FEJ is **not** better than the standard filter everywhere on this data:', '']
    lines += _compared(rmse, 'fej', 'standard')
    lines += ['', 'The invariant filter beside FEJ:', '']
    return '\n'.join([*lines, *_compared(rmse, 'invariant', 'fej'), ''])


def _compared(rmse: Rmse, name: str, other: str) -> Iterator[str]:
    for reference, by_filter in rmse.items():
        sides: dict[bool, list[str]] = {True: [], False: []}
        for entry, (title, *_) in ENTRIES.items():
            sides[by_filter[name][entry] < by_filter[other][entry]].append(title)
        better, worse = (', '.join(sides[is_better]) or 'nothing' for is_better in (True, False))
        yield f'- against {REFERENCES[reference]} better in {better}; worse in {worse}'


def _reached(result: VictoriaPark) -> str:
    """Return which filter reaches what against X_GNI, and what stands against more."""
    aims = ', '.join(f'{ENTRIES[entry][0]} {aim:.3f} m' for entry, aim in AIMS.items())
    lines = [f'Nearer to X_GNI than {aims}:', '']
    for sigma, by_reference in result.rmse.items():
        for name, entries in by_reference['one_robot_batch'].items():
            reached = [
                ENTRIES[entry][0] for entry, aim in AIMS.items()
                if float(_rounded(entries, entry)) < aim]
            lines.append(
                f'- {FILTERS[name]}, observations of {sigma} m: {", ".join(reached) or "nothing"}')
    then, batch = result.bounds['until_then'], result.bounds['two_robot_batch']
    why = (
        'What stands against more: least squares over what both robots had measured until then is'
        f' itself {then["r1_pos"]:.2f} m (R1) and {then["r2_pos"]:.2f} m (R2) off, at every'
        f' {EVERY}th step, and its map in the end {batch["f_pos"]:.2f} m. A filter of that noise'
        ' that is nearer knows no more than that: its linearisation errs towards X_GNI.\n')
    return '\n'.join([*lines, '', why])


def _beside_the_file(difference: Difference | None) -> str:
    if difference is None:
        return 'There was no X_GNI.mat to compare the one-robot batch with.\n'
    return (
        f"The one-robot batch is the authors' X_GNI.mat: they differ by {difference.position:.0e}"
        f' m and {difference.heading:.0e} rad at most.\n')
