# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Health of the input: use of the observations, and delays, of each robot."""

from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
import sys
from typing import NamedTuple

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ordering.consumer import Consumer
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.clock_offsets import ClockOffsets
from fej_slam_ros.ros.session.topic_flow import RATE_WINDOW, TopicFlow
from fej_slam_ros.ros.topic_types import OBSERVATION_TOPICS

#: Maximum number of notes for the log that wait to be taken; a run without a node takes none.
MAX_NOTES = 1000
#: Minimum number of observations by which the rate of gated ones is judged; a scan or two that
#: fail are no condition.
MIN_GATE_SAMPLE = 10
#: Observations older than this [ns] do not count any more.
OBSERVATION_WINDOW = 30 * NS
#: Number of poses of a robot within a time [ns] that are no relocalisation, but those of GPS or of
#: another localisation.
REPEATED_POSES, REPEATED_TIME = 5, 60 * NS
#: Number of odometry messages in a row with one pose while the robot drives by their velocities,
#: and speeds [m/s, rad/s] above which it drives; drivers may send a pose a few times.
UNMOVED_MESSAGES, MIN_SPEEDS = 100, (0.05, 0.05)
#: Number of odometry messages in a row whose variances are reported as implausible.
VARIANCE_MESSAGES = 100
#: Standard deviations of vx, vy and wz [m/s, m/s, rad/s] below which observations cannot correct
#: the odometry: drivers fill in variances of 1e-9, or some of the variances only.
MIN_SPEED_SIGMA = 1e-4, 1e-4, 4e-5
#: Standard deviation of vx, vy or wz [m/s, m/s, rad/s] above which odometry contributes nothing:
#: drivers fill in variances of 1e3 or more where they know none.
MAX_SPEED_SIGMA = 30.0


def are_repeated(stamps: Sequence[int]) -> bool:
    """Return whether poses with ascending stamps [ns] are too many for a relocalisation."""
    return any(
        last - first <= REPEATED_TIME for first, last in zip(stamps, stamps[REPEATED_POSES - 1:]))


class GateCounts(NamedTuple):
    """Observations that were compared with the map."""

    time: int  #: time of the report [ns]
    used: int  #: accepted ones
    gated: int  #: rejected ones

    def total(self) -> int:
        """Return the number of all that were compared."""
        return self.used + self.gated


class ObservationUse:
    """Counts of used and rejected observations of one robot over the latest reports."""

    def __init__(self) -> None:
        self.unused_since: int | None = None  #: time [ns] since which no observation was used
        #: observations received, messages rejected by reason, since then
        self.unused_observations = 0
        self.unused_reasons: Counter[RejectionReason] = Counter()
        self._gate: deque[GateCounts] = deque()
        self._sampled_at: int | None = None
        self._observed = self._used = 0
        self._reasons: Counter[RejectionReason] = Counter()
        self._recent: deque[tuple[int, Counter[RejectionReason]]] = deque()

    def sample(
        self, now: int, observed: int, used: int, reasons: Counter[RejectionReason]
    ) -> None:
        """Add the total numbers of received and used observations and rejections at a time."""
        if self._sampled_at is not None and now < self._sampled_at:
            # The clock went back, so that the age of what came before is unknown.
            self._gate.clear()
            self._recent.clear()
            if self.unused_since is not None:
                self.unused_since = min(self.unused_since, now)
        rejected = reasons - self._reasons
        new = GateCounts(now, max(used - self._used, 0), rejected[RejectionReason.GATED])
        if new.used > 0:
            self.unused_since, self.unused_observations = None, 0
            self.unused_reasons.clear()
        elif observed > self._observed:
            if self.unused_since is None:
                self.unused_since = now if self._sampled_at is None else self._sampled_at
            self.unused_observations += observed - self._observed
            self.unused_reasons += rejected
        self._keep(new)
        self._recent.append((now, rejected))
        while now - self._recent[0][0] > RATE_WINDOW:
            self._recent.popleft()
        self._sampled_at, self._observed, self._used = now, observed, used
        self._reasons = reasons.copy()

    def recently_rejected(self) -> Counter[RejectionReason]:
        """Return the number of rejections of the last seconds, by reason."""
        return sum((counts for _, counts in self._recent), Counter())

    def gated(self) -> tuple[int, int]:
        """Return how many of the latest observations were gated, and the number of all."""
        return sum(counts.gated for counts in self._gate), self._total()

    def _keep(self, new: GateCounts) -> None:
        if new.total():
            self._gate.append(new)
        while self._gate and (
            self._total() - self._gate[0].total() >= MIN_GATE_SAMPLE
            or new.time - self._gate[0].time > OBSERVATION_WINDOW
        ):
            self._gate.popleft()

    def _total(self) -> int:
        return sum(counts.total() for counts in self._gate)


