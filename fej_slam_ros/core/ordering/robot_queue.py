# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Order in time within one robot: from its records to the motion that ends at each event.

Odometry is used as differences of integrated poses, so a gap costs accuracy and nothing else. A
scan between two odometry stamps splits the increment between them; nothing is extrapolated.
"""

from bisect import insort
from itertools import takewhile
import sys

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, pose_rotation
from fej_slam_ros.core.records import AnyScan, fingerprint, Motion, NS, Odometry, RobotScan, scaled
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Triple

#: Where an event belongs in the order of all robots, and its stamp [ns].
ReleaseKey = tuple[int, int]
#: So many records are remembered, to tell a duplicate from data that is late.
REMEMBERED = 10_000
#: So many scans wait for odometry at most; beyond that the oldest has waited in vain.
MAX_SCANS = 10_000


def increment(earlier: Odometry, later: Odometry, sigma: Triple) -> tuple[Array, Array]:
    """
    Return the displacement u (3,) between two odometry records and its covariance Q (3, 3).

    Q is dt^2 times the later record's twist covariance; where that is unknown, diag(sigma^2) dt
    with sigma per square root of a second.

    """
    dt = (later.stamp - earlier.stamp) / NS
    u = between(earlier.pose, later.pose)
    if later.twist_covariance is None:
        return u, np.diag(np.square(sigma)) * dt
    return u, dt * dt * later.twist_covariance


def split(u: Array, Q: Array, a: float) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return (u, Q) of the first fraction a of an increment and of the rest: u_a o rest = u."""
    u_a = a * u
    back = pose_rotation(u_a[2])
    return (u_a, a * Q), (between(u_a, u), (1.0 - a) * back.T @ Q @ back)


