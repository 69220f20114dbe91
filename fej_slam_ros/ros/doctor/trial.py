# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trial run of the estimator over a bag: it rejects what it would reject on the robots."""

from collections import Counter, defaultdict
from dataclasses import replace

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import PriorMap
from fej_slam_ros.core.rejections import Rejection, RejectionReason as Reason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import RawMessage, stamp_of
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.topic_types import INITIALPOSE

#: Reasons of observations that do not fit, and all that concern the whole run rather than single
#: messages.
FIT_REASONS = {Reason.GATED, Reason.MOVED_LANDMARK, Reason.DOUBTFUL_MATCH}
REASONS_OF_THE_RUN = {
    *FIT_REASONS, Reason.LOST_ROBOT, Reason.INTERRUPTED, Reason.OVERLOAD}
#: Reasons that determine the topic: robot observations, and any scan.
ROBOT_REASONS = {Reason.OTHER_ROBOT_STALE, Reason.NOT_JOINED, Reason.SELF_OBSERVATION}
SCAN_REASONS = {
    Reason.BEFORE_ODOMETRY, Reason.AFTER_ODOMETRY, Reason.WRONG_FRAME, Reason.DUPLICATE_ID,
    Reason.BAD_ID, Reason.BAD_CLOUD, Reason.TOO_LARGE, Reason.UNKNOWN_ROBOT}
#: Minimum size of a serialised message with a header stamp [bytes].
MIN_STAMPED_SIZE = 12


class Trial:
    """A run of the estimator that publishes and writes nothing."""

    def __init__(
        self, settings: Settings, node: NodeSettings, prior: PriorMap | None = None
    ) -> None:
        self.estimator = Estimator(settings, prior)
        # A second pass of a looping bag is a finding.
        self.inputs = Inputs(self.estimator, replace(node, on_time_jump='refuse'))
        self.inputs.initialpose_robot = settings.initialpose_robot
        self.topics = frozenset(self.inputs.topics)
        self._static_topics = {topic.lstrip('/') for topic in self.inputs.static_topics}
        #: Number of rejections by topic and reason, and the stamp of the first of them [ns].
        self.rejected: Counter[tuple[str, Reason]] = Counter()
        self.first: dict[tuple[str, Reason], int] = {}
        #: Number of rejected observations of each robot whose odometry was missing, by topic.
        self.stale: defaultdict[str, Counter[str]] = defaultdict(Counter)
        #: Number of observations that failed the gate, by robot and landmark ID.
        self.gate_failures: Counter[tuple[str, int]] = Counter()
        #: The same number of observations of robots, by observer.
        self.failed_of_robots: Counter[str] = Counter()
        #: Robots that were in `map` at some time.
        self.joined: set[str] = set()
        #: Error that ended the run early.
        self.failure: UserError | None = None
        # Topic of the latest message by robot and stamp.
        self._latest: dict[tuple[str, int], str] = {}

    def receive(self, message: RawMessage) -> None:
        """Process a message if it is an input."""
        if message.topic.lstrip('/') in self._static_topics:
            self.inputs.receive(message)
        elif self.failure is None and message.topic in self.topics:
            is_truth = message.topic.endswith('/ground_truth')
            if len(message.raw) >= MIN_STAMPED_SIZE and not is_truth:
                self._latest[self._robot(message), stamp_of(message.raw)] = message.topic
            self.inputs.receive(message)
            self._count_rejections(message)
            self._process()

    def close(self) -> None:
        """Process the input that still waits at the end of the bag."""
        self.inputs.close()
        self._process(to_the_end=True)

    def gated_share(self, robot: str) -> float:
        """Return the share of a robot's compared observations that failed the gate."""
        failed = self.failed(robot)
        return failed / max(failed + self.estimator.statistics.observations_used[robot], 1)

    def failed(self, robot: str) -> int:
        """Return the number of a robot's observations that failed the gate."""
        counts = self.estimator.statistics.rejection_counts[robot]
        return counts[Reason.GATED] + counts[Reason.MOVED_LANDMARK]

    def doubtful_share(self, robot: str) -> float:
        """Return the share of a robot's observations that have no ID and no certain match."""
        statistics = self.estimator.statistics
        doubtful = statistics.rejection_counts[robot][Reason.DOUBTFUL_MATCH]
        return doubtful / max(doubtful + statistics.observations_used[robot], 1)

    def _process(self, to_the_end: bool = False) -> None:
        if self.failure is None:
            try:
                for step in self.estimator.close() if to_the_end else self.estimator.take():
                    self.joined.update(pose.robot for pose in step.poses if pose.frame == MAP)
            except UserError as error:
                self.failure = error
        self._count_rejections(None)

    def _count_rejections(self, arrived: RawMessage | None) -> None:
        rejections = self.estimator.statistics.rejections
        while rejections:
            rejection = rejections.popleft()
            if rejection.reason not in REASONS_OF_THE_RUN:
                key = self._topic(rejection, arrived), rejection.reason
                self.rejected[key] += 1
                self.first.setdefault(key, rejection.stamp)
                if rejection.reason is Reason.OTHER_ROBOT_STALE and rejection.observed:
                    self.stale[key[0]][rejection.observed] += 1
            elif rejection.reason in FIT_REASONS and rejection.observed is not None:
                self.failed_of_robots[rejection.robot] += 1
            elif rejection.reason in FIT_REASONS and rejection.id is not None:
                self.gate_failures[rejection.robot, rejection.id] += 1

    def _topic(self, rejection: Rejection, arrived: RawMessage | None) -> str:
        if rejection.reason is Reason.IMPOSSIBLE_MOTION:
            return f'{rejection.robot}/odom'
        of_scan = rejection.reason in SCAN_REASONS
        if arrived is not None:
            # Odometry also releases scans, which may be rejected then.
            is_cause = rejection.reason is Reason.BAD_MESSAGE or (
                rejection.robot == self._robot(arrived)
                and rejection.stamp == stamp_of(arrived.raw)
                and not (of_scan and arrived.topic.endswith('/odom')))
            if is_cause:
                return arrived.topic
        if rejection.observed is not None or rejection.reason in ROBOT_REASONS:
            return f'{rejection.robot}/robots'
        # The latest message of the stamp is the rejected one, except that scans wait for odometry.
        topic = self._latest.get((rejection.robot, rejection.stamp), f'{rejection.robot}/odom')
        return f'{rejection.robot}/landmarks' if of_scan and topic.endswith('/odom') else topic

    def _robot(self, message: RawMessage) -> str:
        if message.topic == INITIALPOSE:
            return self.inputs.robot_of_initialpose() or ''
        return message.topic.rpartition('/')[0]
