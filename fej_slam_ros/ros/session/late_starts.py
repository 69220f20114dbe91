# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start poses of robots that had moved before their first odometry was received."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple, Protocol

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ordering.impossible_motion import is_at_origin
from fej_slam_ros.core.ordering.missed_motion import missed_motion, pose_text
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.session.log_lines import LogSeverity

#: Adds a line to a log.
AddLine = Callable[[LogSeverity, str], None]

#: Maximum number of odometry messages that are held. With more the number of missed ones counts as
#: unknown: the sequence number of the first is there by the second, if the middleware gives any.
MAX_HELD_ODOMETRY = 5


class ArrivedOdometry(NamedTuple):
    """An odometry message and its record, with its time of reception [ns]."""

    record: Odometry
    message: Message
    received: int | None


class HeldOdometry(NamedTuple):
    """Odometry of a robot that waits for its check, at least one message."""

    missed: int | None  #: number of messages missed before the first one, None if it is unknown
    arrived: list[ArrivedOdometry]


class MissedMessages(Protocol):
    """Knows how many messages were sent on a topic before the first one received."""

    def missed(self, topic: str) -> int | None:
        """Return the number, None while it is unknown."""

    def forget(self, topic: str) -> None:
        """Watch a topic no longer."""


class StartCheck:
    """
    Decides whether the start pose of a robot holds at its first odometry.

    This one is that of `replay`: a bag is taken to begin where the robots start.

    Parameters
    ----------
    held : odometry that was held in an earlier process, by robot

    """

    def __init__(self, held: Mapping[str, HeldOdometry] = MappingProxyType({})) -> None:
        self._held: defaultdict[str, list[ArrivedOdometry]] = defaultdict(
            list, {robot: of_robot.arrived for robot, of_robot in held.items()})
        self._numbers_missed = {robot: of_robot.missed for robot, of_robot in held.items()}

    def admit(self, arrived: ArrivedOdometry) -> list[ArrivedOdometry]:
        """Return the odometry to pass on now; what is held is returned by a later call."""
        return [*self._held.pop(arrived.record.robot, ()), arrived]

    def close(self) -> Iterator[ArrivedOdometry]:
        """Yield the odometry still held at the end of the input."""
        for robot in [*self._held]:
            yield from self._held.pop(robot)

    def remove_robot(self, robot: str) -> list[ArrivedOdometry]:
        """Forget a robot that was removed; return its odometry that is held."""
        self._numbers_missed.pop(robot, None)
        return self._held.pop(robot, [])

    def held(self) -> dict[str, HeldOdometry]:
        """Return the odometry that is held, by robot."""
        return {
            robot: HeldOdometry(self._missed(robot), [*held])
            for robot, held in self._held.items()}

    def topics(self) -> list[str]:
        """Return the topics of which the number of missed messages is needed."""
        return []

    def _missed(self, robot: str) -> int | None:
        """Return the number of messages missed before the first one held, None if unknown."""
        return self._numbers_missed.get(robot)


