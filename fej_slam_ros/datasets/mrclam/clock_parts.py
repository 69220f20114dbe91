# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of one robot by one clock, and what is observed in the frame of its odometry."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, poses_at, Stamps
from fej_slam_ros.core.motion_models import arc_poses
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.series import joined, Series

#: Commands before or after all others, up to this away [ns], may be of the same recording.
MAX_STEP = 60 * NS


@dataclass(frozen=True, slots=True, eq=False)
class ClockPart:
    """Rows of one robot by one clock, in the order of stamps."""

    commands: Series
    observations: Series  #: Subject, range [m], bearing [rad, left]
    #: Stamps of the first commands after another clock: the time before these is not known well
    clock_changes: tuple[int, ...] = ()

    def shifted(self, shift: int) -> 'ClockPart':
        """Return the rows with stamps on another clock [ns]."""
        return ClockPart(
            self.commands.shifted(shift), self.observations.shifted(shift),
            tuple(stamp + shift for stamp in self.clock_changes))

    def divided(self, row: int) -> tuple['ClockPart', 'ClockPart']:
        """Return the rows before and after the middle of the gap before the command at a row."""
        begin = self.commands.stamps[[row - 1, row]].mean()
        is_later = self.observations.stamps >= begin
        return (
            ClockPart(
                self.commands[:row], self.observations[~is_later],
                tuple(stamp for stamp in self.clock_changes if stamp < begin)),
            ClockPart(
                self.commands[row:], self.observations[is_later],
                tuple(stamp for stamp in self.clock_changes if stamp >= begin)))

    def is_next_to(self, other: 'ClockPart') -> bool:
        """Return whether all commands of one are soon after those of the other."""
        begins, ends = zip(*((part.commands.stamps[0], part.commands.stamps[-1]) for part in (
            self, other)))
        return bool(0 < max(begins) - min(ends) <= MAX_STEP)

    def with_rows_of(self, *others: 'ClockPart') -> 'ClockPart':
        """Return the rows of all, in the order of stamps."""
        parts = [self, *others]
        begins = sorted(int(part.commands.stamps[0]) for part in parts)[1:]
        return ClockPart(
            joined([part.commands for part in parts]).in_order(),
            joined([part.observations for part in parts]).in_order(),
            (*(stamp for part in parts for stamp in part.clock_changes), *begins))


def poses_by_odometry(commands: Series, stamps: Stamps) -> Array:
    """Return the poses (n, 3) at stamps (n,) [ns], in the frame of the first command."""
    dt = np.diff(commands.stamps) / NS
    v, w = commands.rows[:-1].T
    return poses_at(stamps, commands.stamps, arc_poses(v * dt, w * dt))


def positions(commands: Series, observations: Series) -> Array:
    """Return where the n observed subjects are in the frame of odometry, (n, 2)."""
    poses = poses_by_odometry(commands, observations.stamps)
    r, bearing = observations.rows[:, 1], poses[:, 2] + observations.rows[:, 2]
    points: Array = poses[:, :2] + r[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return points