@dataclass(slots=True)
class RobotHealth:
    """The input of one robot."""

    #: messages on each topic, by the last part of its name
    flows: defaultdict[str, TopicFlow] = field(default_factory=lambda: defaultdict(TopicFlow))
    observations: ObservationUse = field(default_factory=ObservationUse)
    newest: int | None = None  #: newest odometry stamp [ns]
    delay: int | None = None  #: from the stamp of the latest message to its reception [ns]
    #: number of the latest odometry messages that have velocities, but the same pose
    unmoved: int = 0
    #: number of the latest odometry messages with velocities whose variances are almost zero
    exact: int = 0
    #: number of the latest odometry messages whose variances are as those of unknown velocities
    unknown: int = 0
    _pose: list[float] | None = None
    #: longest times [ns] by which the odometry was behind that of others: in the two periods
    #: before the last report, and since
    _lags: deque[int] = field(default_factory=lambda: deque([0, 0, 0], maxlen=3))

    def receive_velocity(
        self, pose: Array, velocity: tuple[float, float], Q: Array | None
    ) -> None:
        """
        Add the motion of accepted odometry.

        Parameters
        ----------
        pose : (3,) array [m, m, rad]
        velocity : forward and turn rates [m/s, rad/s]
        Q : (3, 3) covariance of the velocities, None if unknown

        """
        is_moving = any(abs(v) > least for v, least in zip(velocity, MIN_SPEEDS))
        variances = [1.0, 1.0, 1.0] if Q is None else Q.diagonal().tolist()
        # Many robots cannot move sideways, and drivers may know a robot to be at rest.
        if all(variances[k] >= MIN_SPEED_SIGMA[k] ** 2 for k in (0, 2)):
            self.exact = 0
        elif is_moving:
            self.exact += 1
        self.unknown = self.unknown + 1 if max(variances) > MAX_SPEED_SIGMA ** 2 else 0
        newest = pose.tolist()
        if self._pose != newest:
            self._pose, self.unmoved = newest, 0
        elif is_moving:
            self.unmoved += 1

    def note_lag(self, newest: int, longest: int) -> None:
        """Note how far the odometry is behind the newest of the team, if not beyond a lag [ns]."""
        if self.newest is not None and self._lags[-1] < newest - self.newest <= longest:
            self._lags[-1] = newest - self.newest

    def lag(self) -> int:
        """
        Return how long [ns] others waited for the odometry.

        It is the smaller of the longest lags of two periods between reports, so that a single
        delayed message does not count.

        """
        return min(self._lags[0], self._lags[1])

    def sample(self, now: int, used: int, reasons: Counter[RejectionReason]) -> None:
        """Add the total numbers of used observations and rejections at a report [ns]."""
        for flow in self.flows.values():
            flow.sample(now)
        observed = sum(self.flows[kind].observations for kind in OBSERVATION_TOPICS)
        self.observations.sample(now, observed, used, reasons)
        self._lags.append(0)


