# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the C-SAM experiments: results over all runs, and requirements on them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from fej_slam_ros.core.csam.message_sizes import smallest
from fej_slam_ros.experiments.andersson.experiment import CsamRun, EXPERIMENTS, JoinGain
from fej_slam_ros.tables import markdown_table


class Bounds(NamedTuple):
    """Lowest and highest value that meets a requirement."""

    low: float = -math.inf
    high: float = math.inf

    def __str__(self) -> str:
        low, high = self
        if math.isinf(high):
            return f'at least {low:g}'
        return f'at most {high:g}' if math.isinf(low) else f'{low:g} to {high:g}'


#: Samples at which heading sigmas are printed.
HEADING_SAMPLES = (20, 40, 55, 80)
#: Entries over the runs of an experiment: title with unit, and digits.
CSAM_ENTRIES = {
    'joined': ('runs that were joined [%]', 1),
    'found': ('true associations found [%]', 2),
    'false': ('false ones among the associations [%]', 3),
    'touched': ('runs with a false association [%]', 1),
    'nees_poses': ('NEES/3 of joined poses', 3),
    'nees_landmarks': ('NEES/2 of joined landmarks', 3),
    'nees_base_node': ('NEES/3 of the base node', 3),
    'chi_square': ('chi-square per degree of freedom', 3),
    'ratio_p': ('P: mean heading sigma, joined / before', 3),
    'ratio_q': ('Q: mean heading sigma, joined / before', 3),
    'by_sample_p': ('P: heading sigma joined / before, mean over samples', 3),
    'by_sample_q': ('Q: heading sigma joined / before, mean over samples', 3),
    'not_worse_p': ('P: samples not worse than before [%]', 2),
    'not_worse_q': ('Q: samples not worse than before [%]', 2),
    'worst_p': ('P: the worst sample, joined / before', 4),
    'worst_q': ('Q: the worst sample, joined / before', 4),
    'big_step': ("rise of Q's heading sigma in its longest landmark gap, joined / before", 3),
    'q_over_p': ("Q's heading sigma / P's, in P's frame", 3),
}
#: Entries that exist for maps that were not joined, too.
ASSOCIATION_ENTRIES = ('joined', 'found', 'false', 'touched')
NEES_BOUNDS = {f'nees_{part}': Bounds(0.85, 1.17) for part in ('poses', 'landmarks', 'base_node')}
HEADING_ENTRIES = (
    'ratio_p', 'ratio_q', 'by_sample_p', 'by_sample_q', 'not_worse_p', 'not_worse_q', 'worst_p',
    'worst_q')
#: Entries of each experiment with their requirements over 100 runs, None for no requirement.
REQUIREMENTS: dict[str, dict[str, Bounds | None]] = {
    'map_joining': {
        'joined': None, 'found': Bounds(low=98.5), 'false': Bounds(high=0.1),
        'touched': Bounds(high=2.0), **NEES_BOUNDS, 'chi_square': None,
        'ratio_p': Bounds(high=0.65), 'ratio_q': Bounds(high=0.65),
        'by_sample_p': None, 'by_sample_q': None,
        'not_worse_p': Bounds(low=99.0), 'not_worse_q': Bounds(low=99.0),
        'worst_p': Bounds(high=1.001), 'worst_q': Bounds(high=1.001),
        'big_step': Bounds(high=0.6)},
    'sensor_extension': {
        'joined': None, 'found': Bounds(low=98.5), 'false': Bounds(high=0.0),
        'touched': Bounds(high=0.0), **NEES_BOUNDS, 'chi_square': None,
        **dict.fromkeys(HEADING_ENTRIES), 'q_over_p': Bounds(high=1.2)},
}

CSAM_NOTES = f"""\
Two robots, P and Q, with landmark IDs of their own smooth their trajectories and maps alone,
observe each other, and join their maps. Seeds are those of `simulate`; true associations are the
landmarks that both robots observed. The requirements are meant for 100 runs.

A heading sigma is the standard deviation of a robot's heading in the frame of **its own start**:
in the joint map, that of Q is relative to Q's first pose there. A mean heading sigma is over all
samples and runs. Only the entry "{CSAM_ENTRIES['q_over_p'][0]}" has both in the frame of
**P's start**: the mean over Q's samples over the mean over P's. NEES is in the frame of P's start,
too. The longest landmark gap is the longest time in which Q has fewer than two landmarks in view;
the rise is from the last sample before it to the first one after it.
"""


@dataclass(frozen=True, slots=True)
class CsamEntry:
    """An entry over all runs of an experiment, and the bounds that it should meet, if any."""

    value: float
    required: Bounds | None

    @property
    def is_met(self) -> bool | None:
        """Return whether the value meets its requirement, None for no requirement."""
        if self.required is None:
            return None
        return self.required.low <= self.value <= self.required.high


def entries(runs: Sequence[CsamRun]) -> dict[str, CsamEntry]:
    """Return the entries of runs of one experiment by name, as far as the runs have them."""
    values = _values(runs)
    requirements = REQUIREMENTS[runs[0].task.experiment]
    return {
        name: CsamEntry(values[name], requirements[name])
        for name in requirements if name in values}


def markdown(runs: Sequence[CsamRun]) -> str:
    """Return the tables as a page."""
    parts = ['# Maps joined by C-SAM, section V of [Andersson]', CSAM_NOTES.rstrip()]
    for experiment, of_it in _by_experiment(runs).items():
        gains, first, last = _gains(of_it), of_it[0].task.seed, of_it[-1].task.seed
        parts += [
            f'## {EXPERIMENTS[experiment]}: seeds {first} to {last}', _entry_table(entries(of_it)),
            *([_heading_table(gains)] if gains else []), _size_table(of_it),
            *(f'Seed {run.task.seed} was not joined: {run.rejection_reason}.'
              for run in of_it if run.gain is None)]
    return '\n\n'.join(parts) + '\n'