class LateStarts(StartCheck):
    """
    The check of a live run, which may begin when robots have already moved.

    A start pose, and the pose of the anchor in ``map``, hold at the first odometry message that
    the robot sends. If that was missed and the robot has moved, it begins at its start pose plus
    the motion since, or, if that is unknown, in a frame of its own. An anchor that alone defines
    ``map`` then does so at its first odometry received.

    """

    def __init__(
        self, estimator: Estimator, messages: MissedMessages, add_line: AddLine,
        held: Mapping[str, HeldOdometry],
    ) -> None:
        super().__init__(held)
        self._estimator = estimator
        self._messages = messages
        self._add_line = add_line
        # A restored run has the first odometry of some robots, perhaps still waiting for others.
        self._checked = {
            name for name in estimator.robots
            if estimator.sequencer.newest_odometry(name) is not None}
        # The first period of others may be that in which no process ran, so another is measured.
        self._records_needed = defaultdict(lambda: 2, dict.fromkeys(held, 3))

    def admit(self, arrived: ArrivedOdometry) -> list[ArrivedOdometry]:
        robot = arrived.record.robot
        if not self._needs_check(robot):
            return super().admit(arrived)
        held = self._held[robot]
        held.append(arrived)
        first, missed = held[0].record, self._missed(robot)
        if missed != 0 and not is_at_origin(first):
            needed = self._records_needed[robot]
            records = _in_order(held)[:needed]
            if len(held) < MAX_HELD_ODOMETRY and (len(records) < needed or missed is None):
                return []
            if records[1:]:
                self._start_late(first, min(pairwise(records), key=_duration), missed)
            else:
                self._void(robot, f'its first {len(held)} odometry messages have no later stamp')
        self._checked.add(robot)
        self._messages.forget(_topic(robot))
        return self._held.pop(robot)

    def close(self) -> Iterator[ArrivedOdometry]:
        """Yield the odometry held at the end of the input, after a start pose that is not used."""
        for robot in [*self._held]:
            self._void(robot, 'it sent too little odometry before the end')
            yield from self._held.pop(robot)

    def topics(self) -> list[str]:
        return [_topic(robot) for robot in self._estimator.robots if self._needs_check(robot)]

    def _missed(self, robot: str) -> int | None:
        if robot not in self._numbers_missed:
            missed = self._messages.missed(_topic(robot))
            if missed is None:
                return None
            self._numbers_missed[robot] = missed
        return self._numbers_missed[robot]

    def _needs_check(self, robot: str) -> bool:
        """Return whether a robot has a start pose that has not been checked yet."""
        settings = self._estimator.settings
        has_start = (
            robot == settings.anchor or self._estimator.robots[robot].start_pose is not None)
        return has_start and robot not in self._checked

    def _start_late(
        self, first: Odometry, period: tuple[Odometry, Odometry], missed: int | None
    ) -> None:
        robot = first.robot
        motion = missed_motion(first, period, missed, self._estimator.robots[robot])
        if isinstance(motion, str):
            self._void(robot, motion)
        else:
            self._estimator.groups.start_after(robot, motion.u, motion.Q)
            x, y, phi = motion.u
            self._add_line(
                LogSeverity.INFO,
                f'{robot} had moved by [{x:.2f}, {y:.2f}, {phi:.2f}] before its first odometry was'
                f' received (missed messages: {missed}): it starts that far from its start pose')

    def _void(self, robot: str, reason: str) -> None:
        if robot == self._estimator.settings.anchor and not self._estimator.groups.is_map_given():
            self._add_line(LogSeverity.INFO, f'map begins where {robot} is now: {reason}')
        else:
            self._estimator.groups.void_start(robot, f'its start pose is not valid: {reason}')
            self._add_line(
                LogSeverity.WARN,
                f'the start pose of {robot} is not used: {reason}; it joins by shared'
                ' landmarks or robot-to-robot observations, or by a pose on its topic set_pose')


class LateAnchor(StartCheck):
    """
    The check of a live smoother, whose ``map`` begins at the first odometry of its anchor.

    Like that of a bag it passes all odometry on. A line in the log says that the anchor had moved
    before.

    """

    def __init__(
        self, settings: CommonSettings, messages: MissedMessages, add_line: AddLine
    ) -> None:
        super().__init__()
        self._anchor = settings.anchor
        self._severity = LogSeverity.WARN if any(settings.anchor_pose) else LogSeverity.INFO
        self._messages = messages
        self._add_line = add_line
        self._received: list[Odometry] = []
        self._is_checked = not settings.anchor

    def admit(self, arrived: ArrivedOdometry) -> list[ArrivedOdometry]:
        """Pass the odometry on, and check whether the anchor had moved before its first one."""
        if arrived.record.robot == self._anchor and not self._is_checked:
            self._received.append(arrived.record)
            missed = self._messages.missed(_topic(self._anchor))
            if missed is not None or len(self._received) == MAX_HELD_ODOMETRY:
                self._check(self._received[0], missed)
        return super().admit(arrived)

    def remove_robot(self, robot: str) -> list[ArrivedOdometry]:
        """Forget a robot that was removed; return its odometry that is held, which is none."""
        if robot == self._anchor:
            self._received.clear()
        return super().remove_robot(robot)

    def topics(self) -> list[str]:
        return [] if self._is_checked else [_topic(self._anchor)]

    def _check(self, first: Odometry, missed: int | None) -> None:
        self._is_checked = True
        self._messages.forget(_topic(self._anchor))
        if missed != 0 and not is_at_origin(first):
            self._add_line(self._severity, (
                f'map begins at the first odometry received of {self._anchor}, {pose_text(first)}:'
                ' the robot had moved before, and anchor_pose holds there'))


def _in_order(held: list[ArrivedOdometry]) -> list[Odometry]:
    """Return the first record and later ones by their stamps, one for each stamp."""
    first = held[0].record
    by_stamp = {
        other.record.stamp: other.record for other in held if other.record.stamp > first.stamp}
    return [first, *(by_stamp[stamp] for stamp in sorted(by_stamp))]


def _duration(period: tuple[Odometry, Odometry]) -> int:
    earlier, later = period
    return later.stamp - earlier.stamp


def _topic(robot: str) -> str:
    return f'{robot}/odom'
