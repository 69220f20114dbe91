# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the stamps of a table of odometry, whose rows are in the order of recording."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, Stamps
from fej_slam_ros.core.ordering.backward_stamps import breaks, steps_back
from fej_slam_ros.core.records import NS, Odometry
from fej_slam_ros.errors import UserError

#: Share of rows that step back in time above which they are not in the order of recording.
MAX_SHARE_BACK = 0.05
#: Shortest usual time [ns] between odometry: no sensor is faster, but units are mistaken.
MIN_STEP = 10_000
#: Time [ns] without rows, a day, before or after which up to this many rows have wrong stamps.
MAX_STEP, MAX_STRAYS = 24 * 3600 * NS, 10


def require_one_clock(path: Path, odometry: Iterable[Odometry]) -> None:
    """Raise a `UserError` if a robot's rows, as recorded, pass a time twice, or have only one."""
    stamps: dict[str, list[int]] = defaultdict(list)
    for record in odometry:
        stamps[record.robot].append(record.stamp)
    for robot, recorded in stamps.items():
        if len(recorded) > 1 and min(recorded) == max(recorded):
            raise UserError(
                f'{path}: all {len(recorded)} rows of {robot} have the same time: export it'
                ' with all its digits, or as stamp_ns')
        of_robot = np.array(recorded)
        if fault := _unit_or_stray(np.unique(of_robot)):
            raise UserError(f'{path}, rows of {robot}: {fault}')
        if len(steps_back(of_robot)) > max(MAX_SHARE_BACK * len(of_robot), 1):
            continue
        rows = breaks(of_robot)
        if rows:
            row = rows[0]
            raise UserError(
                f'{path}: the time of {robot} goes back by'
                f' {(recorded[row - 1] - recorded[row]) / NS:.3f} s at stamp_ns {recorded[row]},'
                ' to a time that has rows before: its clock was set back, or recordings were'
                ' joined; correct the stamps, or convert each part on its own')


def contradicted(odometry: Iterable[Odometry]) -> list[int]:
    """Return the stamps [ns] at which a robot has another pose than in a row before."""
    poses: dict[int, Array] = {}
    return [
        record.stamp for record in odometry
        if not np.array_equal(poses.setdefault(record.stamp, record.pose), record.pose)]


def _unit_or_stray(stamps: Stamps) -> str:
    """Return what is wrong with the distances of ascending stamps of odometry, or ''."""
    steps = np.diff(stamps)
    if len(steps) >= MAX_STRAYS and np.median(steps) < MIN_STEP:
        return (
            f'their times are {np.median(steps):.0f} ns apart: give stamp_ns in nanoseconds, or a'
            ' column time in seconds')
    for after in (np.flatnonzero(steps > MAX_STEP) + 1).tolist():
        is_last = after > len(stamps) - after
        if min(after, len(stamps) - after) <= MAX_STRAYS and 2 * after != len(stamps):
            return (
                f'stamp_ns {stamps[after if is_last else after - 1]} is'
                f' {steps[after - 1] / MAX_STEP:.0f} days from most of them: correct or remove it')
    return ''