class RobotQueue:
    """
    What one robot has sent, and how far it has been used.

    Attributes
    ----------
    newest : stamp [ns] of the newest odometry heard, None before the first
    processed : stamp of the last event, None before the first
    pose : (3,) array, where odometry has the robot at its last event

    """

    def __init__(self, settings: RobotSettings) -> None:
        self.name = settings.name
        self.newest: int | None = None
        self.processed: int | None = None
        self.pose: Array = np.zeros(3)
        self._settings = settings
        self._odometry: list[Odometry] = []
        self._scans: list[AnyScan] = []
        self._began: int | None = None
        self._reached: Odometry | None = None
        self._rest: tuple[Array, Array] | None = None
        self._set_out: int | None = None
        self._missed = -sys.maxsize
        # The next moment is asked for far more often than it changes.
        self._next: ReleaseKey | None = None
        self._knows_next = False
        # A fingerprint of what was said, by kind and stamp.
        self._contents: dict[tuple[str, int], set[int]] = {}
        self._forgotten = self._resumed_after = -sys.maxsize

    def accept(self, record: Odometry | AnyScan) -> RejectionReason | None:
        """Put a record in its place, or say why it has none."""
        self._knows_next = False
        said = fingerprint(record)
        known = self._contents.get(_place(record), set())
        if said in known:
            return RejectionReason.DUPLICATE
        if isinstance(record, Odometry):
            if known:
                return RejectionReason.CONFLICTING
            if self._is_past(record.stamp):
                return self._too_late(record.stamp)
            insort(self._odometry, record, key=_stamp)
            self.newest = self._odometry[-1].stamp
        else:
            if self._began is not None and record.stamp < self._began:
                return RejectionReason.BEFORE_ODOMETRY
            if self.processed is not None and record.stamp <= self.processed:
                return self._too_late(record.stamp)
            insort(self._scans, record, key=_stamp)
        self._remember(_place(record), said)
        return None

    def next_event(self) -> int | None:
        """Return the stamp of the next event; a scan beyond the newest odometry is none yet."""
        odometry = self._next_odometry()
        if self._scans and self.newest is not None:
            scan = self._scans[0].stamp
            if scan <= self.newest and (odometry is None or scan < odometry):
                return scan
        return odometry

    def next_moment(self, longest_gap: int) -> ReleaseKey | None:
        """
        Return where the next event belongs in the order of all robots, and its stamp.

        That is at its stamp but, within a gap of the odometry that nobody waits for, at its end.

        """
        if not self._knows_next:
            stamp = self.next_event()
            self._next = None if stamp is None else self._moment_of(stamp, longest_gap)
            self._knows_next = True
        return self._next

    def can_be_at(self, moment: ReleaseKey, longest_gap: int) -> bool:
        """Return whether the robot can go from its last event to a moment, by its odometry."""
        _, stamp = moment
        end = self._next_odometry()
        return (
            end is not None and stamp <= end
            and (self.processed is None or self.processed < stamp)
            and self.has_odometry_at(stamp) and self._moment_of(stamp, longest_gap) == moment)

    def miss(self, stamp: int) -> None:
        """Note that the robot was seen at a stamp at which it could not be."""
        self._missed = max(stamp, self._missed)

    def comes_too_late(self, longest_gap: int) -> bool:
        """Return whether the robot could have been, by now, where it was seen in vain."""
        return self.can_be_at((self._missed, self._missed), longest_gap)

    def depends_on(self, stamp: int) -> int:
        """Return the stamp of the odometry that the robot needs for an event."""
        odometry = self._next_odometry()
        return stamp if odometry is None else max(stamp, odometry)

    def has_odometry_at(self, stamp: int) -> bool:
        """Return whether odometry reaches back to an event's stamp or before."""
        return self._reached is not None or self._next_odometry() == stamp

    def skip(self, stamp: int) -> None:
        """Let an event pass that no odometry reaches back to."""
        self.processed = stamp

    def advance(self, stamp: int) -> Motion | None:
        """Move to an event; return how, or None where this is the first odometry."""
        self._knows_next = False
        before, self.processed = self.processed, stamp
        if self._reached is None or before is None:
            self._reached, self._began = self._odometry.pop(0), stamp
            self.pose = self._reached.pose
            return None
        if self._rest is None:
            earlier, self._reached = self._reached, self._odometry.pop(0)
            self._set_out = earlier.stamp
            u, Q = increment(earlier, self._reached, self._settings.odometry_sigma)
            self._rest = u, self._settings.odometry_noise_scale ** 2 * Q
        if stamp == self._reached.stamp:
            (u, Q), self._rest = self._rest, None
            self.pose = self._reached.pose
        else:
            a = (stamp - before) / (self._reached.stamp - before)
            (u, Q), self._rest = split(*self._rest, a)
            self.pose = compose(self.pose, u)
        return Motion(self.name, stamp, u, Q)

    def scans_at(self, stamp: int) -> list[AnyScan]:
        """Return the scans at an event's stamp."""
        if not self._scans or self._scans[0].stamp != stamp:
            return []
        return list(takewhile(lambda scan: scan.stamp == stamp, self._scans))

    def take_scans(self, stamp: int) -> list[AnyScan]:
        """Take out the scans at an event's stamp, with the noise that they are to have."""
        self._knows_next = False
        due = self.scans_at(stamp)
        del self._scans[: len(due)]
        return [self._scaled(scan) for scan in due]

    def take_surplus_scans(self, most: int = MAX_SCANS) -> list[AnyScan]:
        """Take out the oldest scans of those that wait, beyond so many."""
        count = max(len(self._scans) - most, 0)
        if count == 0:
            return []
        self._knows_next = False
        surplus, self._scans = self._scans[:count], self._scans[count:]
        for scan in surplus:
            self._forget(scan)
        return surplus

    def waiting(self) -> int:
        """Return how many records wait for their time."""
        return len(self._odometry) + len(self._scans)

    def leave(self) -> list[Odometry | AnyScan]:
        """Take out all that waits; the next odometry will be a first one."""
        waiting: list[Odometry | AnyScan] = [*self._odometry, *self._scans]
        self._knows_next = False
        self._odometry, self._scans = [], []
        self.newest = self._began = self._reached = self._rest = self._set_out = None
        return waiting

    def resume(self) -> None:
        """Go on from a checkpoint, from which on all input may be sent again."""
        self._resumed_after = self._forgotten

    def _scaled(self, scan: AnyScan) -> AnyScan:
        if isinstance(scan, RobotScan):
            return scaled(scan, self._settings.robot_noise_scale)
        return scaled(scan, self._settings.landmark_noise_scale)

    def _next_odometry(self) -> int | None:
        if self._rest is not None and self._reached is not None:
            return self._reached.stamp
        return self._odometry[0].stamp if self._odometry else None

    def _moment_of(self, stamp: int, longest_gap: int) -> ReleaseKey:
        end = self._next_odometry()
        begin = self._reached.stamp if self._reached and self._rest is None else self._set_out
        if begin is None or end is None or end - begin <= longest_gap:
            return stamp, stamp
        return end, stamp

    def _is_past(self, stamp: int) -> bool:
        """Return whether odometry of a stamp comes too late to be of use."""
        reached = None if self._reached is None else self._reached.stamp
        return any(past is not None and stamp <= past for past in (reached, self.processed))

    def _too_late(self, stamp: int) -> RejectionReason:
        """Tell what is late from what is so old that it may well be input sent again."""
        return RejectionReason.BEFORE_CHECKPOINT if stamp <= self._resumed_after else RejectionReason.LATE

    def _remember(self, place: tuple[str, int], said: int) -> None:
        self._contents.setdefault(place, set()).add(said)
        # What waits is not forgotten, or a duplicate of it would count twice.
        for _ in range(min(len(self._contents) - REMEMBERED, 2)):
            oldest = next(iter(self._contents))
            fingerprints = self._contents.pop(oldest)
            if self._is_past(oldest[1]):
                self._forgotten = max(oldest[1], self._forgotten)
            else:
                self._contents[oldest] = fingerprints

    def _forget(self, scan: AnyScan) -> None:
        said = self._contents.get(_place(scan), set())
        said.discard(fingerprint(scan))
        if not said:
            self._contents.pop(_place(scan), None)


def _place(record: Odometry | AnyScan) -> tuple[str, int]:
    return type(record).__name__, record.stamp


def _stamp(record: Odometry | AnyScan) -> int:
    return record.stamp
