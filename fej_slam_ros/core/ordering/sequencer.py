# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Order in time across robots: records in as they arrive, steps out by stamp.

An event at t is held until the odometry of every live robot has passed t by ``max_delay``, so
that what arrives late finds its place and the steps depend on stamps and values only; where a
scan divides an increment, until its own robot's has passed the end of the increment by that. A
robot whose odometry has fallen behind the team's by more than ``stale_after`` holds nobody. When
its link returns, its data is still used, in its own order, and counted as ``released_without``.

A robot that sees others brings them to its step. The observations of those that cannot be there, as
they have been taken further or their odometry does not reach there, are ``other_robot_stale``.

So odometry waits for ``max_delay`` + ``stale_after`` of stamps at most. Of the scans that wait for
odometry, those beyond ``MAX_SCANS`` of a robot are refused.
"""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import sys

from fej_slam_ros.core.ordering.robot_queue import MAX_SCANS, ReleaseKey, RobotQueue
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import AnyScan, merged, NS, Odometry, RobotScan, Scan, Step
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings

#: Stands for the number of a robot that was never of the team.
UNKNOWN_ID = -1


class Sequencer:
    """
    The records of a team on their way to the filter.

    Parameters
    ----------
    settings : the team to begin with, and how long to wait for whom
    ledger : where refusals are counted

    """

    def __init__(self, settings: CommonSettings, statistics: InputStatistics) -> None:
        self._tracks: dict[str, RobotQueue] = {}
        self._left: dict[str, RobotQueue] = {}
        self._ids: dict[str, int] = {}
        self._statistics = statistics
        self._max_delay = round(settings.max_delay * NS)
        self._stale_after = round(settings.stale_after * NS)
        self._future_limit = round(settings.future_limit * NS)
        # What is missing may be on its way for max_delay: only then does a lead say something.
        self._longest_lead = self._stale_after + self._max_delay
        self._begun = False
        self._oldest: int | None = None
        self._newest = -sys.maxsize
        self._heard: dict[str, int] = {}
        self._released: int | None = None
        self.change_team(settings.robots)

    def change_team(self, robots: Sequence[RobotSettings]) -> None:
        """Expect some robots from now on, and refuse what others have left behind."""
        here = {robot.name for robot in robots}
        for name in [name for name in self._tracks if name not in here]:
            # It goes on knowing what was used, so that nothing is used twice.
            self._left[name] = self._tracks.pop(name)
            self._heard.pop(name, None)
            for record in self._left[name].leave():
                self._reject(record, RejectionReason.LEFT)
        self._tracks = {
            robot.name: self._tracks.get(robot.name) or self._left.pop(robot.name, None)
            or RobotQueue(robot) for robot in robots}
        self._ids |= {robot.name: robot.id for robot in robots}

    def add(self, record: Odometry | AnyScan, received: int | None) -> bool:
        """
        Take in one record, and return whether it was not refused at once.

        Parameters
        ----------
        record : odometry or a scan of landmarks or robots
        received : when it was received [ns], on the clock that its stamp is of; None to trust it

        """
        track = self._tracks.get(record.robot)
        if track is None:
            self._reject(record, RejectionReason.UNKNOWN_ROBOT)
        elif received is not None and record.stamp - received > self._future_limit:
            self._reject(record, RejectionReason.FUTURE)
        else:
            rejection_reason = track.accept(record)
            if rejection_reason is not None:
                self._reject(record, rejection_reason)
                return False
            if isinstance(record, Odometry):
                oldest = record.stamp if self._oldest is None else self._oldest
                self._oldest = min(record.stamp, oldest)
                self._newest = max(record.stamp, self._newest)
            if not self._is_live(track):
                self._heard[track.name] = self._newest
            self._refuse_surplus(track)
            return True
        return False

    def take(self) -> Iterator[Step]:
        """Yield the steps that need not wait any longer."""
        self._begun = self._begun or self._may_begin()
        while self._begun:
            # With each message all robots are asked, so the questions must be short.
            live = [track for track in self._tracks.values() if self._is_live(track)]
            ready = live
            if len(live) < len(self._tracks):
                ready = [t for t in self._tracks.values() if not self._is_gathering(t)]
            nexts = self._nexts(ready)
            moment = min(nexts.values(), default=None)
            if moment is None or not self._have_passed(live, moment):
                return
            seen = self._seen_at(moment, ready)
            if self._is_held(moment, live, nexts, seen):
                return
            yield from self._release(moment, nexts, seen)

    def release(self) -> Iterator[Step]:
        """Yield everything that odometry has reached, without waiting for anybody."""
        self._begun = True
        tracks = list(self._tracks.values())
        while nexts := self._nexts(tracks):
            moment = min(nexts.values())
            yield from self._release(moment, nexts, self._seen_at(moment, tracks))

    def close(self) -> None:
        """Refuse the scans that no odometry has reached: the input has ended."""
        for track in self._tracks.values():
            self._refuse_surplus(track, most=0)

    def resume(self) -> None:
        """Go on from a checkpoint, from which on all input may be sent again."""
        for track in self._tracks.values():
            track.resume()

    def waiting(self, robot: str) -> int:
        """Return how many records of a robot wait for their time."""
        return self._tracks[robot].waiting() if robot in self._tracks else 0

    def _may_begin(self) -> bool:
        if self._oldest is None:
            return False
        all_have_spoken = all(track.newest is not None for track in self._tracks.values())
        return all_have_spoken or self._newest - self._oldest > self._stale_after

    def _is_live(self, track: RobotQueue) -> bool:
        return track.newest is not None and self._newest - track.newest <= self._longest_lead

    def _have_passed(self, live: Iterable[RobotQueue], moment: ReleaseKey) -> bool:
        """Return whether no live robot may still send something of a moment."""
        end = moment[0] + self._max_delay
        return all(track.newest is not None and track.newest > end for track in live)

    def _is_held(
        self, moment: ReleaseKey, live: Iterable[RobotQueue], nexts: Mapping[RobotQueue, ReleaseKey],
        seen: Container[str],
    ) -> bool:
        """Return whether who takes part in a step may still send odometry that it depends on."""
        at, _ = moment
        return any(
            not self._has_passed(track, track.depends_on(at)) for track in live
            if track.name in seen or (track in nexts and nexts[track][1] == at))

    def _is_gathering(self, track: RobotQueue) -> bool:
        """Return whether a robot that fell behind sends again, so that its events wait for it."""
        if self._is_live(track):
            return False
        stamp = track.next_event()
        if stamp is None:
            return False
        if self._has_passed(track, track.depends_on(stamp)):
            return False
        heard = self._heard.get(track.name)
        return heard is not None and self._newest - heard <= self._stale_after

    def _has_passed(self, track: RobotQueue, stamp: int) -> bool:
        newest = track.newest
        return newest is not None and newest > stamp + self._max_delay

    def _nexts(self, tracks: Iterable[RobotQueue]) -> dict[RobotQueue, ReleaseKey]:
        """Return where the next event of each robot belongs that has one."""
        moments = ((track, track.next_moment(self._stale_after)) for track in tracks)
        return {track: moment for track, moment in moments if moment is not None}

    def _seen_at(self, moment: ReleaseKey, tracks: Iterable[RobotQueue]) -> set[str]:
        """Return the names of the robots that others see at a moment."""
        return {
            observation.seen for track in tracks for scan in track.scans_at(moment[1])
            if isinstance(scan, RobotScan) and track.can_be_at(moment, self._stale_after)
            for observation in scan.observations}

    def _release(
        self, moment: ReleaseKey, nexts: Mapping[RobotQueue, ReleaseKey], seen: Container[str]
    ) -> Iterator[Step]:
        """Yield the step at a moment, unless all that was there is refused."""
        _, stamp = moment
        here: dict[str, RobotQueue] = {}
        for track, its_next in nexts.items():
            has_event = its_next == moment
            if has_event and not track.has_odometry_at(stamp):
                for scan in track.take_scans(stamp):
                    self._reject(scan, RejectionReason.BEFORE_ODOMETRY)
                track.skip(stamp)
            elif has_event or (track.name in seen and track.can_be_at(moment, self._stale_after)):
                here[track.name] = track
        if here:
            yield self._step(stamp, here)

    def _step(self, stamp: int, here: Mapping[str, RobotQueue]) -> Step:
        """Return the step of the robots that are here at a stamp."""
        due = {name: track.take_scans(stamp) for name, track in here.items()}
        scans = [[s for s in at if isinstance(s, Scan)] for at in due.values()]
        robot_scans = [[s for s in at if isinstance(s, RobotScan)] for at in due.values()]
        is_behind = self._released is not None and stamp <= self._released
        self._statistics.released_without.update(
            name for name, track in here.items()
            if is_behind or track.comes_too_late(self._stale_after))
        self._released = stamp if self._released is None else max(stamp, self._released)
        motions = {name: track.advance(stamp) for name, track in here.items()}
        return Step(
            stamp,
            tuple(name for name, motion in motions.items() if motion is None),
            tuple(motion for motion in motions.values() if motion is not None),
            tuple(merged(at) for at in scans if at),
            {name: track.pose for name, track in here.items()},
            tuple(self._among(here, merged(at)) for at in robot_scans if at))

    def _among(self, here: Container[str], scan: RobotScan) -> RobotScan:
        """Return what a robot saw of those that are here, and refuse what it saw of others."""
        for observation in scan.observations:
            if observation.seen not in here:
                self._statistics.reject(Rejection(
                    scan.robot, scan.stamp, RejectionReason.OTHER_ROBOT_STALE,
                    id=self._ids.get(observation.seen, UNKNOWN_ID), seen=observation.seen))
                if observation.seen in self._tracks:
                    self._tracks[observation.seen].miss(scan.stamp)
        return replace(scan, observations=tuple(s for s in scan.observations if s.seen in here))

    def _refuse_surplus(self, track: RobotQueue, most: int = MAX_SCANS) -> None:
        """Refuse the oldest scans that wait for odometry, beyond so many."""
        never = RejectionReason.BEFORE_ODOMETRY if track.newest is None else RejectionReason.AFTER_ODOMETRY
        for scan in track.take_surplus_scans(most):
            self._reject(scan, never)

    def _reject(self, record: Odometry | AnyScan, reason: RejectionReason) -> None:
        delay = None
        if reason is RejectionReason.LATE:
            delay = self._newest - record.stamp
        self._statistics.reject(Rejection(record.robot, record.stamp, reason, delay=delay))
