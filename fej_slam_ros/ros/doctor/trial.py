# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator itself, given a bag: what it refuses is what it would refuse on the robots."""

from collections import Counter
from dataclasses import replace

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.messages import RawMessage, stamp_of
from fej_slam_ros.ros.session.inputs import Inputs

#: Gates and matches are no faults of single messages.
JUDGED_AS_A_WHOLE = {RejectionReason.GATED, RejectionReason.MOVED_LANDMARK, RejectionReason.DOUBTFUL_MATCH}
#: Of what they tell the topic.
OF_ROBOTS = {RejectionReason.OTHER_ROBOT_STALE, RejectionReason.NOT_JOINED, RejectionReason.SELF_OBSERVATION}
OF_SCANS = {
    RejectionReason.BEFORE_ODOMETRY, RejectionReason.AFTER_ODOMETRY, RejectionReason.WRONG_FRAME, RejectionReason.DUPLICATE_ID,
    RejectionReason.BAD_ID, RejectionReason.BAD_CLOUD, RejectionReason.UNKNOWN_ROBOT}
#: A message of fewer bytes has no stamp.
SHORTEST = 12


class Trial:
    """
    A run of the estimator that publishes and writes nothing.

    Parameters
    ----------
    settings : under which it is to run

    Attributes
    ----------
    estimator, inputs : which it consists of
    refused : how often something was refused, by topic and reason
    first : stamp of the first of them [ns]
    contradicted : how often observations failed the gate, by robot and number of what was seen
    broken : why the estimate could not go on, None where it could

    """

    def __init__(self, settings: Settings) -> None:
        self.estimator = Estimator(
            replace(settings, on_time_jump='refuse', restore=''), prior_map(settings))
        self.inputs = Inputs(self.estimator)
        self._topics = frozenset(self.inputs.topics)
        self.rejected: Counter[tuple[str, RejectionReason]] = Counter()
        self.first: dict[tuple[str, RejectionReason], int] = {}
        self.contradicted: Counter[tuple[str, int]] = Counter()
        self.broken: UserError | None = None
        self._latest: dict[tuple[str, int], str] = {}

    def receive(self, message: RawMessage) -> None:
        """Take in a message that is an input."""
        if self.broken is None and message.topic in self._topics:
            if len(message.raw) >= SHORTEST and not message.topic.endswith('/ground_truth'):
                self._latest[_robot(message), stamp_of(message.raw)] = message.topic
            self.inputs.receive(message)
            self._account(message)
            self._go_on()

    def close(self) -> None:
        """Finish: the bag has ended."""
        self.inputs.close()
        if self.broken is None:
            self._go_on(to_the_end=True)
        self._account(None)

    def gated(self, robot: str) -> float:
        """Return which part of a robot's observations of what is known failed the gate."""
        rejection_counts = self.estimator.statistics.rejection_counts[robot]
        failed = rejection_counts[RejectionReason.GATED] + rejection_counts[RejectionReason.MOVED_LANDMARK]
        return failed / max(failed + self.estimator.statistics.observations_used[robot], 1)

    def _go_on(self, to_the_end: bool = False) -> None:
        try:
            for _ in self.estimator.close() if to_the_end else self.estimator.take():
                pass
        except UserError as error:
            self.broken = error
        self._account(None)

    def _account(self, arrived: RawMessage | None) -> None:
        """Count what has been refused, of the message that has just arrived or others."""
        rejections = self.estimator.statistics.rejections
        while rejections:
            rejection = rejections.popleft()
            if rejection.reason not in JUDGED_AS_A_WHOLE:
                place = self._topic(rejection, arrived), rejection.reason
                self.rejected[place] += 1
                self.first.setdefault(place, rejection.stamp)
            elif rejection.id is not None and rejection.seen is None:
                self.contradicted[rejection.robot, rejection.id] += 1

    def _topic(self, rejection: Rejection, arrived: RawMessage | None) -> str:
        """Return the topic of what was refused, at once or after it had waited."""
        if arrived is not None and (
                rejection.reason is RejectionReason.BAD_MESSAGE or _is_of(rejection, arrived)):
            return arrived.topic
        if rejection.seen is not None or rejection.reason in OF_ROBOTS:
            return f'{rejection.robot}/robots'
        # Of one stamp the latest is refused, but scans wait for their odometry.
        topic = self._latest.get((rejection.robot, rejection.stamp), f'{rejection.robot}/odom')
        if rejection.reason in OF_SCANS and topic.endswith('/odom'):
            return f'{rejection.robot}/landmarks'
        return topic


def _is_of(rejection: Rejection, arrived: RawMessage) -> bool:
    """Return whether a message has been refused at once, and not a scan that it let go."""
    is_odometry = arrived.topic.endswith('/odom')
    return (
        rejection.robot == _robot(arrived) and rejection.stamp == stamp_of(arrived.raw)
        and not (is_odometry and rejection.reason in OF_SCANS))


def _robot(arrived: RawMessage) -> str:
    return arrived.topic.rpartition('/')[0]
