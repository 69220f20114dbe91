# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log of a run: one line for each event, found by comparison with the state before."""

from abc import ABC, abstractmethod
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Generic, NamedTuple

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimates import StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.ros.session.input_health import TopicFlow
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity, RepeatableLines
from fej_slam_ros.ros.session.outputs import ConsumerT
from fej_slam_ros.ros.session.rejected_topics import RejectedTopics

#: Maximum number of lines that wait to be written; a run without a node writes none.
MAX_LINES = 1000
#: Period of the reminders of missing input, and their maximum number while the same is missing,
#: in calls of `remind`: every 5 s for a minute, since the node calls it once a second.
REMIND_EVERY = 5
MAX_REMINDERS = 12

#: Reasons for which a pose prior is rejected when it is used.
PRIOR_REASONS = {
    RejectionReason.ALREADY_LOCATED:
        'the robot has joined map at the same step, by what it observes',
    RejectionReason.DOES_NOT_FIT: 'it contradicts what the robot shares with the team',
    RejectionReason.NOT_JOINED: 'it is not known where the robot was in map'}


class Missing(NamedTuple):
    """Input that a run waits for."""

    what: str  #: stays the same while it is missing
    detail: str  #: why, which may change

    def __str__(self) -> str:
        return f'{self.what} ({self.detail})' if self.detail else self.what


