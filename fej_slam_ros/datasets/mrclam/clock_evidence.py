# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Evidence for the clock of a robot: that of its true poses, or that of other robots nearby.

When one robot observes another, both may know a landmark nearby. The distance between the observed
robot and the landmark is then known twice, and agrees if the clocks of both robots do.
"""

from collections import defaultdict
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.clock_parts import ClockPart, poses_by_odometry, positions
from fej_slam_ros.datasets.series import Series

#: True poses are compared over windows from 1 s to `MAX_WINDOW`, in errors up to 1 rad.
MIN_WINDOW, MAX_WINDOW = NS, 60 * NS
MIN_TURNS = 4
#: Observations of a robot by another within this time [ns] are one meeting: their errors are
#: correlated. Landmarks observed within half of it are compared, in errors up to 1 m.
MEETING_TIME = 10 * NS
#: Minimum number of meetings, and maximum of observations of one robot by another that are used.
MIN_MEETINGS, MAX_OBSERVATIONS = 8, 500
#: Maximum error by the right clock, relative to that by another.
MAX_ERROR_RATIO = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class ClockEvidence:
    """Data that determine the clock of a robot."""

    truth: Series  #: its true poses, in the order of stamps
    moving: Container[int]  #: subjects that are no landmarks
    robot: int  #: its own subject
    others: Mapping[int, ClockPart]  #: other robots, by subject

    def errors(self, drives: Sequence[ClockPart]) -> Sequence[float] | None:
        """Return the error of a drive on each of several clocks; None without evidence."""
        errors = [self._turn_error(drive) for drive in drives]
        if np.isfinite(errors).any():
            return errors
        errors = [self._distance_error(drive) for drive in drives]
        best, second = [*sorted(errors), np.inf][:2]
        return errors if best < MAX_ERROR_RATIO * second else None

    def _turn_error(self, drive: ClockPart) -> float:
        """Return the mean error [rad] of turns between true poses; inf if these are too few."""
        commands = drive.commands
        within = self.truth.between(
            commands.stamps[0], commands.stamps[-1]).first_in_windows(0, MIN_WINDOW)
        used = np.diff(within.stamps) <= MAX_WINDOW
        if used.sum() < MIN_TURNS:
            return np.inf
        headings = poses_by_odometry(commands, within.stamps)[:, 2]
        errors = np.abs(wrap_all(np.diff(within.rows[:, 2]) - np.diff(headings)))
        return float(np.minimum(errors[used], 1.0).mean())

    def _distance_error(self, drive: ClockPart) -> float:
        """Return the mean difference [m] of distances in a meeting; inf if these are too few."""
        meetings = [
            np.median(differences) for subject, other in self.others.items()
            for observer, observed, name in (
                (drive, other, subject), (other, drive, self.robot))
            for differences in self._differences(observer, observed, name).values()]
        if len(meetings) < MIN_MEETINGS:
            return np.inf
        return float(np.minimum(meetings, 1.0).mean())

    def _differences(
        self, observer: ClockPart, observed: ClockPart, subject: int
    ) -> dict[int, list[float]]:
        """
        Return by how much distances of an observed robot from landmarks differ [m], by meeting.

        Each is known from the map of the observer and from that of the robot itself.

        """
        seen = observer.observations[observer.observations.rows[:, 0] == subject]
        seen = seen.between(observed.commands.stamps[0], observed.commands.stamps[-1])
        seen = seen[::max(len(seen) // MAX_OBSERVATIONS, 1)]
        points = positions(observer.commands, seen)
        poses = poses_by_odometry(observed.commands, seen.stamps)
        maps = [self._positions(part) for part in (observer, observed)]
        differences: defaultdict[int, list[float]] = defaultdict(list)
        for stamp, point, pose in zip(seen.stamps.tolist(), points, poses):
            by_observer, by_itself = (_nearest(landmarks, stamp) for landmarks in maps)
            for landmark in by_observer.keys() & by_itself.keys():
                differences[stamp // MEETING_TIME].append(abs(float(
                    np.linalg.norm(by_observer[landmark] - point)
                    - np.linalg.norm(by_itself[landmark] - pose[:2]))))
        return differences

    def _positions(self, part: ClockPart) -> Series:
        """Return landmarks with their positions in the frame of odometry."""
        is_landmark = np.array(
            [subject not in self.moving for subject in part.observations.rows[:, 0].astype(int)],
            dtype=bool)
        observations = part.observations[is_landmark]
        return Series(observations.stamps, np.column_stack([
            observations.rows[:, 0], positions(part.commands, observations)]))


def _nearest(landmarks: Series, stamp: int) -> dict[int, Array]:
    """Return the position of each landmark by its observation nearest to a stamp."""
    near = landmarks.between(stamp - MEETING_TIME // 2, stamp + MEETING_TIME // 2)
    order = np.argsort(-np.abs(near.stamps - stamp))
    return {int(row[0]): row[1:] for row in near.rows[order]}
