# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Detection of backward time jumps, so that two passes never mix in one estimate.

A bag that loops or a simulation that restarts resets the stamps of all robots. Only stamps are
compared and no clock is read, so a replay detects the same jumps as the live run. The run cannot
use a record that is older than the newest of its kind by more than ``max_delay`` +
``stale_after``. Such a record is held until its cause is known: late data or the clock of a single
robot if the stamps of other robots continue, a second pass if none do.

After a single stray stamp ahead of time, all that follows would look like a second pass. So
odometry that is as far ahead of the whole team is held until the next of its robot shows whether
the team has paused or the stamp is wrong.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

from fej_slam_ros.core.ordering.consumer import Consumer
from fej_slam_ros.core.records import AnyScan, NS, Odometry, PosePrior, TruePose
from fej_slam_ros.core.rejections import RejectionReason

#: Minimum number of odometry records in order, and the minimum time they span [ns], that
#: indicate a second pass; stray stamps satisfy neither.
MIN_RETURN_RECORDS = 5
MIN_RETURN_SPAN = 2 * NS // 5
#: Duration [ns] of a second pass after which silent robots no longer prevent its detection.
MAX_WAIT_FOR_OTHERS = 10 * NS
#: Maximum number of held records; bounds the memory, the oldest ones are passed on as late.
MAX_HELD_RECORDS = 20_000
#: Maximum number of observations in these: 40 MB.
MAX_HELD_OBSERVATIONS = 100_000

#: Maximum number of records since the caller has taken them last.
MAX_SETTLED = 1000

TimedRecord = Odometry | AnyScan | TruePose | PosePrior
#: Robot and kind of record; the stamps of a source increase, except for delays.
Source = tuple[str, type]
#: A record and its time of reception [ns].
Held = tuple[TimedRecord, int | None]


@dataclass(frozen=True, slots=True)
class TimeJump:
    """A backward jump of the stamps of all robots."""

    length: int  #: [ns]
    end: int  #: stamp of the newest odometry before the jump [ns]
    pending: frozenset[Source]  #: sources from which old records may still arrive
    held: list[Held]  #: records since the jump, if another run follows


@dataclass(slots=True)
class BackwardOdometry:
    """Odometry of one robot since its stamps went back."""

    #: newest stamp of the team when they went back [ns], at most the limit above that of the other
    #: robots, since a stray stamp of this robot may be far ahead of all
    begin: int
    first: int = 0  #: first stamp of its latest records in order and without a gap [ns]
    last: int = 0  #: last stamp of these [ns]
    count: int = 0  #: number of these

    def add(self, stamp: int, longest_gap: int) -> None:
        """Add the stamp of a record."""
        if self.count == 0 or abs(stamp - self.last) > longest_gap:
            self.first, self.last, self.count = stamp, stamp, 1
        elif stamp > self.last:
            self.last = stamp
            self.count += 1

    def is_certain(self) -> bool:
        """Return whether the records show a second pass rather than stray stamps."""
        return self.count >= MIN_RETURN_RECORDS and self.last - self.first >= MIN_RETURN_SPAN


