# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Order in time across robots: records in order of arrival become steps in order of stamp.

An event, odometry or a scan, is held until the odometry of every live robot has passed its stamp
by ``max_delay``; then nothing in time can still precede it, and the steps depend on stamps and
values only. A scan that divides an increment also waits until the odometry of its own robot has
passed the end of the increment by ``max_delay``. Example with max_delay = 0.1 s::

    stamp [s]      0.0     0.1     0.2     0.3     0.4
    r1 odometry     o-------o-------o-------o-------o
    r1 scan                     s                        at 0.15, divides the increment to 0.2
                                    |<----->|            r1 must pass 0.2 + max_delay
    r2 odometry     o-------------o-------------o        at 0, 0.175 and 0.35
                                |<----->|                r2 must pass 0.15 + max_delay
    scan released                                   ^    when odometry 0.4 of r1 arrives

A robot is live until the newest odometry of the team leads its own by more than ``stale_after`` +
``max_delay``. Events of a robot that is not live are released without waiting for it; its later
data are still used, in their own order, and counted as ``released_without``. Odometry thus waits
for at most ``max_delay`` + ``stale_after``; of scans that wait for odometry, the oldest beyond
``MAX_QUEUED_SCANS`` or ``MAX_QUEUED_OBSERVATIONS`` are rejected.

