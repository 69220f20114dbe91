# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the stamps of CSV tables, whose rows are in the order of recording."""

from collections import defaultdict
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, Stamps
from fej_slam_ros.core.ordering.backward_stamps import breaks, steps_back
from fej_slam_ros.core.records import NS, Odometry, RobotScan, Scan
from fej_slam_ros.datasets.scans import observed_name
from fej_slam_ros.errors import UserError

#: Share of rows that step back in time above which they are not in the order of recording.
MAX_SHARE_BACK = 0.05
#: Shortest usual time [ns] between odometry: no sensor is faster, but units are mistaken.
MIN_STEP = 10_000
#: Time [ns] without rows, a day, before or after which up to this many rows have wrong stamps.
MAX_STEP, MAX_STRAYS = 24 * 3600 * NS, 10
#: Share of the time of a table from which on a time that is passed twice is that of two sensors.
MAX_OVERLAP = 0.5


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
        _refuse(path, robot, _steps_of_clock(of_robot))


def require_one_clock_of_scans(path: Path, scans: Iterable[Scan | RobotScan]) -> None:
    """
    Raise a `UserError` if a robot's scans, as recorded, pass a time twice.

    Tables of one landmark after the other pass all of it again, as do those of one sensor after
    the other; rows that are in no order repeat the stamps of others.
    """
    of_robots: dict[str, list[Scan | RobotScan]] = defaultdict(list)
    for scan in scans:
        of_robots[scan.robot].append(scan)
    for robot, recorded in of_robots.items():
        if not _is_by_landmark(recorded):
            stamps = np.array([*dict.fromkeys(scan.stamp for scan in recorded)])
            _refuse(path, robot, [
                (before, after) for before, after in _steps_of_clock(stamps)
                if before - after < MAX_OVERLAP * np.ptp(stamps)])


def _is_by_landmark(scans: Iterable[Scan | RobotScan]) -> bool:
    """Return whether the rows of scans are in the order of what they observe."""
    names = [observed_name(seen) for scan in scans for seen in scan.observations]
    return 1 < len({*names}) == len([*groupby(names)])


def _steps_of_clock(stamps: Stamps) -> list[tuple[int, int]]:
    """Return the stamps before and after each step of a clock; none if rows are in no order."""
    if len(steps_back(stamps)) > max(MAX_SHARE_BACK * len(stamps), 1):
        return []
    return [(int(stamps[row - 1]), int(stamps[row])) for row in breaks(stamps)]


def _refuse(path: Path, robot: str, steps: Iterable[tuple[int, int]]) -> None:
    for before, after in steps:
        raise UserError(
            f'{path}: the time of {robot} goes back by {(before - after) / NS:.3f} s at stamp_ns'
            f' {after}, to a time that has rows before: its clock was set back, or recordings'
            ' were joined; correct the stamps, or convert each part on its own')


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
