# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Victoria Park in words and tables: where FEJ is better than the standard EKF, and where not."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.victoria_park import (
    Difference, FILTERS, REFERENCES, Rmse, VictoriaPark)

#: The entries with their titles, units and digits.
ENTRIES = {
    'r1_pos': ('R1 pos', 'm', 3), 'r1_head': ('R1 head', 'rad', 4),
    'r2_pos': ('R2 pos', 'm', 3), 'r2_head': ('R2 head', 'rad', 4), 'f_pos': ('map pos', 'm', 3)}

MEANING = """\
One car's log stands for two robots. Nobody knows the truth, so least squares over all that was
measured stands for it: over both robots with the noise that the filters assume, and over the
whole log without weights, as in the paper. A filter's pose counts as it was right after each
step, its map as it was in the end; RMSE is one root over all steps, or all landmarks.
"""


def markdown(result: VictoriaPark) -> str:
    """Return the tables, and what they mean."""
    titles = [f'{title} [{unit}]' for title, unit, _ in ENTRIES.values()]
    rows = [
        [REFERENCES[reference], FILTERS[name],
         *(f'{entries[entry]:.{digits}f}' for entry, (*_, digits) in ENTRIES.items())]
        for reference, name, entries in _rows(result)]
    two, one = result.two_robots, result.one_robot
    batches = [
        ['two robots', 'as the filters', f'{two.cost:.3f}', two.unknowns, two.iterations],
        ['one robot', 'none', f'{one.cost:.10f}', one.unknowns, one.iterations]]
    return '\n'.join([
        '# Victoria Park, two robots\n',
        MEANING,
        _table(['RMSE against', 'filter', *titles], rows),
        _verdict(result.rmse),
        _table(['least squares', 'weights', 'cost', 'unknowns', 'iterations'], batches),
        _beside_the_file(result.x_gni)])


def csv_rows(result: VictoriaPark) -> list[list[str]]:
    """Return a head and a row for each reference and filter."""
    return [['reference', 'filter', *ENTRIES], *(
        [reference, name, *(repr(entries[entry]) for entry in ENTRIES)]
        for reference, name, entries in _rows(result))]


def summary(result: VictoriaPark) -> dict[str, Any]:
    """Return all but poses and landmarks, in a form that JSON knows."""
    return {
        'rmse': result.rmse,
        'batch': {
            name: {'cost': of.cost, 'unknowns': of.unknowns, 'iterations': of.iterations}
            for name, of in result.batches().items()},
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


def _rows(result: VictoriaPark) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """Yield the entries of each reference and filter."""
    for reference, by_filter in result.rmse.items():
        for name, entries in by_filter.items():
            yield reference, name, entries


def _table(head: list[str], rows: list[list[Any]]) -> str:
    """Return a table with names in the first two columns and numbers in the others."""
    rule = ['---', '---', *['--:'] * (len(head) - 2)]
    return ''.join(f'| {" | ".join(map(str, row))} |\n' for row in (head, rule, *rows))


def _verdict(table: Rmse) -> str:
    """Return in words where FEJ is better and where it is not."""
    lines = ['FEJ is **not** better than the standard filter everywhere on this data:', '']
    for reference, by_filter in table.items():
        sides: dict[bool, list[str]] = {True: [], False: []}
        for entry, (title, *_) in ENTRIES.items():
            sides[by_filter['fej'][entry] < by_filter['standard'][entry]].append(title)
        better, worse = (', '.join(sides[is_better]) or 'nothing' for is_better in (True, False))
        lines.append(f'- against the {REFERENCES[reference]} better in {better}; worse in {worse}')
    standard, fej = (table['two_robot_batch'][name]['r2_pos'] for name in ('standard', 'fej'))
    return '\n'.join([
        *lines, '',
        f'At R2 both are far from the two-robot batch: {standard:.1f} m and {fej:.1f} m.\n'])


def _beside_the_file(difference: Difference | None) -> str:
    if difference is None:
        return 'There was no X_GNI.mat to compare the one-robot batch with.\n'
    return (
        f"The one-robot batch is the authors' X_GNI.mat: they differ by {difference.position:.0e}"
        f' m and {difference.heading:.0e} rad at most.\n')