def csv_rows(runs: Sequence[CsamRun]) -> Iterator[list[str]]:
    """Yield a head and a row for each run; missing values are empty."""
    sizes = [f'{form}_{robot}' for robot, by_form in runs[0].sizes.items() for form in by_form]
    measures = [name for name in CSAM_ENTRIES if name not in ASSOCIATION_ENTRIES]
    yield ['experiment', 'seed', 'refusal', 'shared', 'found', 'false', *measures, *sizes]
    for run in runs:
        values = _values([run])
        counts = ('', '') if run.gain is None else (str(run.gain.found), str(run.gain.false))
        wanted = REQUIREMENTS[run.task.experiment]
        yield [
            *map(str, run.task), run.rejection_reason, str(run.shared), *counts,
            *(repr(values[name]) if name in wanted and name in values else ''
              for name in measures),
            *(str(size) for by_form in run.sizes.values() for size in by_form.values())]


def summary(runs: Sequence[CsamRun]) -> dict[str, Any]:
    """Return the results of each experiment for a JSON file."""
    return {
        experiment: {
            'seeds': [run.task.seed for run in of_it],
            'entries': {
                name: {
                    'value': entry.value, 'asked': _finite(entry.required), 'held': entry.is_met}
                for name, entry in entries(of_it).items()},
            'bytes': _mean_sizes(of_it),
            'not_joined': {
                str(run.task.seed): run.rejection_reason for run in of_it if run.gain is None}}
        for experiment, of_it in _by_experiment(runs).items()}


def _by_experiment(runs: Sequence[CsamRun]) -> dict[str, list[CsamRun]]:
    names = dict.fromkeys(run.task.experiment for run in runs)
    return {name: [run for run in runs if run.task.experiment == name] for name in names}


def _gains(runs: Sequence[CsamRun]) -> list[JoinGain]:
    return [run.gain for run in runs if run.gain is not None]


def _values(runs: Sequence[CsamRun]) -> dict[str, float]:
    """Return the values of all entries; a run that was not joined has no associations."""
    gains = _gains(runs)
    found, false = sum(g.found for g in gains), sum(g.false for g in gains)
    values = {
        'joined': 100.0 * len(gains) / len(runs),
        'found': 100.0 * found / sum(run.shared for run in runs),
        'false': 100.0 * false / max(found + false, 1),
        'touched': 100.0 * sum(g.false > 0 for g in gains) / len(runs)}
    return {**values, **_measured(gains)} if gains else values


def _measured(gains: Sequence[JoinGain]) -> dict[str, float]:
    """Return means over runs, and the worst of all samples of all of them."""
    values: dict[str, Any] = {
        name: np.mean([gain.nees[name.removeprefix('nees_')] for gain in gains])
        for name in NEES_BOUNDS}
    values['chi_square'] = np.mean([gain.chi_square for gain in gains])
    for robot in gains[0].before:
        ratios = np.array([gain.ratio(robot) for gain in gains])
        joined = np.mean([gain.joined[robot] for gain in gains])
        values[f'ratio_{robot}'] = joined / np.mean([gain.before[robot] for gain in gains])
        values[f'by_sample_{robot}'] = np.mean(ratios)
        values[f'not_worse_{robot}'] = 100.0 * np.mean(ratios <= 1.0)
        values[f'worst_{robot}'] = np.max(ratios)
    values['big_step'] = sum(gain.rise_in_gap(gain.joined) for gain in gains) / sum(
        gain.rise_in_gap(gain.before) for gain in gains)
    values['q_over_p'] = np.mean([gain.q_over_p for gain in gains])
    return {name: float(value) for name, value in values.items()}


def _entry_table(entries: Mapping[str, CsamEntry]) -> str:
    rows = []
    for name, entry in entries.items():
        title, digits = CSAM_ENTRIES[name]
        verdict = {None: '', True: 'met', False: '**not met**'}[entry.is_met]
        rows.append([title, str(entry.required or ''), f'{entry.value:.{digits}f}', verdict])
    return markdown_table(['', 'required', 'measured', ''], rows)


def _heading_table(gains: Sequence[JoinGain]) -> str:
    """Return the mean heading sigmas of each robot at a few samples."""
    rows = []
    for robot in gains[0].before:
        before = 1e3 * np.mean([gain.before[robot] for gain in gains], axis=0)
        joined = 1e3 * np.mean([gain.joined[robot] for gain in gains], axis=0)
        rows.append([
            robot.upper(), *(f'{before[k]:.1f} -> {joined[k]:.1f}' for k in HEADING_SAMPLES)])
    return markdown_table(
        ['heading sigma [mrad], before -> joined, at sample', *map(str, HEADING_SAMPLES)], rows)


def _size_table(runs: Sequence[CsamRun]) -> str:
    sizes = _mean_sizes(runs)
    forms = [*next(iter(sizes.values()))]
    rows = [
        [robot.upper(), *(f'{form_sizes[form]:.0f}' for form in forms), smallest(form_sizes)]
        for robot, form_sizes in sizes.items()]
    return markdown_table(['bytes of the alignment message', *forms, 'smallest'], rows)


def _mean_sizes(runs: Sequence[CsamRun]) -> dict[str, dict[str, float]]:
    return {
        robot: {form: float(np.mean([run.sizes[robot][form] for run in runs])) for form in by_form}
        for robot, by_form in runs[0].sizes.items()}


def _finite(bounds: Bounds | None) -> list[float | None] | None:
    """Return the bounds for a JSON file, None for an infinite one."""
    return bounds and [bound if math.isfinite(bound) else None for bound in bounds]
