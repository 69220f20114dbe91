# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time that jumps back: two passes through the same time never meet in one estimate.

A bag that loops and a simulation that starts again send the stamps of all robots back. Stamps
alone decide, not a clock, so that a replay finds what a live run does. What lies behind its own
kind by more than ``max_delay`` + ``stale_after`` is of no more use to the run. It is held until it
is known what it is: late, or of one robot whose clock has jumped, where the others go on in the
old time; the beginning of a second pass, where no robot does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import AnyScan, NS, Odometry, PosePrior, Record, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings

#: A robot is in a second pass when so much of its odometry has come from there, in order.
CONFIRMED = 5
#: And over so long a time [ns].
SPAN = 2 * NS // 5
#: Robots of which nothing comes any more are waited for so long [ns].
PATIENCE = 10 * NS
#: So many records are held at most; beyond that the oldest is late.
MAX_HELD = 20_000

TimedRecord = Odometry | AnyScan | TruePose | PosePrior
#: Records of one robot and one kind come in the order of their stamps, but for delays.
Source = tuple[str, type]
#: A record and when it was received.
Held = tuple[TimedRecord, int | None]


class Consumer(Protocol):
    """What gets records, an estimator or a smoother, and counts what is refused."""

    statistics: InputStatistics
    truth: RecordedTruth

    @property
    def settings(self) -> CommonSettings:
        """Return the settings of the team."""

    @property
    def robots(self) -> Mapping[str, RobotSettings]:
        """Return the present team by name."""

    @property
    def needs_ids(self) -> bool:
        """Return whether an observation without identity is of no use."""

    def add(self, record: Record, received: int | None = None) -> bool:
        """Take in a record, and return whether it was not refused at once."""


@dataclass(frozen=True, slots=True)
class TimeJump:
    """
    The time of all robots has jumped back.

    Attributes
    ----------
    by : how far [ns]
    end : stamp of the newest odometry before [ns]
    pending : of what there may still be something on its way from before
    held : what has come since, if that is not refused

    """

    by: int
    end: int
    pending: frozenset[Source]
    held: Sequence[Held]


@dataclass(slots=True)
class Return:
    """
    How a robot has gone back.

    Attributes
    ----------
    left : time of the team when it did [ns]
    first, last, count : stamps of its odometry since, as far as it came in order and without a
        gap, and how many

    """

    left: int
    first: int = 0
    last: int = 0
    count: int = 0

    def add(self, stamp: int, longest_gap: int) -> None:
        """Take in the stamp of odometry from back there."""
        if self.count == 0 or abs(stamp - self.last) > longest_gap:
            self.first, self.last, self.count = stamp, stamp, 1
        elif stamp > self.last:
            self.last = stamp
            self.count += 1

    def is_certain(self) -> bool:
        """Return whether it looks like a second pass, not like stray stamps."""
        return self.count >= CONFIRMED and self.last - self.first >= SPAN


