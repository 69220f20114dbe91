# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Odometry of one robot as motions between its events.

Only differences of integrated poses are used, so a gap costs accuracy and nothing else. A scan
between two odometry stamps divides the increment between them; nothing is extrapolated.
"""

from bisect import insort
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.geometry import Array, between, interpolated, pose_rotation, wrap
from fej_slam_ros.core.ordering.impossible_motion import (
    impossible_motion, MIN_SPEED_BOUNDS, Speeds, speeds, UNKNOWN_SPEEDS)
from fej_slam_ros.core.records import Motion, NS, Odometry
from fej_slam_ros.core.settings import NoiseSettings, RobotSettings


def increment(
    earlier: Odometry, later: Odometry, settings: NoiseSettings
) -> tuple[Array, Array]:
    """
    Return the displacement u (3,) between two odometry records and its covariance Q (3, 3).

    u is without systematic errors. Q, without noise scale, is dt^2 times the twist covariance of
    the later record; if that is unknown, diag(odometry_sigma^2) dt.

    """
    dt = (later.stamp - earlier.stamp) / NS
    u = without_odometry_errors(between(earlier.pose, later.pose), dt, settings)
    if later.twist_covariance is None:
        return u, np.diag(np.square(settings.odometry_sigma)) * dt
    return u, dt * dt * later.twist_covariance


def without_odometry_errors(u: Array, dt: float, settings: NoiseSettings) -> Array:
    """Return a displacement u (3,) by odometry over a duration [s] without systematic errors."""
    scale, bias = settings.odometry_scale, settings.odometry_turn_bias
    if scale == (1.0, 1.0) and bias == 0.0:
        return u
    x, y, phi = u.tolist()
    return np.array([scale[0] * x, scale[0] * y, wrap(scale[1] * phi - bias * dt)])


def scaled_increment(earlier: Odometry, later: Odometry, settings: RobotSettings) -> Motion:
    """Return the motion between two odometry records of a robot, with its noise scale."""
    u, Q = increment(earlier, later, settings)
    if settings.odometry_noise_scale != 1.0:
        Q = settings.odometry_noise_scale ** 2 * Q
    return Motion(settings.name, later.stamp, u, Q)


def checked_increment(
    earlier: Odometry, later: Odometry, before: Speeds, settings: RobotSettings
) -> tuple[Motion, Speeds]:
    """
    Return the motion as `scaled_increment`, checked, and the speeds before the next one.

    After an impossible motion these are the ones before it, so that the return from one wrong
    message is impossible, too.

    """
    motion, dt = scaled_increment(earlier, later, settings), (later.stamp - earlier.stamp) / NS
    now = speeds(motion.u, dt)
    reason = impossible_motion(now, motion.Q, dt, later, before, settings)
    return (replace(motion, impossible=reason), before) if reason else (motion, now)


def unknown_motion(dt: float, before: Speeds) -> tuple[Array, Array]:
    """Return u (3,), Q (3, 3) over a duration [s] of a robot of which only speeds are known."""
    at_most = [s if s < np.inf else 0.0 for s in before]
    linear, angular = dt * np.maximum(at_most, MIN_SPEED_BOUNDS)
    return np.zeros(3), np.diag(np.square([linear, linear, angular]))


def split(u: Array, Q: Array, a: float) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return (u, Q), (3,) and (3, 3), of the first fraction a and of the rest: u_a o rest = u."""
    u_a = a * u
    back = pose_rotation(u_a[2])
    return (u_a, a * Q), (between(u_a, u), (1.0 - a) * back.T @ Q @ back)


class OdometryIncrements:
    """Waiting odometry of one robot, and its progress within the present increment."""

    def __init__(self, settings: RobotSettings) -> None:
        self.settings = settings  #: of the robot
        self.waiting: list[Odometry] = []  #: records that are not used yet, by stamp
        self.newest: int | None = None  #: stamp of the newest odometry received [ns]
        self.first: int | None = None  #: stamp of the first odometry used [ns]
        self.processed: int | None = None  #: stamp of the last event [ns]
        self.pose: Array = np.zeros(3)  #: odometry pose at the last event
        # The present increment: begin [ns], end, and its rest (u, Q) after the last event, None
        # at the end.
        self._begin: int | None = None
        self._end: Odometry | None = None
        self._rest: tuple[Array, Array] | None = None
        self._speeds = UNKNOWN_SPEEDS

    def add(self, record: Odometry) -> None:
        """Insert a record by its stamp."""
        insort(self.waiting, record, key=lambda other: other.stamp)
        self.newest = self.waiting[-1].stamp

    def next_stamp(self) -> int | None:
        """Return the stamp of the next odometry: the end of a divided increment, or a record."""
        if self._rest is not None and self._end is not None:
            return self._end.stamp
        return self.waiting[0].stamp if self.waiting else None

    def used_stamp(self, stamp: int) -> int:
        """Return the stamp of the odometry by which the robot has moved to an event at a stamp."""
        return stamp if self._end is None else self._end.stamp

    def needed_stamp(self, stamp: int) -> int:
        """Return the stamp up to which an event at a stamp needs odometry."""
        end = self.next_stamp()
        return stamp if end is None else max(stamp, end)

    def reaches_back_to(self, stamp: int) -> bool:
        """Return whether there is odometry at a stamp or before."""
        return self._end is not None or self.next_stamp() == stamp

    def is_past(self, stamp: int) -> bool:
        """Return whether odometry of a stamp is too late to be used."""
        return (self._end is not None and stamp <= self._end.stamp) or (
            self.processed is not None and stamp <= self.processed)

    def due(self, stamp: int, longest_gap: int) -> int:
        """Return when the event at a stamp is due: within a longer gap, at the end of the gap."""
        end = self.next_stamp()
        begin = self._end.stamp if self._end is not None and self._rest is None else self._begin
        if begin is None or end is None or end - begin <= longest_gap:
            return stamp
        return end

    def advance(self, stamp: int) -> Motion | None:
        """Move to an event; return the motion, or None at the first odometry."""
        before, self.processed = self.processed, stamp
        if self._end is None or before is None:
            self._end, self.first = self.waiting.pop(0), stamp
            self.pose = self._end.pose
            return None
        if self._rest is None:
            earlier, self._end = self._end, self.waiting.pop(0)
            self._begin = earlier.stamp
            speeds_before = self._speeds
            whole, self._speeds = checked_increment(
                earlier, self._end, speeds_before, self.settings)
            if whole.impossible:
                return self._jump(whole, stamp, self._end, speeds_before)
            self._rest = whole.u, whole.Q
        if stamp == self._end.stamp:
            (u, Q), self._rest = self._rest, None
            self.pose = self._end.pose
        else:
            a = (stamp - before) / (self._end.stamp - before)
            (u, Q), self._rest = split(*self._rest, a)
            self.pose = interpolated(self.pose, self._end.pose, a)
        return Motion(self.settings.name, stamp, u, Q)

    def _jump(self, whole: Motion, stamp: int, end: Odometry, before: Speeds) -> Motion:
        """Move to an event within an impossible increment, after which the motion is unknown."""
        self.pose = end.pose
        if stamp < end.stamp:
            self._rest = unknown_motion((end.stamp - stamp) / NS, before)
        return replace(whole, stamp=stamp)

    def clear(self) -> None:
        """Forget the odometry, so that the next record is a first one."""
        self.waiting = []
        self.newest = self.first = self._begin = self._end = self._rest = None
        self._speeds = UNKNOWN_SPEEDS
