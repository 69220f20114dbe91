# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Order of a robot's rows whose stamps step back, and rows of a clock that was set.

Rows that were written late are sorted. Where a clock was set back, the landmarks before and after,
true poses or other robots show that the robot drives on, and one clock continues through both
parts. Other rows are of another recording, and left out. Where a clock was set forward there is a
gap, as there is where nothing was recorded; true poses or other robots tell them apart.
"""

from collections import Counter
from collections.abc import Container, Iterator, Sequence
from itertools import pairwise

import numpy as np

from fej_slam_ros.core.geometry import Stamps
from fej_slam_ros.core.ordering.backward_stamps import (
    breaks, MAX_DISORDER, period, recorded_order, steps_back)
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.clock_evidence import ClockEvidence
from fej_slam_ros.datasets.mrclam.clock_parts import ClockPart, MAX_STEP, positions
from fej_slam_ros.datasets.series import drop, joined, Series

#: Landmarks observed within this time [ns] on both sides of a break are compared.
COMPARED_TIME = 20 * NS
#: Maximum difference of a landmark's positions by two observations: constant [m], per metre of
#: range, and per metre times the root of the seconds in between, in which odometry turns away.
POSITION_TOLERANCE = np.array([0.2, 0.08, 0.04])
#: Stamps that go on after a step back by up to this [ns] are of a clock that was set: two
#: recordings of one robot do not overlap by seconds.
MAX_CERTAIN_SHIFT = 5 * NS
#: Share of the landmarks that must agree; a bar code may be misread.
MIN_AGREEING_SHARE = 0.75
#: Share of copies among the rows at a time that was passed before, if these are repeated, and
#: number of different ones: rows of another time may be equal by chance.
MIN_COPIES, MIN_DIFFERENT = 0.8, 3
#: Maximum error of rows by the clock of the rows next to them, relative to that by their own. On
#: set 6 the ratio is 0.2 to 0.7 if their own is wrong, and 1.4 at least if it is right.
MAX_SHIFTED_ERROR = 0.7
#: Longest time without rows [ns] that is no sign of a clock that was set forward.
MAX_COMMAND_GAP = 3 * NS // 2


def may_be_set(stamps: Stamps) -> bool:
    """Return whether the stamps of commands may be of a clock that was set meanwhile."""
    return bool(breaks(stamps)) or bool((np.diff(stamps) > MAX_COMMAND_GAP).any())


def in_order(
    commands: Series, observations: Series, evidence: ClockEvidence, counts: Counter[str]
) -> ClockPart:
    """
    Return the commands and observations of a robot in the order of their times.

    Parameters
    ----------
    commands, observations : in the order of recording, by one clock
    evidence : shows which clock was right, where the rows have several
    counts : is increased by the rows that were late, repeated, shifted or left out

    """
    what = 'stamp steps back' + ('' if breaks(commands.stamps) else ' (put in order)')
    counts[what] += sum(
        int((np.diff(series.stamps) < 0).sum()) for series in (commands, observations))
    if steps_back(commands.stamps):
        part = _without_steps_back(commands, observations, evidence, counts)
    else:
        part = ClockPart(commands.in_order(), observations.in_order())
    for row in (np.flatnonzero(np.diff(part.commands.stamps) > MAX_COMMAND_GAP) + 1).tolist():
        part = _without_step_forward(part, row, evidence, counts)
    return part


def _without_steps_back(
    commands: Series, observations: Series, evidence: ClockEvidence, counts: Counter[str]
) -> ClockPart:
    """Return the rows of the longest drive, and of others just before and after it."""
    commands, observations = (
        _without_repeated(series, counts) for series in (commands, observations))
    if breaks(commands.stamps):
        commands = commands[recorded_order(commands.stamps)]
    drives: list[list[ClockPart]] = []
    for part in _parts(commands, observations, counts):
        if drives and _goes_on(drives[-1][-1], part, evidence):
            drives[-1].append(part)
        else:
            drives.append([part])
    drives.sort(key=lambda drive: sum(len(part.commands) for part in drive), reverse=True)
    kept = _on_one_clock(drives[0], evidence, counts)
    for drive in drives[1:]:
        other = _on_one_clock(drive, evidence, counts)
        if not kept.is_next_to(other):
            counts['command of another recording'] += len(other.commands)
            counts['observation of another recording'] += len(other.observations)
        else:
            kept = kept.with_rows_of(other)
    return kept


def _parts(commands: Series, observations: Series, counts: Counter[str]) -> Iterator[ClockPart]:
    """Yield the rows between the breaks of the commands, each part in the order of stamps."""
    begin = 0
    for first, last in pairwise([0, *breaks(commands.stamps), len(commands)]):
        end = after = len(observations)
        if last < len(commands):
            end, after = _division(observations.stamps, begin, commands.stamps, last)
        counts['observation at a repeated time'] += after - end
        yield ClockPart(commands[first:last].in_order(), observations[begin:end].in_order())
        begin = after


def _without_repeated(series: Series, counts: Counter[str]) -> Series:
    """Return a series without the rows that are there a second time after a step back."""
    keys = np.column_stack([series.stamps, series.rows])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    is_copy = first[inverse.ravel()] < np.arange(len(series))
    repeated = np.zeros(len(series), dtype=bool)
    for row in steps_back(series.stamps):
        again = (series.stamps <= series.stamps[row - 1]) & (np.arange(len(series)) >= row)
        different = len(np.unique(series.rows[again & is_copy], axis=0))
        if is_copy[again].mean() >= MIN_COPIES and different >= MIN_DIFFERENT:
            repeated |= again & is_copy
    return drop(series, repeated, 'row repeated', counts)


def _division(stamps: Stamps, begin: int, commands: Stamps, row: int) -> tuple[int, int]:
    """
    Return the end of the observations before a break, and the first row after it.

    The break repeats the time between the commands before and at `row`. Observations that do not
    step back there are of one recording: the earlier one if only its commands last so long.
    Otherwise those within the repeated time cannot be assigned.
    """
    own, low, high = stamps[begin:], commands[row], commands[row - 1]
    steps = np.diff(own, prepend=own[:1])
    steps[1:][(own[1:] < low - COMPARED_TIME) | (own[:-1] > high + COMPARED_TIME)] = 0
    if len(own) and steps.min() < 0:
        return (begin + int(steps.argmin()),) * 2
    if len(own) and commands[row:].max() < min(high, own[-1]):
        return len(stamps), len(stamps)
    first = begin + int(np.append(own >= low, True).argmax())
    after = begin + int(np.append(own > high, True).argmax())
    return first, max(first, after)


def _shift(earlier: Series, later: Series) -> int:
    """Return the shift [ns] by which later commands follow within a period."""
    step = round(period(joined([earlier, later]).stamps))
    return int(earlier.stamps[-1] + step - later.stamps[0])


def _goes_on(earlier: ClockPart, later: ClockPart, evidence: ClockEvidence) -> bool:
    """Return whether a robot drives on from one part to the next."""
    shift = _shift(earlier.commands, later.commands)
    if shift <= MAX_CERTAIN_SHIFT:
        return True
    differences = _landmark_differences(earlier, later.shifted(shift), evidence.moving)
    if differences and float(np.quantile(differences, MIN_AGREEING_SHARE)) > 1.0:
        return _was_set(later, shift, evidence) or _was_set(earlier, -shift, evidence)
    return bool(differences) or shift <= MAX_STEP


def _was_set(part: ClockPart, shift: int, evidence: ClockEvidence) -> bool:
    """Return whether rows fit the evidence better by another clock than by their own."""
    errors = evidence.errors([part, part.shifted(shift)])
    return errors is not None and errors[1] < MAX_SHIFTED_ERROR * errors[0] < np.inf


def _without_step_forward(
    part: ClockPart, row: int, evidence: ClockEvidence, counts: Counter[str]
) -> ClockPart:
    """Return the rows on the clock before or after the gap at a row, if it was set forward."""
    end, begin = part.commands.stamps[[row - 1, row]].tolist()
    # Observations are stamped apart from commands.
    if len(part.observations.between(end + MAX_DISORDER, begin - MAX_DISORDER)):
        return part
    earlier, later = part.divided(row)
    shift = _shift(earlier.commands, later.commands)
    # Only the rows that would move are judged: the gap itself fits no evidence.
    for moved, other, offset in (later, earlier, shift), (earlier, later, -shift):
        if _was_set(moved, offset, evidence):
            _count_shifted(moved, offset, 'set forward', counts)
            return other.with_rows_of(moved.shifted(offset))
    return part


def _landmark_differences(
    earlier: ClockPart, later: ClockPart, moving: Container[int]
) -> list[float]:
    """
    Return by how much landmarks observed before and after a break differ, over the tolerance.

    The last observation before of each is compared with the first one after it.

    """
    end = earlier.commands.stamps[-1]
    before = earlier.observations.between(end - COMPARED_TIME, end)
    after = later.observations.between(end, end + COMPARED_TIME)
    commands = joined([earlier.commands, later.commands])
    last = {int(subject): k for k, subject in enumerate(before.rows[:, 0])}
    first = {int(subject): k for k, subject in reversed([*enumerate(after.rows[:, 0])])}
    points_before, points_after = (
        positions(commands, observations) for observations in (before, after))
    differences = []
    for subject in last.keys() & first.keys():
        if subject not in moving:
            k, j = last[subject], first[subject]
            r = max(before.rows[k, 1], after.rows[j, 1])
            seconds = (after.stamps[j] - before.stamps[k]) / NS
            tolerance = POSITION_TOLERANCE @ [1.0, r, r * np.sqrt(seconds)]
            distance = np.linalg.norm(points_after[j] - points_before[k])
            differences.append(float(distance / tolerance))
    return differences


def _on_one_clock(
    parts: Sequence[ClockPart], evidence: ClockEvidence, counts: Counter[str]
) -> ClockPart:
    """
    Return successive parts of a drive on the clock of one of them.

    That is the clock that fits the evidence best or, where there is none, that of most commands.
    """
    shifts = np.cumsum([0, *(_shift(a.commands, b.commands) for a, b in pairwise(parts))])
    first, *others = parts
    drives = [
        first.shifted(int(-shift)).with_rows_of(
            *(part.shifted(int(offset)) for part, offset in zip(others, shifts[1:] - shift)))
        for shift in shifts]
    errors = evidence.errors(drives)
    chosen = int(np.argmin([-len(part.commands) for part in parts] if errors is None else errors))
    which = 'set back' if errors is not None else 'set back, nothing tells which was right'
    for part, offset in zip(parts, shifts - shifts[chosen]):
        if offset:
            _count_shifted(part, int(offset), which, counts)
    return drives[chosen]


def _count_shifted(part: ClockPart, offset: int, why: str, counts: Counter[str]) -> None:
    """Count the rows of a part whose clock was set in some way."""
    counts[f'row shifted by {offset / NS:+.3f} s (its clock was {why})'] += (
        len(part.commands) + len(part.observations))