class TimeJumpDetector:
    """
    Passes records on to a consumer until time jumps back.

    If it `resets`, another run follows the jump; if not, all later input is rejected.

    """

    def __init__(self, consumer: Consumer, resets: bool = False) -> None:
        self.jump: TimeJump | None = None  #: the jump that ended the run
        self.held: list[Held] = []  #: records that wait until the cause of their stamps is known
        #: records that were held and are passed on since, with the reason if they are rejected;
        #: the caller takes them
        self.settled: deque[tuple[TimedRecord, int | None, RejectionReason | None]] = (
            deque(maxlen=MAX_SETTLED))
        self._consumer = consumer
        self._resets = resets
        self._newest: dict[Source, int] = {}
        self._backward: dict[str, BackwardOdometry] = {}
        # Odometry far ahead of the team. After it, no more of its robot is held until one has come
        # soon after the one before: its odometry may be rare.
        self._ahead: dict[str, tuple[Odometry, int | None]] = {}
        self._have_paused: set[str] = set()
        # Newest stamps of odometry of robots that have sent none since a checkpoint [ns].
        self._before: dict[str, int] = {}
        self._earlier_end = 0
        self._pending: set[Source] = set()

    def add(self, record: TimedRecord, received: int | None) -> bool:
        """Pass on, hold or reject a record; return whether it is passed on, and accepted."""
        newest = self._newest.get(_source(record), record.stamp)
        is_usual = newest <= record.stamp <= newest + self._limit
        if is_usual and not (
                self.jump or self._pending or self._backward or self._ahead or self._before):
            return self._pass_on(record, received)
        if isinstance(record, Odometry):
            self._settle_ahead(record)
            if self._hold_ahead(record, received):
                return False
        if self.jump is not None and self._resets:
            self.jump.held.append((record, received))
        elif self.jump is not None:
            self._reject(record, RejectionReason.AFTER_TIME_JUMP)
        elif self._is_of_earlier_run(record):
            self._reject(record, RejectionReason.BEFORE_TIME_JUMP)
        elif self._is_backward(record):
            self._hold(record, received)
        else:
            return self._pass_on(record, received)
        return False

    def follow(self, jump: TimeJump) -> None:
        """Start a run after a jump of the earlier run, with the records since."""
        self._earlier_end, self._pending = jump.end, set(jump.pending)
        for record, received in jump.held:
            self.add(record, received)

    def count_held(self) -> int:
        """Return the number of records that are held."""
        return len(self.held) + len(self._ahead)

    def has_ended_run(self) -> bool:
        """Return whether time has jumped back and another run is to follow."""
        return self._resets and self.jump is not None

    def forget(self, robot: str) -> None:
        """Reject held records of a robot that left, and ignore its stamps from now on."""
        for record, _ in self._take_held(robot):
            self._reject(record, RejectionReason.LEFT)
        if robot in self._ahead:
            self._reject(self._ahead.pop(robot)[0], RejectionReason.LEFT)
        self._newest = {source: n for source, n in self._newest.items() if source[0] != robot}
        self._before.pop(robot, None)
        self._have_paused.discard(robot)

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        newest = {robot: n for (robot, kind), n in self._newest.items() if kind is Odometry}
        return {
            'held': list(self.held), 'ahead': [*self._ahead.values()],
            'have_paused': sorted(self._have_paused), 'newest': self._before | newest}

    def resume(self, stored: dict[str, Any]) -> None:
        """
        Continue from a checkpoint with the records that were held.

        Those that were behind are passed on as data of this pass, however late: input from before
        a checkpoint may be sent again, which is no second pass.

        """
        for record, received in stored['held']:
            self._consumer.add(record, received)
        self._ahead = {held[0].robot: held for held in stored['ahead']}
        self._have_paused = {*stored['have_paused']}
        self._before = stored['newest']

    def close(self) -> None:
        """Pass on the held records: the input has ended without a second pass."""
        self._pass_on_ahead()
        for robot in list(self._backward):
            self._pass_on_held(robot)

    @property
    def _limit(self) -> int:
        """Return how far a record may be behind the newest of its kind [ns]."""
        settings = self._consumer.settings
        return round((settings.max_delay + settings.stale_after) * NS)

    def _settle_ahead(self, record: Odometry) -> None:
        """Reject held odometry of a robot if its next follows that before it; else pass it on."""
        if record.robot in self._ahead:
            ahead, received = self._ahead.pop(record.robot)
            follows = self._latest(record) - record.stamp <= self._limit
            if follows and ahead.stamp - record.stamp > self._limit:
                self._reject_held(ahead, received, RejectionReason.FUTURE)
            else:
                self._pass_on(ahead, received)

    def _hold_ahead(self, record: Odometry, received: int | None) -> bool:
        """Hold odometry that is far ahead of all, unless it is rare; return whether it is held."""
        robot, limit = record.robot, self._limit
        if record.stamp - self._latest(record) <= limit:
            self._have_paused.discard(robot)
            return False
        now = max([self._time(), *self._before.values()])
        if (
            record.stamp - now <= limit or self._backward
            or robot in self._have_paused
            or self._consumer.settings.is_future(record.stamp, received)
        ):
            return False
        self._have_paused.add(robot)
        self._ahead[robot] = record, received
        return True

    def _latest(self, record: Odometry) -> int:
        """Return the newest stamp of a robot before its next odometry, that of this if none."""
        return self._newest.get(
            _source(record), self._before.get(record.robot, record.stamp))

    def _is_backward(self, record: TimedRecord) -> bool:
        """
        Return whether a record is far behind its source, or behind other robots that went back.

        A robot that is only heard from in a second pass has no stamps of the first. A pose may be
        given for any time.

        """
        begin = min((back.begin for back in self._backward.values()), default=record.stamp)
        return (
            begin - record.stamp > self._limit
            or (not isinstance(record, PosePrior)
                and self._is_behind(record.stamp, _source(record)))
            or (record.robot in self._backward
                and self._is_behind(record.stamp, (record.robot, Odometry))))

    def _is_behind(self, stamp: int, source: Source) -> bool:
        """Return whether a stamp is far behind a source."""
        return self._newest.get(source, stamp) - stamp > self._limit

    def _pass_on(self, record: TimedRecord, received: int | None) -> bool:
        """Pass on a record; odometry may show that only other robots have jumped back."""
        source = _source(record)
        self._pending.discard(source)
        if self._before and isinstance(record, Odometry):
            self._before.pop(record.robot, None)
        if not self._consumer.settings.is_future(record.stamp, received):
            stamp = record.stamp
            if not isinstance(record, Odometry):
                # A stamp ahead of odometry may be a stray one.
                odometry = self._newest.get((record.robot, Odometry), stamp)
                stamp = min(stamp, odometry + self._limit)
            self._newest[source] = max(stamp, self._newest.get(source, stamp))
            if self._backward and isinstance(record, Odometry):
                self._pass_on_held(record.robot)
                self._pass_on_single_jumps()
        return self._consumer.add(record, received) is None

    def _hold(self, record: TimedRecord, received: int | None) -> None:
        if record.robot not in self._backward:
            begin = min(self._time(), self._time(record.robot) + self._limit)
            self._backward[record.robot] = BackwardOdometry(begin)
        backward = self._backward[record.robot]
        self.held.append((record, received))
        while len(self.held) > MAX_HELD_RECORDS or self._has_many_observations(record):
            self._settle(*self.held.pop(0))
        if isinstance(record, Odometry):
            backward.add(record.stamp, self._limit)
            self._detect()

    def _has_many_observations(self, newest: TimedRecord) -> bool:
        """Return whether the held scans, of which one is the newest record, are too large."""
        return isinstance(newest, AnyScan) and len(self.held) > 1 and sum(
            len(held.observations) for held, _ in self.held
            if isinstance(held, AnyScan)) > MAX_HELD_OBSERVATIONS

    def _detect(self) -> None:
        """Set the jump if all robots went back, or some did for long while others are silent."""
        robots = {robot for robot, kind in self._newest if kind is Odometry}
        back = {robot: back for robot, back in self._backward.items() if back.is_certain()}
        if not robots <= back.keys() and all(
                odometry.last - odometry.first <= MAX_WAIT_FOR_OTHERS
                for odometry in back.values()):
            return
        self._pass_on_ahead()
        now = self._time()
        pending = self._newest.keys() - {_source(record) for record, _ in self.held}
        if not self._resets:
            for held in self.held:
                self._reject_held(*held, RejectionReason.AFTER_TIME_JUMP)
            self.held.clear()
        first = min(odometry.first for odometry in back.values())
        self.jump = TimeJump(now - first, now, frozenset(pending), self.held)
        self.held = []

    def _pass_on_single_jumps(self) -> None:
        """Pass on records of robots that went back while others have continued."""
        now = self._time(*self._backward)
        for robot in [r for r, back in self._backward.items() if now - back.begin > self._limit]:
            for record, received in self._take_held(robot):
                self._newest[_source(record)] = record.stamp  # Its stamps continue from there.
                self._settle(record, received)

    def _pass_on_held(self, robot: str) -> None:
        """Pass on the held records of a robot as data of this pass, however late."""
        for held in self._take_held(robot):
            self._settle(*held)

    def _pass_on_ahead(self) -> None:
        """Pass on odometry of robots that have sent none after it."""
        for held in self._ahead.values():
            self._settle(*held)
        self._ahead.clear()

    def _settle(self, record: TimedRecord, received: int | None) -> None:
        """Pass on a record that was held."""
        self.settled.append((record, received, self._consumer.add(record, received)))

    def _reject_held(
        self, record: TimedRecord, received: int | None, reason: RejectionReason
    ) -> None:
        """Reject a record that was held."""
        self._reject(record, reason)
        self.settled.append((record, received, reason))

    def _take_held(self, robot: str) -> list[Held]:
        """Remove and return the held records of a robot."""
        self._backward.pop(robot, None)
        taken = [held for held in self.held if held[0].robot == robot]
        self.held = [held for held in self.held if held[0].robot != robot]
        return taken

    def _is_of_earlier_run(self, record: TimedRecord) -> bool:
        """Return whether a record was in transit when the earlier run ended."""
        return (
            _source(record) in self._pending
            and self._time() + self._limit < record.stamp <= self._earlier_end)

    def _time(self, *without: str) -> int:
        """Return the newest stamp of odometry [ns], without some robots; 0 if there is none."""
        return max((
            n for (robot, kind), n in self._newest.items()
            if kind is Odometry and robot not in without), default=0)

    def _reject(self, record: TimedRecord, reason: RejectionReason) -> None:
        self._consumer.statistics.reject_message(record.robot, record.stamp, reason)


def _source(record: TimedRecord) -> Source:
    return record.robot, type(record)