class TimeJumpDetector:
    """
    The way of records to an estimator or a smoother, as long as their time goes forward.

    Parameters
    ----------
    consumer : what gets the records
    resets : whether another run follows a time jump; if not, all later input is rejected

    Attributes
    ----------
    jump : how time has jumped back, None while it has not

    """

    def __init__(self, consumer: Consumer, resets: bool = False) -> None:
        settings = consumer.settings
        self.jump: TimeJump | None = None
        self._consumer = consumer
        self._limit = round((settings.max_delay + settings.stale_after) * NS)
        self._future_limit = round(settings.future_limit * NS)
        self._resets = resets
        self._newest: dict[Source, int] = {}
        self._returns: dict[str, Return] = {}
        self._held: list[Held] = []
        self._earlier_end = 0
        self._pending: set[Source] = set()

    def add(self, record: TimedRecord, received: int | None) -> bool:
        """Pass a record on, hold it, or refuse it; return whether it is of use already."""
        if self.jump is not None:
            self._reject(record, RejectionReason.AFTER_TIME_JUMP)
        elif self._is_left_over(record):
            self._reject(record, RejectionReason.BEFORE_TIME_JUMP)
        elif self._lies_back(record):
            self._hold(record, received)
        else:
            return self._go_on(record, received)
        return False

    def follow(self, jump: TimeJump) -> None:
        """Begin where time has jumped back out of an earlier run, with what has come since."""
        self._earlier_end, self._pending = jump.end, set(jump.pending)
        for record, received in jump.held:
            self.add(record, received)

    def is_over(self) -> bool:
        """Return whether time has jumped back, and another run is to follow."""
        return self._resets and self.jump is not None

    def forget(self, robot: str) -> None:
        """Refuse what is held of a robot that has left; it says nothing of the time any more."""
        self._returns.pop(robot, None)
        for record, _ in self._held:
            if record.robot == robot:
                self._reject(record, RejectionReason.LEFT)
        self._held = [(record, then) for record, then in self._held if record.robot != robot]
        self._newest = {source: n for source, n in self._newest.items() if source[0] != robot}

    def close(self) -> None:
        """Pass on what is held: the input has ended, and there was no second pass."""
        for robot in list(self._returns):
            self._let_go(robot)

    def _lies_back(self, record: TimedRecord) -> bool:
        """Return whether a record is behind others of its source, or of a robot that went back."""
        sources = [_source(record)]
        if record.robot in self._returns:
            sources.append((record.robot, Odometry))
        return any(
            record.stamp < self._newest.get(source, record.stamp) - self._limit
            for source in sources)

    def _go_on(self, record: TimedRecord, received: int | None) -> bool:
        """Pass on a record of the present time, which tells who has gone back alone."""
        source = _source(record)
        self._pending.discard(source)
        if received is None or record.stamp - received <= self._future_limit:
            self._newest[source] = max(record.stamp, self._newest.get(source, record.stamp))
            if self._returns and isinstance(record, Odometry):
                self._let_go(record.robot)
                self._let_go_who_went_alone()
        return self._consumer.add(record, received)

    def _hold(self, record: TimedRecord, received: int | None) -> None:
        gone = self._returns.setdefault(record.robot, Return(self._time()))
        self._held.append((record, received))
        if len(self._held) > MAX_HELD:
            self._consumer.add(*self._held.pop(0))
        if isinstance(record, Odometry):
            gone.add(record.stamp, self._limit)
            self._judge()

    def _judge(self) -> None:
        """Find out whether time has jumped back: all robots together show it."""
        heard = [robot for robot, kind in self._newest if kind is Odometry]
        back = [gone for gone in self._returns.values() if gone.is_certain()]
        if len(back) < len(heard) and all(gone.last - gone.first <= PATIENCE for gone in back):
            return
        now = self._time()
        pending = self._newest.keys() - {_source(record) for record, _ in self._held}
        if not self._resets:
            for record, _ in self._held:
                self._reject(record, RejectionReason.AFTER_TIME_JUMP)
            self._held.clear()
        self.jump = TimeJump(
            now - min(gone.first for gone in back), now, frozenset(pending), self._held)
        self._held = []

    def _let_go_who_went_alone(self) -> None:
        """Pass on what came of robots that went back while others have gone on."""
        now = self._time()
        for robot in [r for r, gone in self._returns.items() if now - gone.left > self._limit]:
            for record, _ in self._held:
                if record.robot == robot:
                    # It may go on from there, and back from there.
                    self._newest[_source(record)] = record.stamp
            self._let_go(robot)

    def _let_go(self, robot: str) -> None:
        """Pass on what is held of a robot: it is of this pass, however late."""
        if self._returns.pop(robot, None) is not None:
            held, self._held = self._held, []
            for record, received in held:
                if record.robot == robot:
                    self._consumer.add(record, received)
                else:
                    self._held.append((record, received))

    def _is_left_over(self, record: TimedRecord) -> bool:
        """Return whether a record is of the earlier run: far ahead of this one, but not of it."""
        return (
            _source(record) in self._pending
            and self._time() + self._limit < record.stamp <= self._earlier_end)

    def _time(self) -> int:
        """Return the stamp of the newest odometry of all robots."""
        return max((n for (_, kind), n in self._newest.items() if kind is Odometry), default=0)

    def _reject(self, record: TimedRecord, reason: RejectionReason) -> None:
        self._consumer.statistics.reject_message(record.robot, record.stamp, reason)


def _source(record: TimedRecord) -> Source:
    return record.robot, type(record)