class RunLog(ABC, Generic[ConsumerT]):
    """
    The log of one run of an estimator or a smoother.

    Attributes
    ----------
    topic_name : returns the full name of a topic, set by the caller

    """

    def __init__(self, consumer: ConsumerT, inputs: Inputs) -> None:
        self.topic_name: Callable[[str], str] = str
        self._consumer = consumer
        self._inputs = inputs
        self._lines: deque[LogLine] = deque(maxlen=MAX_LINES)
        self._heard: set[str] = set()
        # Time of the newest odometry [ns] of each robot whose odometry has stopped.
        self._stale: dict[str, int] = {}
        self._paused_at: int | None = None  # time of the newest odometry [ns]
        self._has_jumped = False
        self._rejected_topics = RejectedTopics()
        self._repeatable = RepeatableLines()
        self._missing: Sequence[str] = ()
        self._reminders = 0

    def add(self, severity: LogSeverity, text: str) -> None:
        """Add a line."""
        self._lines.append(LogLine(severity, text))

    def description(self) -> str:
        """Return the team and its estimation in a few words."""
        anchor = self._consumer.settings.anchor
        return 'robots ' + ', '.join(
            f'{name} (anchor)' if name == anchor else name for name in self._consumer.robots)

    def take(self) -> Iterator[LogLine]:
        """Yield and remove the new lines."""
        self._note_first_messages()
        self._note_rejected_priors()
        while self._lines:
            yield self._lines.popleft()

    def check(self, now: int) -> None:
        """Add the lines of input that stopped or is back, and of a jump, at a time [ns]."""
        health = self._inputs.health
        flows = {robot: health.flow(robot, 'odom') for robot in self._consumer.robots}
        # Odometry of later times is from before a clock that went back.
        times = [
            flow.last for flow in flows.values() if flow.last is not None and flow.last <= now]
        if times:
            self._note_pause(now, max(times), flows)
            for robot, flow in flows.items():
                # Robots that all stop at once are no fault of one of them.
                self._note_stale(robot, flow, max(times))
        self._lines.extend(self._rejected_topics.lines(
            health, self._consumer.robots, now, self.topic_name))
        self._note_jump()

    def remind(self, faults: Mapping[str, str] | None) -> None:
        """
        Add a line of what the run waits for, every few calls but not for ever.

        `faults` has the conditions of the input of each robot, None without a clock.

        """
        missing = [Missing('/clock', 'use_sim_time is set')] if faults is None else [
            *self._missing_odometry(faults), *self._needs(faults)]
        what = [item.what for item in missing]
        if what != self._missing:
            self._missing, self._reminders = what, 0
        if not what:
            return
        count, rest = divmod(self._reminders, REMIND_EVERY)
        self._reminders += 1
        if rest == 0 and count < MAX_REMINDERS:
            is_last = count == MAX_REMINDERS - 1
            self.add(LogSeverity.INFO, (
                f'waiting for {"; ".join(map(str, missing))}'
                + (' (last reminder, see /diagnostics)' if is_last else '')))

    @abstractmethod
    def _needs(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        """Yield what the estimate waits for, besides odometry."""

    def _missing_odometry(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        for robot in self._consumer.robots:
            if not self._inputs.health.flow(robot, 'odom').received:
                yield Missing(f'odometry of {robot}', faults[robot])

    def _note_pause(self, now: int, newest: int, flows: Mapping[str, TopicFlow]) -> None:
        stale_after = self._inputs.health.stale_after
        is_paused = all(
            flow.has_stopped(now, stale_after) for flow in flows.values() if flow.received)
        if is_paused and self._paused_at is None:
            self._paused_at = newest
            self.add(LogSeverity.INFO, (
                f'input paused: no odometry of any robot for {(now - newest) / NS:.1f} s'))
        elif self._paused_at is not None and not is_paused:
            gap = (newest - self._paused_at) / NS
            self._paused_at = None
            self.add(LogSeverity.INFO, f'input continues after {gap:.1f} s')

    def _note_stale(self, robot: str, flow: TopicFlow, newest: int) -> None:
        is_stale = flow.has_stopped(newest, self._inputs.health.stale_after)
        if is_stale and robot not in self._stale:
            self._stale[robot] = flow.last or 0
            self.add(LogSeverity.WARN, (
                f'{robot} is stale: no odometry for {flow.silence(newest) / NS:.1f} s, the others'
                ' no longer wait for it'))
        elif robot in self._stale and not is_stale:
            gap = (flow.last or 0) - self._stale.pop(robot)
            self.add(LogSeverity.INFO, f'{robot} is back: odometry after {gap / NS:.1f} s')

    def _note_rejected_priors(self) -> None:
        rejected = self._inputs.health.rejected_priors
        while rejected:
            robot, reason = rejected.popleft()
            self._lines.extend(self._repeatable.lines(
                LogSeverity.WARN, f'set_pose of {robot} rejected: {reason.value}'))

    def _note_priors(self, robot: str, until: int) -> None:
        """Add the lines of the poses that were given to a robot up to a stamp [ns]."""
        waiting = self._inputs.health.pose_priors.pop(robot)
        later = [stamp for stamp in waiting if stamp > until]
        if later:
            self._inputs.health.pose_priors[robot] = later
        for given in [stamp for stamp in waiting if stamp <= until]:
            reasons = [
                PRIOR_REASONS[rejected.reason]
                for rejected in self._consumer.statistics.rejections
                if (rejected.robot, rejected.stamp) == (robot, given)
                and rejected.reason in PRIOR_REASONS]
            if reasons:
                line = LogSeverity.WARN, f'set_pose of {robot} rejected: {reasons[0]}'
            else:
                line = LogSeverity.INFO, f'set_pose of {robot} accepted'
            self._lines.extend(self._repeatable.lines(*line))

    def _note_first_messages(self) -> None:
        first = self._inputs.health.first_messages
        while first:
            robot, kind = first.popleft()
            severity = LogSeverity.DEBUG if robot in self._heard else LogSeverity.INFO
            self._heard.add(robot)
            self.add(severity, f'first data of {robot} on {self.topic_name(f"{robot}/{kind}")}')

    def _note_jump(self) -> None:
        error = self._inputs.time_jump_error()
        if error and not self._has_jumped:
            self._has_jumped = True
            self.add(LogSeverity.ERROR, error)


class EstimatorLog(RunLog[Estimator]):
    """The log of one run of an estimator."""

    def __init__(self, estimator: Estimator, inputs: Inputs) -> None:
        super().__init__(estimator, inputs)
        self._lost: set[str] = set()
        self._moved: set[tuple[object, ...]] = set()
        self._relocalized = estimator.statistics.relocalized.copy()
        self._restarted: list[str] = []
        self._was_initialized = estimator.groups.is_initialized
        self._members = self._present_members()
        self._frames = _frames_of(self._members)
        self._states = self._present_states()

    def description(self) -> str:
        """Return the team and its filter in a few words."""
        return f'{super().description()}; filter {self._consumer.settings.filter}'

    def add_step(self, result: StepResult) -> None:
        """Add the lines of a step."""
        self._note_first_messages()
        self._note_step_0(result)
        self._note_restarts()
        members = self._present_members()
        if members != self._members or self._restarted:
            frames = _frames_of(members)
            self._note_frames(frames)
            self._members, self._frames = members, frames
            self._states = self._present_states()
        if not self._was_initialized:
            # Step 0 replaces a state also where no other robot joins.
            self._states = self._present_states()
        for pose in result.poses:
            self._note_lost(pose.robot)
        priors = self._inputs.health.pose_priors
        for robot in [robot for robot in priors if robot in result.odometry]:
            self._note_priors(robot, result.stamp)
        self._was_initialized = self._consumer.groups.is_initialized

    def add_rejections(self, rejections: Iterable[Rejection]) -> None:
        """Add the lines of moved landmarks."""
        settings = self._consumer.settings
        for rejected in rejections:
            if rejected.reason is RejectionReason.MOVED_LANDMARK:
                owner = '' if settings.shared_landmark_ids else rejected.robot
                is_forgotten = settings.moved_landmarks == 'forget'
                key = owner, rejected.id, rejected.stamp if is_forgotten else 0
                if key not in self._moved:
                    self._moved.add(key)
                    self.add(LogSeverity.WARN, (
                        f'landmark {rejected.id}{owner and f" of {owner}"} was moved: '
                        + ('it starts again where it is observed next' if is_forgotten
                           else 'its observations are rejected')))

    def _needs(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        estimator = self._consumer
        anchor = estimator.settings.anchor
        is_anchor_heard = self._inputs.health.flow(anchor, 'odom').received > 0
        if is_anchor_heard and not estimator.groups.is_initialized:
            yield Missing(f'a landmark observed by the anchor {anchor}', faults.get(anchor, ''))
        for robot, reason in estimator.groups.not_in_map.items():
            if estimator.groups.is_initialized and robot in self._frames:
                yield Missing(f'{robot} to join {MAP}', reason)

    def _note_step_0(self, result: StepResult) -> None:
        groups = self._consumer.groups
        if groups.is_initialized and not self._was_initialized:
            self.add(LogSeverity.INFO, (
                f'step 0 at {result.stamp / NS:.3f} s: the anchor {self._consumer.settings.anchor}'
                f' observes its first landmark, in {MAP}: {", ".join(groups.team.robots)}'))

    def _note_restarts(self) -> None:
        relocalized = self._consumer.statistics.relocalized
        self._restarted = [
            name for name in relocalized if relocalized[name] > self._relocalized[name]]
        for robot in self._restarted:
            was_in_map = self._frames.pop(robot, MAP) == MAP
            if robot in self._inputs.health.pose_priors:
                self.add(LogSeverity.INFO, f'{robot} restarts at a pose that is not known')
            else:
                # In a frame of its own it may restart with each message.
                severity = LogSeverity.WARN if was_in_map else LogSeverity.DEBUG
                reason = self._consumer.statistics.restart_reasons[robot]
                self.add(severity, f'{robot} restarts: {reason}')
            self._relocalized[robot] = relocalized[robot]

    def _note_frames(self, frames: dict[str, str]) -> None:
        moved: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        for robot, frame in frames.items():
            if robot not in self._frames:
                self._note_start(robot, frame)
            elif frame != self._frames[robot]:
                moved[self._frames[robot], frame].append(robot)
        for (before, frame), robots in moved.items():
            if frame in self._states:
                cause = self._cause(robots, before, frame)
                self.add(LogSeverity.INFO, f'{" and ".join(robots)} joined {frame}, by {cause}')
            else:
                self.add(LogSeverity.DEBUG, f'{before} is renamed to {frame}')

    def _note_start(self, robot: str, frame: str) -> None:
        if frame == MAP:
            is_first = robot not in self._restarted
            if is_first and robot == self._consumer.settings.anchor:
                cause = 'its anchor_pose'
            elif is_first and self._consumer.robots[robot].start_pose is not None:
                cause = 'its start_pose'
            else:
                cause = 'its observations'
            self.add(LogSeverity.INFO, f'{robot} joined {frame}, by {cause}')
        else:
            self.add(LogSeverity.DEBUG, f'{robot} starts in {frame}')

    def _cause(self, robots: Sequence[str], before: str, frame: str) -> str:
        """Return by what robots joined a frame from the one before."""
        if any(robot in self._inputs.health.pose_priors for robot in robots):
            return 'set_pose'
        if self._consumer.groups.is_initialized and not self._was_initialized:
            return 'the observations at step 0'
        shared = _shared(self._states[frame], self._states[before])
        return shared if self._states[frame].robots else f'{shared} of the prior map'

    def _note_lost(self, robot: str) -> None:
        reason = self._consumer.innovations.lost_robots.reason(robot)
        if reason and robot not in self._lost:
            self._lost.add(robot)
            self.add(LogSeverity.WARN, f'{robot} is likely lost: {reason}')
        elif robot in self._lost and not reason:
            self._lost.remove(robot)
            self.add(
                LogSeverity.INFO, f'{robot} has recovered: its observations fit the map again')

    def _present_members(self) -> list[tuple[str, ...]]:
        """Return each frame with its robots."""
        return [(group.frame, *group.robots) for group in self._consumer.groups]

    def _present_states(self) -> dict[str, JointState]:
        """Return the state of each frame; a join replaces it, so that the old one stays."""
        return {group.frame: group.state for group in self._consumer.groups}


class SmootherLog(RunLog[TeamSmoother]):
    """The log of one run of a smoother."""

    def __init__(self, team: TeamSmoother, inputs: Inputs) -> None:
        super().__init__(team, inputs)
        self._joined: set[str] = set()
        self._unsolved: set[str] = set()
        self._lost: set[str] = set()

    def add_poses(self) -> None:
        """Add the lines of robots that were lost or found with the last poses."""
        team = self._consumer
        for robot in [*self._inputs.health.pose_priors]:
            if robot in team.trajectories:
                self._note_priors(robot, team.trajectories[robot].newest().stamp)
        lost = {robot for robot, trajectory in team.trajectories.items() if trajectory.is_lost}
        for robot in sorted(lost - self._lost):
            reason = team.statistics.restart_reasons[robot]
            self.add(LogSeverity.WARN, f'{robot} goes on in its own frame: {reason}')
        for robot in sorted(self._lost - lost):
            self.add(LogSeverity.INFO, f'{robot} is found by the landmarks of its map')
        self._lost = lost

    def add_solution(self, failed: Mapping[str, str]) -> None:
        """Add the lines of an adopted solution, or of the robots whose solution failed."""
        unsolved = {**self._consumer.solution.unsolved, **failed}
        for robot, trajectory in self._consumer.trajectories.items():
            if trajectory.frame == MAP and robot not in self._joined:
                self._joined.add(robot)
                self.add(LogSeverity.INFO, f'{robot} joined {MAP}, by {self._cause(robot)}')
        for robot in unsolved.keys() - self._unsolved:
            self.add(LogSeverity.WARN, f'{robot} is not smoothed: {unsolved[robot]}')
        for robot in self._unsolved - unsolved.keys():
            self.add(LogSeverity.INFO, f'{robot} is smoothed again')
        self._unsolved = {*unsolved}

    def _needs(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        for robot, reason in self._consumer.not_in_map().items():
            if robot in self._consumer.trajectories:
                yield Missing(f'{robot} to join {MAP}', reason)

    def _cause(self, robot: str) -> str:
        """Return by what a robot joined."""
        is_anchor = robot == self._consumer.settings.anchor
        return 'its anchor_pose' if is_anchor else 'observations of robots and shared landmarks'


def _frames_of(members: Iterable[tuple[str, ...]]) -> dict[str, str]:
    """Return the frame of each robot."""
    return {robot: frame for frame, *robots in members for robot in robots}


def _shared(state: JointState, other: JointState) -> str:
    landmarks = len(state.landmarks.keys() & other.landmarks.keys())
    points = len(state.rendezvous_points.keys() & other.rendezvous_points.keys())
    counts = [(landmarks, 'shared landmark'), (points, 'robot-to-robot observation')]
    return ' and '.join(
        f'{count} {what}{"" if count == 1 else "s"}' for count, what in counts if count
    ) or 'landmarks without ID'