class InputHealth:
    """
    Watches the input of a team.

    Attributes
    ----------
    robots : input of each robot
    clock_offsets : clock offsets of the robots, from the delays of their odometry
    first_messages : robot and topic of each first message, until they are taken
    pose_priors : stamps [ns] of the pose priors of each robot that wait for its next step
    placed : robots whose newest pose prior is a known pose, no request to relocalize
    rejected_priors : robot and reason of each rejected pose prior, until they are taken

    """

    def __init__(self, consumer: Consumer) -> None:
        self._consumer = consumer
        self.robots: defaultdict[str, RobotHealth] = defaultdict(RobotHealth)
        self.clock_offsets = ClockOffsets()
        # Stamp of the newest odometry of the team since the last report [ns].
        self._newest = -sys.maxsize
        self.first_messages: deque[tuple[str, str]] = deque(maxlen=MAX_NOTES)
        self.pose_priors: dict[str, list[int]] = {}
        self.placed: set[str] = set()
        self.rejected_priors: deque[tuple[str, RejectionReason]] = deque(maxlen=MAX_NOTES)

    @property
    def stale_after(self) -> int:
        """Return the time of silence [ns] after which a robot is not waited for."""
        return round(self._consumer.settings.stale_after * NS)

    @property
    def longest_lead(self) -> int:
        """Return the lead of others [ns] beyond which a robot is not waited for."""
        return self.stale_after + round(self._consumer.settings.max_delay * NS)

    def flow(self, robot: str, kind: str) -> TopicFlow:
        """Return the messages of a robot on a topic, given by the last part of its name."""
        return self.robots[robot].flows[kind]

    def receive(self, robot: str, kind: str, received: int | None) -> None:
        """Add a message with its time of reception [ns]."""
        flow = self.flow(robot, kind)
        if not flow.received:
            self.first_messages.append((robot, kind))
        flow.add(received)

    def settle(
        self, robot: str, kind: str, received: int | None, reason: RejectionReason | None
    ) -> None:
        """Note whether a message, which had perhaps waited, is accepted, or why it is rejected."""
        self.flow(robot, kind).settle(received, reason)
        if kind == 'set_pose' and reason is not None:
            self.rejected_priors.append((robot, reason))

    def receive_delay(self, robot: str, kind: str, delay: int) -> None:
        """Add the time from the stamp of a message to its reception [ns]."""
        self.robots[robot].delay = self.flow(robot, kind).delay = delay
        if kind == 'odom':
            self.clock_offsets.add(robot, delay)

    def receive_pose_prior(self, robot: str, stamp: int, is_known: bool) -> None:
        """Add the stamp [ns] of an accepted pose prior, and whether it is a known pose."""
        (self.placed.add if is_known else self.placed.discard)(robot)
        waiting = self.pose_priors.setdefault(robot, [])
        waiting.append(stamp)
        del waiting[:-MAX_NOTES]

    def receive_odometry(self, robot: str, stamp: int) -> None:
        """Add the stamp [ns] of accepted odometry."""
        own = self.robots[robot]
        # How far it was behind until now; robots further than the longest lead are not waited for.
        own.note_lag(self._newest, self.longest_lead)
        own.newest = stamp if own.newest is None else max(stamp, own.newest)
        self._newest = max(stamp, self._newest)

    def remove_robot(self, robot: str) -> None:
        """Delete the state of a robot that was removed."""
        self.robots.pop(robot, None)
        self.pose_priors.pop(robot, None)
        self.clock_offsets.remove_robot(robot)

    def sample(self, now: int) -> None:
        """Add the present counts at the time [ns] of a report."""
        statistics = self._consumer.statistics
        for robot in self._consumer.robots:
            self.robots[robot].note_lag(self._newest, self.longest_lead)
            self.robots[robot].sample(
                now, statistics.observations_used[robot], statistics.rejection_counts[robot])
        self._newest = -sys.maxsize

    def waiting(self, robot: str) -> int:
        """Return the number of messages of a robot that wait to be used."""
        statistics = self._consumer.statistics
        return (
            statistics.received[robot] - statistics.rejected[robot] - self._consumer.used(robot))
