# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Order in time across robots: records in as they arrive, steps out by stamp.

An event at t is held until the odometry of every live robot has passed t by ``max_delay``, so
that what arrives late finds its place and the steps depend on stamps and values only. A robot
whose odometry has fallen behind the team's by more than ``stale_after`` holds nobody; its data is
still used in its own order when it comes, and counted as ``released_without``.
"""

from collections.abc import Iterator

from fej_slam_ros.core.ledger import Ledger
from fej_slam_ros.core.records import Motion, Odometry, Refusal, Rejection, Scan, Step
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.core.track import merged, NS, Track


class Stream:
    """
    The records of a team on their way to the filter.

    Parameters
    ----------
    settings : the team, and how long to wait for whom
    ledger : where refusals are counted

    """

    def __init__(self, settings: Settings, ledger: Ledger) -> None:
        self._tracks = {robot.name: Track(robot) for robot in settings.robots}
        self._ledger = ledger
        self._max_delay = round(settings.max_delay * NS)
        self._stale_after = round(settings.stale_after * NS)
        self._future_limit = round(settings.future_limit * NS)
        self._begun = False
        self._oldest: int | None = None
        self._released: int | None = None

    def add(self, record: Odometry | Scan, received: int | None) -> None:
        """
        Take in one record.

        Parameters
        ----------
        record : odometry or a scan
        received : when it was received [ns], on the clock that its stamp is of; None to trust it

        """
        track = self._tracks.get(record.robot)
        if track is None:
            self._refuse(record, Refusal.UNKNOWN_ROBOT)
        elif received is not None and record.stamp - received > self._future_limit:
            self._refuse(record, Refusal.FUTURE)
        else:
            refusal = track.accept(record)
            if refusal is not None:
                self._refuse(record, refusal)
            elif isinstance(record, Odometry):
                oldest = record.stamp if self._oldest is None else self._oldest
                self._oldest = min(record.stamp, oldest)

    def take(self) -> Iterator[Step]:
        """Yield the steps that need not wait any longer."""
        self._begun = self._begun or self._may_begin()
        while self._begun:
            stamp = self._next_event()
            if stamp is None or self._held(stamp):
                return
            yield from self._release(stamp)

    def release(self) -> Iterator[Step]:
        """Yield everything that odometry has reached, without waiting for anybody."""
        self._begun = True
        while (stamp := self._next_event()) is not None:
            yield from self._release(stamp)

    def close(self) -> None:
        """Refuse the scans that no odometry has reached: the input has ended."""
        for track in self._tracks.values():
            never = Refusal.BEFORE_ODOMETRY if track.newest is None else Refusal.AFTER_ODOMETRY
            for scan in track.take_waiting_scans():
                self._refuse(scan, never)

    def waiting(self, robot: str) -> int:
        """Return how many records of a robot wait for their time."""
        return self._tracks[robot].waiting() if robot in self._tracks else 0

    def _may_begin(self) -> bool:
        if self._oldest is None:
            return False
        return (
            all(track.newest is not None for track in self._tracks.values())
            or self._newest() - self._oldest > self._stale_after)

    def _next_event(self) -> int | None:
        events = (track.next_event() for track in self._tracks.values())
        return min((stamp for stamp in events if stamp is not None), default=None)

    def _held(self, stamp: int) -> bool:
        """Return whether a live robot may still send something for this stamp."""
        behind = self._newest() - self._stale_after
        return any(
            behind <= track.newest <= stamp + self._max_delay
            for track in self._tracks.values() if track.newest is not None)

    def _newest(self) -> int:
        return max(t.newest for t in self._tracks.values() if t.newest is not None)

    def _release(self, stamp: int) -> Iterator[Step]:
        """Yield the step at a stamp, unless all that was there is refused."""
        arrivals: list[str] = []
        motions: list[Motion] = []
        scans: list[Scan] = []
        for track in self._tracks.values():
            if track.next_event() != stamp:
                continue
            due = track.take_scans(stamp)
            if not track.has_odometry_at(stamp):
                for scan in due:
                    self._refuse(scan, Refusal.BEFORE_ODOMETRY)
                continue
            motion = track.advance(stamp)
            if motion is None:
                arrivals.append(track.name)
            else:
                motions.append(motion)
            if due:
                scans.append(merged(due))
            if self._released is not None and stamp <= self._released:
                self._ledger.released_without[track.name] += 1
        if arrivals or motions:
            self._released = stamp if self._released is None else max(stamp, self._released)
            yield Step(stamp, tuple(arrivals), tuple(motions), tuple(scans))

    def _refuse(self, record: Odometry | Scan, reason: Refusal) -> None:
        delay = None
        if reason is Refusal.LATE:
            delay = self._newest() - record.stamp
        self._ledger.refuse(Rejection(record.robot, record.stamp, reason, delay=delay))
