# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Health of the input: use of the observations, and delays, of each robot."""

from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from typing import Any, NamedTuple

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ordering.consumer import Consumer
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.topic_flow import RATE_WINDOW, TopicFlow

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
#: Number of odometry messages in a row whose motion is claimed to be almost exact.
EXACT_MESSAGES = 100
#: Standard deviations of vx, vy and wz [m/s, m/s, rad/s] below which observations cannot correct
#: the odometry: drivers fill in variances of 1e-9, or some of the variances only.
MIN_SPEED_SIGMA = 1e-4, 1e-4, 4e-5


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


class RobotHealth:
    """Counts of used and rejected input of one robot over the latest reports."""

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


class InputHealth:
    """
    Watches the input of a team.

    Attributes
    ----------
    first_messages : robot and topic of each first message, until they are taken
    newest : newest odometry stamp of each robot [ns]
    pose_priors : stamps [ns] of the pose priors of each robot that wait for its next step
    unmoved : number of the latest odometry messages of each robot that have velocities, but the
        same pose
    exact : number of the latest odometry messages of each robot that have velocities whose
        variances are almost zero
    rejected_priors : robot and reason of each rejected pose prior, until they are taken

    """

    def __init__(self, consumer: Consumer) -> None:
        self._consumer = consumer
        self.first_messages: deque[tuple[str, str]] = deque(maxlen=MAX_NOTES)
        self.newest: dict[str, int] = {}
        self.pose_priors: dict[str, list[int]] = {}
        self.rejected_priors: deque[tuple[str, RejectionReason]] = deque(maxlen=MAX_NOTES)
        self.robots: defaultdict[str, RobotHealth] = defaultdict(RobotHealth)
        self.unmoved: Counter[str] = Counter()
        self.exact: Counter[str] = Counter()
        self._poses: dict[str, list[float]] = {}
        self._flows: defaultdict[str, defaultdict[str, TopicFlow]] = (
            defaultdict(lambda: defaultdict(TopicFlow)))
        # Longest time [ns] by which the odometry of each robot was behind: since the last report,
        # and in the two periods before.
        self._lags: Counter[str] = Counter()
        self._past_lags: deque[Counter[str]] = deque([Counter(), Counter()], maxlen=2)

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
        return self._flows[robot][kind]

    def receive(
        self, robot: str, kind: str, received: int | None, reason: RejectionReason | None
    ) -> None:
        """Add a message with its time of reception [ns] and the reason if it was rejected."""
        flow = self.flow(robot, kind)
        if not flow.received:
            self.first_messages.append((robot, kind))
        flow.add(received, reason)
        if kind == 'set_pose' and reason is not None:
            self.rejected_priors.append((robot, reason))

    def receive_pose_prior(self, robot: str, stamp: int) -> None:
        """Add the stamp [ns] of an accepted pose prior."""
        waiting = self.pose_priors.setdefault(robot, [])
        waiting.append(stamp)
        del waiting[:-MAX_NOTES]

    def receive_odometry(self, robot: str, stamp: int) -> None:
        """Add the stamp [ns] of accepted odometry, which may show that others lag behind."""
        self.newest[robot] = max(stamp, self.newest.get(robot, stamp))
        for name, newest in self.newest.items():
            lag = stamp - newest
            # Robots that lag further than the longest lead are not waited for.
            if lag > self._lags.get(name, 0) and lag <= self.longest_lead:
                self._lags[name] = lag

    def receive_velocity(
        self, robot: str, pose: Array, velocity: tuple[float, float], Q: Array | None
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
        # Many robots cannot move sideways, and drivers may know a robot to be at rest.
        if Q is None or all(Q[k, k] >= MIN_SPEED_SIGMA[k] ** 2 for k in (0, 2)):
            self.exact[robot] = 0
        elif is_moving:
            self.exact[robot] += 1
        newest = pose.tolist()
        if self._poses.get(robot) != newest:
            self._poses[robot] = newest
            self.unmoved[robot] = 0
        elif is_moving:
            self.unmoved[robot] += 1

    def remove_robot(self, robot: str) -> None:
        """Delete the state of a robot that was removed."""
        by_robot: list[dict[str, Any]] = [
            self._flows, self.robots, self.newest, self.pose_priors, self.unmoved, self.exact,
            self._poses, self._lags, *self._past_lags]
        for values in by_robot:
            values.pop(robot, None)

    def sample(self, now: int) -> None:
        """Add the present counts at the time [ns] of a report."""
        statistics = self._consumer.statistics
        for robot in self._consumer.robots:
            flows = self._flows[robot]
            for flow in flows.values():
                flow.sample(now)
            self.robots[robot].sample(
                now, flows['landmarks'].observations + flows['robots'].observations,
                statistics.observations_used[robot], statistics.rejection_counts[robot])
        self._past_lags.append(self._lags)
        self._lags = Counter()

    def lag(self, robot: str) -> int:
        """
        Return how long [ns] others waited for the odometry of a robot.

        It is the smaller of the longest lags of two periods between reports, so that a single
        delayed message does not count.

        """
        return min(lags[robot] for lags in self._past_lags)

    def waiting(self, robot: str) -> int:
        """Return the number of messages of a robot that wait to be used."""
        statistics = self._consumer.statistics
        return (
            statistics.received[robot] - statistics.rejected[robot] - self._consumer.used(robot))