A robot-to-robot observation brings the observed robot to the step of its observer. If the observed
robot was already advanced further, or its odometry does not reach the stamp, the observation is
rejected as ``other_robot_stale``.
"""

from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import sys

from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.robot_queue import (
    count_observations, MAX_QUEUED_SCANS, ReleaseKey, RobotQueue)
from fej_slam_ros.core.pieces import must_end
from fej_slam_ros.core.records import (
    AnyScan, fingerprint, merged, NS, Odometry, RobotScan, Scan, ScanT, Step)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings

#: ID in rejections of an observed robot that was never in the team.
UNKNOWN_ROBOT_ID = -1


class Sequencer:
    """Queues of all robots, and the release of their events as steps."""

    def __init__(self, settings: CommonSettings, statistics: InputStatistics) -> None:
        self.ids: dict[str, int] = {}  #: of each robot that is or was in the team, by name
        self.is_waiting = False  #: whether there is no step to take before more input
        self._queues: dict[str, RobotQueue] = {}
        self._left: dict[str, RobotQueue] = {}
        self._statistics = statistics
        self._settings = settings
        # The robot that has to send before the next step, and the key of that step, while all
        # robots are live.
        self._awaited: tuple[str, ReleaseKey] | None = None
        # Limits in ns. Data may be delayed by max_delay before a robot counts as silent.
        self._max_delay = self._stale_after = self._longest_lead = 0
        self.change_limits(settings)
        self._begun = False
        self._oldest: int | None = None  # stamp of the oldest odometry of the team [ns]
        self._newest = -sys.maxsize  # that of the newest
        # That of the newest, at the latest message of each robot that was not live.
        self._heard: dict[str, int] = {}
        self._released: int | None = None  # newest stamp of a step [ns]
        self.change_team(settings.robots)

    def change_limits(self, settings: CommonSettings) -> None:
        """Use other limits of delays; `change_team` is to follow and passes them to the queues."""
        self.is_waiting = False
        self._settings = settings
        self._max_delay = round(settings.max_delay * NS)
        self._stale_after = round(settings.stale_after * NS)
        self._longest_lead = self._stale_after + self._max_delay

    def change_team(self, robots: Sequence[RobotSettings]) -> None:
        """Change the team or its noise; waiting records of robots that leave are rejected."""
        remaining = {robot.name for robot in robots}
        leaving = [name for name in self._queues if name not in remaining]
        for name in leaving:
            # The queue is kept, so that a robot that returns uses no record twice.
            self._left[name] = self._queues.pop(name)
            self._heard.pop(name, None)
            for record in self._left[name].leave():
                self._reject(record, RejectionReason.LEFT)
        if leaving:
            # One that was ahead must not make the others count as silent.
            self._newest = max((
                newest for queue in self._queues.values()
                if (newest := queue.odometry.newest) is not None), default=-sys.maxsize)
        self._queues = {
            robot.name: self._queues.get(robot.name) or self._left.pop(robot.name, None)
            or RobotQueue(robot, self._stale_after) for robot in robots}
        for robot in robots:
            self._queues[robot.name].change_settings(robot, self._stale_after)
        self.is_waiting = False
        self.ids |= {robot.name: robot.id for robot in robots}

    def add(self, record: Odometry | AnyScan, received: int | None) -> RejectionReason | None:
        """
        Insert a record; return the reason if it is rejected, None if it is accepted.

        `received` is the time of reception [ns], on the clock of the stamp; None to trust that.

        """
        reason = self._insert(record, received)
        if reason is not None:
            self._reject(record, reason)
        return reason

    def take(self) -> Iterator[Step]:
        """Yield the steps that need not wait any longer."""
        if self.is_waiting:
            return
        self._awaited = None
        self._begun = self._begun or self._may_begin()
        while self._begun:
            # Each step asks all robots a few times: simple expressions, no calls.
            queues: Collection[RobotQueue] = self._queues.values()
            oldest = self._newest - self._longest_lead
            live = [
                newest for queue in queues
                if (newest := queue.odometry.newest) is not None and newest >= oldest]
            are_all_live = len(live) == len(queues)
            if not are_all_live:
                queues = [queue for queue in queues if not self._is_catching_up(queue)]
            key = min(filter(None, [queue.next_key for queue in queues]), default=None)
            if key is None:
                break
            slowest = min(live, default=sys.maxsize)
            if slowest <= key.due + self._max_delay:
                if are_all_live:
                    self._awaited = next(
                        queue.name for queue in queues if queue.odometry.newest == slowest), key
                break
            of_step, observed = _step_members(key, queues)
            if self._must_wait(key, queues, observed):
                break
            yield from self._release(key, of_step, observed)
        self.is_waiting = True

    def release(self) -> Iterator[Step]:
        """Yield all steps that odometry has reached, without waiting for any robot."""
        self._begun = True
        queues = list(self._queues.values())
        while keys := [queue.next_key for queue in queues if queue.next_key is not None]:
            if must_end():
                self._abandon()
                return
            key = min(keys)
            yield from self._release(key, *_step_members(key, queues))

    def close(self) -> None:
        """Reject the scans that no odometry has reached: the input has ended."""
        self.is_waiting = False
        for queue in self._queues.values():
            self._reject_surplus(queue, most=0)

    def shed(self, size: int, most: int, rate: float) -> None:
        """
        Reject waiting scans of each robot.

        Parameters
        ----------
        size : minimum number of observations of scans that are rejected, but for the newest
        most : maximum number of scans that stay of a robot that sends more than a rate
        rate : that rate [Hz]

        """
        self.is_waiting = False
        for queue in self._queues.values():
            large = queue.take_surplus_scans(most=1, size=size)
            for scan in [*large, *queue.take_surplus_scans(most=most, rate=rate)]:
                self._reject(scan, RejectionReason.OVERLOAD)

    def resume(self) -> None:
        """Continue from a checkpoint, after which all input may be sent again."""
        self.is_waiting = False
        for queue in self._queues.values():
            queue.resume()

    def waiting(self, robot: str) -> int:
        """Return the number of waiting records of a robot."""
        return self._queues[robot].waiting() if robot in self._queues else 0

    def newest_odometry(self, robot: str) -> int | None:
        """Return the stamp [ns] of the newest accepted odometry of a robot, None without any."""
        return self._queues[robot].odometry.newest if robot in self._queues else None

    def odometry_span(self, robot: str) -> tuple[int, int]:
        """Return the stamps [ns] of the first and the newest odometry of a robot of the team."""
        odometry = self._queues[robot].odometry
        if odometry.first is None or odometry.newest is None:
            return sys.maxsize, sys.maxsize
        return odometry.first, odometry.newest

    def has_processed(self, robot: str, stamp: int) -> bool:
        """Return whether a step of a robot was at a stamp [ns] or later."""
        processed = self._queues[robot].odometry.processed
        return processed is not None and stamp <= processed

    def _insert(self, record: Odometry | AnyScan, received: int | None) -> RejectionReason | None:
        queue = self._queues.get(record.robot)
        if queue is None:
            return RejectionReason.UNKNOWN_ROBOT
        if self._settings.is_future(record.stamp, received):
            return RejectionReason.FUTURE
        reason = queue.accept(record, self._settings.max_observations)
        if reason is None:
            if isinstance(record, Odometry):
                oldest = record.stamp if self._oldest is None else self._oldest
                self._oldest = min(record.stamp, oldest)
                self._newest = max(record.stamp, self._newest)
            if not self._is_live(queue):
                self._heard[queue.name] = self._newest
            self._reject_surplus(queue)
            self.is_waiting = self.is_waiting and self._is_awaiting_another(queue)
        return reason

    def _is_awaiting_another(self, queue: RobotQueue) -> bool:
        """Return whether the steps still wait for a robot after a record of another robot."""
        if self._awaited is None:
            return False
        awaited, key = self._awaited
        return (
            queue.name != awaited and self._is_live(self._queues[awaited])
            and (queue.next_key is None or queue.next_key >= key))

    def _abandon(self) -> None:
        """Reject all waiting records: the process ends before they can be used."""
        for queue in self._queues.values():
            for record in queue.leave():
                self._reject(record, RejectionReason.INTERRUPTED)

    def _may_begin(self) -> bool:
        """Return whether all robots have sent odometry, or the first leads by stale_after."""
        if self._oldest is None:
            return False
        all_sent = all(queue.odometry.newest is not None for queue in self._queues.values())
        return all_sent or self._newest - self._oldest > self._stale_after

    def _is_live(self, queue: RobotQueue) -> bool:
        newest = queue.odometry.newest
        return newest is not None and self._newest - newest <= self._longest_lead

    def _has_passed(self, queue: RobotQueue, stamp: int) -> bool:
        """Return whether a robot has sent all its data up to a stamp, delayed data included."""
        newest = queue.odometry.newest
        return newest is not None and newest > stamp + self._max_delay

    def _must_wait(
        self, key: ReleaseKey, queues: Iterable[RobotQueue], observed: Iterable[str]
    ) -> bool:
        """Return whether a live robot of a step may still send odometry that the step needs."""
        of_step = [queue for queue in queues if queue.next_key and queue.next_key.stamp == key.due]
        of_step += [self._queues[name] for name in observed if name in self._queues]
        return any(
            self._is_live(queue)
            and not self._has_passed(queue, queue.odometry.needed_stamp(key.due))
            for queue in of_step)

    def _is_catching_up(self, queue: RobotQueue) -> bool:
        """Return whether a robot that was not live sends again, so that its events are held."""
        stamp = queue.next_event()
        if self._is_live(queue) or stamp is None:
            return False
        if self._has_passed(queue, queue.odometry.needed_stamp(stamp)):
            return False
        heard = self._heard.get(queue.name)
        return heard is not None and self._newest - heard <= self._stale_after

    def _release(
        self, key: ReleaseKey, of_step: Iterable[RobotQueue], observed: Container[str]
    ) -> Iterator[Step]:
        """Yield the step at a key, unless everything in it is rejected."""
        self.is_waiting = False
        present: dict[str, RobotQueue] = {}
        for queue in of_step:
            has_event = queue.next_key == key
            if has_event and not queue.odometry.reaches_back_to(key.stamp):
                for scan in queue.skip(key.stamp):
                    self._reject(scan, RejectionReason.BEFORE_ODOMETRY)
            elif has_event or (queue.name in observed and queue.can_be_at(key)):
                present[queue.name] = queue
        if present:
            yield self._step(key.stamp, present)

    def _step(self, stamp: int, present: Mapping[str, RobotQueue]) -> Step:
        taken = [found for queue in present.values() if (found := self._take_scans(queue, stamp))]
        is_behind = self._released is not None and stamp <= self._released
        for name, queue in present.items():
            if is_behind or queue.reaches_missed_stamp():
                self._statistics.released_without[name] += 1
        self._released = stamp if self._released is None else max(stamp, self._released)
        arrivals, motions = [], []
        for name, queue in present.items():
            motion = queue.advance(stamp)
            if motion is None:
                arrivals.append(name)
                continue
            motions.append(motion)
            if motion.impossible:
                # Of the message: a scan that divides its increment is earlier.
                end = queue.odometry.used_stamp(stamp)
                self._statistics.reject(Rejection(name, end, RejectionReason.IMPOSSIBLE_MOTION))
        odometry = {name: queue.odometry.pose for name, queue in present.items()}
        robot_scans = _merged_scans(RobotScan, taken)
        return Step(
            stamp, tuple(arrivals), tuple(motions), _merged_scans(Scan, taken), odometry,
            tuple([self._without_absent(present, scan) for scan in robot_scans]))

    def _take_scans(self, queue: RobotQueue, stamp: int) -> Sequence[AnyScan]:
        """Return the scans of a robot at a stamp; reject those that are too large together."""
        scans, room = queue.take_scans(stamp), self._settings.max_observations
        # One scan that is too large was rejected when it arrived.
        if len(scans) < 2 or count_observations(scans) <= room:
            return scans
        kept = []
        # By content, so that the order of arrival has no effect.
        for scan in sorted(scans, key=fingerprint):
            if len(scan.observations) <= room:
                kept.append(scan)
                room -= len(scan.observations)
            else:
                self._reject(scan, RejectionReason.TOO_LARGE)
        return kept

    def _without_absent(self, present: Container[str], scan: RobotScan) -> RobotScan:
        """Return a scan without observations of absent robots, which are rejected."""
        for name in (observation.observed for observation in scan.observations):
            if name not in present:
                self._statistics.reject(Rejection(
                    scan.robot, scan.stamp, RejectionReason.OTHER_ROBOT_STALE,
                    id=self.ids.get(name, UNKNOWN_ROBOT_ID), observed=name))
                if name in self._queues:
                    self._queues[name].miss(scan.stamp)
        return replace(
            scan, observations=tuple(o for o in scan.observations if o.observed in present))

    def _reject_surplus(self, queue: RobotQueue, most: int = MAX_QUEUED_SCANS) -> None:
        """Reject the oldest scans that wait for odometry, beyond a number."""
        reason = RejectionReason.AFTER_ODOMETRY
        if queue.odometry.newest is None:
            reason = RejectionReason.BEFORE_ODOMETRY
        for scan in queue.take_surplus_scans(most):
            self._reject(scan, reason)

    def _reject(self, record: Odometry | AnyScan, reason: RejectionReason) -> None:
        delay = self._newest - record.stamp if reason is RejectionReason.LATE else None
        self._statistics.reject(Rejection(record.robot, record.stamp, reason, delay=delay))


def _merged_scans(kind: type[ScanT], taken: Iterable[Sequence[AnyScan]]) -> tuple[ScanT, ...]:
    """Return the scans of a kind among those of each robot at one stamp, one for each robot."""
    of_robots = ([scan for scan in scans if isinstance(scan, kind)] for scans in taken)
    return tuple([merged(scans) for scans in of_robots if scans])


def _step_members(
    key: ReleaseKey, queues: Iterable[RobotQueue]
) -> tuple[list[RobotQueue], set[str]]:
    """Return the robots with an event at a key or observed there, and the names of the latter."""
    at_key = [queue for queue in queues if queue.next_key == key]
    observed = {
        observation.observed for queue in at_key for scan in queue.scans_at(key.stamp)
        if isinstance(scan, RobotScan) and queue.can_be_at(key)
        for observation in scan.observations}
    if observed:
        return [
            queue for queue in queues if queue.next_key == key or queue.name in observed], observed
    return at_key, observed
