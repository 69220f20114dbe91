# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Order in time within one robot: from its records to its events."""

from bisect import insort
from collections.abc import Iterable, Sequence
from itertools import takewhile
import sys
from typing import NamedTuple

from fej_slam_ros.core.ordering.corrected_observations import corrected
from fej_slam_ros.core.ordering.odometry_increments import OdometryIncrements
from fej_slam_ros.core.ordering.record_memory import identity, RecordIdentity, RecordMemory
from fej_slam_ros.core.records import AnyScan, Motion, NS, Odometry
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings

#: Maximum number of scans of a robot that wait for odometry; bounds the memory where odometry
#: stops but scans do not.
MAX_QUEUED_SCANS = 10_000
#: Maximum number of observations in these, unless the newest scan alone has more: 40 MB.
MAX_QUEUED_OBSERVATIONS = 100_000


class ReleaseKey(NamedTuple):
    """Position of an event in the order of all robots; keys compare in this order."""

    #: stamp [ns] that the odometry of all live robots must pass: that of the event, or the end of
    #: the gap in odometry that contains the event
    due: int
    stamp: int  #: stamp of the event [ns]


class RobotQueue:
    """Waiting records of one robot, in the order of their stamps."""

    def __init__(self, settings: RobotSettings, longest_gap: int) -> None:
        self.name = settings.name
        self.odometry = OdometryIncrements(settings)  #: the waiting odometry, and the progress
        #: position of the next event in the order of all robots, None without one
        self.next_key: ReleaseKey | None = None
        self._settings = settings
        # Longest increment [ns] within which events are due at their own stamps.
        self._longest_gap = longest_gap
        self._scans: list[AnyScan] = []
        self._observations = 0  # in these scans
        self._memory = RecordMemory()
        self._resumed_after = self._missed = -sys.maxsize

    def change_settings(self, settings: RobotSettings, longest_gap: int) -> None:
        """Use other noise of the robot, and another limit of gaps, from its next event on."""
        self._settings = self.odometry.settings = settings
        self._longest_gap = longest_gap
        self._update_next_key()

    def accept(
        self, record: Odometry | AnyScan, max_observations: int
    ) -> RejectionReason | None:
        """Insert a record by its stamp, or return the reason to reject it."""
        received = identity(record)
        reason = self._reason_to_reject(record, received, max_observations)
        if reason is not None:
            return reason
        if isinstance(record, Odometry):
            self.odometry.add(record)
        else:
            insort(self._scans, record, key=lambda scan: scan.stamp)
            self._observations += len(record.observations)
        self._memory.add(received, self.odometry.is_past)
        self._update_next_key()
        return None

    def next_event(self) -> int | None:
        """Return the stamp of the next event; scans after the newest odometry wait for it."""
        odometry, newest = self.odometry.next_stamp(), self.odometry.newest
        if self._scans and newest is not None:
            scan = self._scans[0].stamp
            if scan <= newest and (odometry is None or scan < odometry):
                return scan
        return odometry

    def can_be_at(self, key: ReleaseKey) -> bool:
        """Return whether the odometry of the robot leads from its last event to a key."""
        end, processed = self.odometry.next_stamp(), self.odometry.processed
        return (
            end is not None and key.stamp <= end
            and (processed is None or processed < key.stamp)
            and self.odometry.reaches_back_to(key.stamp) and self._key(key.stamp) == key)

    def miss(self, stamp: int) -> None:
        """Record that the robot was observed at a stamp that its odometry did not reach."""
        self._missed = max(stamp, self._missed)

    def reaches_missed_stamp(self) -> bool:
        """Return whether the odometry that an observation missed has arrived since."""
        return self.can_be_at(ReleaseKey(self._missed, self._missed))

    def skip(self, stamp: int) -> list[AnyScan]:
        """Pass an event before the first odometry; return its scans, which cannot be used."""
        self.odometry.processed = stamp
        return self.take_scans(stamp)

    def advance(self, stamp: int) -> Motion | None:
        """Move to an event; return the motion, or None at the first odometry."""
        motion = self.odometry.advance(stamp)
        self._update_next_key()
        return motion

    def scans_at(self, stamp: int) -> list[AnyScan]:
        """Return the scans at the stamp of the next event."""
        if not self._scans or self._scans[0].stamp != stamp:
            return []
        return list(takewhile(lambda scan: scan.stamp == stamp, self._scans))

    def take_scans(self, stamp: int) -> list[AnyScan]:
        """Remove and return the scans at the stamp of an event, corrected."""
        scans = self.scans_at(stamp)
        if not scans:
            return scans
        del self._scans[: len(scans)]
        self._observations -= count_observations(scans)
        self._update_next_key()
        return [corrected(scan, self._settings) for scan in scans]

    def take_surplus_scans(self, most: int, size: int = 0, rate: float = 0.0) -> list[AnyScan]:
        """
        Remove and return the oldest waiting scans beyond the limits.

        Parameters
        ----------
        most : maximum number of waiting scans that stay
        size : minimum number of observations of the scans that are taken and counted
        rate : rate of the scans by their stamps [Hz] up to which none is taken

        """
        is_small = len(self._scans) <= most and self._observations <= MAX_QUEUED_OBSERVATIONS
        if is_small or self._rate_of_scans() < rate:
            return []
        scans = [scan for scan in self._scans if len(scan.observations) >= size]
        surplus = scans[:max(len(scans) - most, 0)]
        rest = self._observations - count_observations(surplus)
        for scan in scans[len(surplus):-1]:
            if rest <= MAX_QUEUED_OBSERVATIONS:
                break
            surplus.append(scan)
            rest -= len(scan.observations)
        self._drop(surplus)
        return surplus

    def waiting(self) -> int:
        """Return the number of waiting records."""
        return len(self.odometry.waiting) + len(self._scans)

    def leave(self) -> list[Odometry | AnyScan]:
        """Remove and return all waiting records; stamps that were used stay used."""
        waiting: list[Odometry | AnyScan] = [*self.odometry.waiting, *self._scans]
        self._scans, self._observations = [], 0
        self.odometry.clear()
        self._update_next_key()
        return waiting

    def resume(self) -> None:
        """Continue from a checkpoint, after which all input may be sent again."""
        self._resumed_after = self._memory.forgotten

    def _reason_to_reject(
        self, record: Odometry | AnyScan, received: RecordIdentity, max_observations: int
    ) -> RejectionReason | None:
        """Return why a record cannot be used, None if it can."""
        if self._memory.contains(received):
            return RejectionReason.DUPLICATE
        if isinstance(record, Odometry):
            if self._memory.contains_stamp(received):
                return RejectionReason.CONFLICTING
            return self._too_late(record.stamp) if self.odometry.is_past(record.stamp) else None
        first, processed = self.odometry.first, self.odometry.processed
        if first is not None and record.stamp < first:
            return RejectionReason.BEFORE_ODOMETRY
        if processed is not None and record.stamp <= processed:
            return self._too_late(record.stamp)
        return RejectionReason.TOO_LARGE if len(record.observations) > max_observations else None

    def _rate_of_scans(self) -> float:
        duration = self._scans[-1].stamp - self._scans[0].stamp
        return (len(self._scans) - 1) * NS / max(duration, 1)

    def _drop(self, scans: Sequence[AnyScan]) -> None:
        if scans:
            dropped = {id(scan) for scan in scans}
            self._scans = [scan for scan in self._scans if id(scan) not in dropped]
            self._observations -= count_observations(scans)
            for scan in scans:
                self._memory.remove(identity(scan))
            self._update_next_key()

    def _update_next_key(self) -> None:
        """Set `next_key`, which is read by each step of all robots, after a change."""
        stamp = self.next_event()
        self.next_key = None if stamp is None else self._key(stamp)

    def _key(self, stamp: int) -> ReleaseKey:
        return ReleaseKey(self.odometry.due(stamp, self._longest_gap), stamp)

    def _too_late(self, stamp: int) -> RejectionReason:
        """Return late, or before_checkpoint where the record may be input sent again."""
        is_old = stamp <= self._resumed_after
        return RejectionReason.BEFORE_CHECKPOINT if is_old else RejectionReason.LATE


def count_observations(scans: Iterable[AnyScan]) -> int:
    """Return the number of observations in some scans."""
    return sum(len(scan.observations) for scan in scans)
