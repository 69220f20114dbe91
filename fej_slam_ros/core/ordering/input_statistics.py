# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of the input: every message and observation is counted as used or rejected."""

from collections import Counter, defaultdict, deque
from copy import copy

from fej_slam_ros.core.records import AnyScan, Odometry, PosePrior, TruePose
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: Maximum number of rejections that wait to be published, a few hundred kB; older ones are counted
#: only.
MAX_PENDING_REJECTIONS = 1000

#: Reasons for rejection that depend on when the input arrived, and on the speed of the machine.
ARRIVAL_REASONS = (
    RejectionReason.LATE, RejectionReason.CONFLICTING, RejectionReason.OVERLOAD,
    RejectionReason.INTERRUPTED)


class InputStatistics:
    """Counts of messages and observations, by robot."""

    def __init__(self) -> None:
        self.received: Counter[str] = Counter()  #: messages
        self.rejected: Counter[str] = Counter()  #: messages that were rejected as a whole
        #: observations that started or corrected a variable, and those with inflated noise
        self.observations_used: Counter[str] = Counter()
        self.observations_inflated: Counter[str] = Counter()
        #: rejected messages and observations, by reason
        self.rejection_counts: defaultdict[str, Counter[RejectionReason]] = defaultdict(Counter)
        #: the newest rejections, until they are published
        self.rejections: deque[Rejection] = deque(maxlen=MAX_PENDING_REJECTIONS)
        #: steps of a robot at stamps that other robots had already passed, and pose priors at
        #: stamps that the robot itself had passed
        self.released_without: Counter[str] = Counter()
        #: restarts in an own frame, and the reason for the latest one of each robot
        self.relocalized: Counter[str] = Counter()
        self.restart_reasons: dict[str, str] = {}
        self.pose_priors_used: Counter[str] = Counter()  #: poses that placed or restarted a robot
        self.longest_delay: Counter[str] = Counter()  #: maximum lateness of late data [ns]

    def reject(self, rejection: Rejection) -> None:
        """Count the rejection of a message or, if it has an ID, of one observation."""
        robot = rejection.robot
        self.rejection_counts[robot][rejection.reason] += 1
        self.rejected[robot] += rejection.id is None
        self.longest_delay[robot] = max(self.longest_delay[robot], rejection.delay or 0)
        self.rejections.append(rejection)

    def reject_observation(self, rejection: Rejection) -> None:
        """Count the rejection of an observation that is counted as used."""
        self.observations_used[rejection.robot] -= 1
        self.reject(rejection)

    def reject_record(
        self, record: Odometry | AnyScan | TruePose | PosePrior, reason: RejectionReason
    ) -> RejectionReason:
        """Count the rejection of a record that is counted as received; return the reason."""
        self.reject(Rejection(record.robot, record.stamp, reason))
        return reason

    def reject_message(self, robot: str, stamp: int, reason: RejectionReason) -> None:
        """Count a message of a stamp [ns] as received and rejected."""
        self.received[robot] += 1
        self.reject(Rejection(robot, stamp, reason))

    def count_fully_rejected_scan(self, robot: str) -> None:
        """Count a message as rejected whose observations were all rejected."""
        self.received[robot] += 1
        self.rejected[robot] += 1

    def count_restart(self, robot: str, reason: str) -> None:
        """Count a restart in an own frame."""
        self.relocalized[robot] += 1
        self.restart_reasons[robot] = reason

    def take_over(self, robot: str, other: 'InputStatistics') -> None:
        """Replace all counts of a robot, and why it restarted, by those of other statistics."""
        for name, own in vars(self).items():
            # The waiting rejections are no count.
            if isinstance(own, dict):
                own.pop(robot, None)
                if robot in vars(other)[name]:
                    own[robot] = copy(vars(other)[name][robot])

    def total(self, reason: RejectionReason) -> int:
        """Return the number of rejections of all robots for a reason."""
        return sum(counts[reason] for counts in self.rejection_counts.values())

    def depends_on_arrival(self) -> bool:
        """Return whether a different order of arrival might have changed the result."""
        return self.released_without.total() > 0 or any(
            self.total(reason) for reason in ARRIVAL_REASONS)
