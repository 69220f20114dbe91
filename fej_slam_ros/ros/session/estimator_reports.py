# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of an estimator: its diagnostics and its log."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
import sys

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimates import StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.session.diagnostics import Diagnostics, percentile_values
from fej_slam_ros.ros.session.faults import Level
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogSeverity
from fej_slam_ros.ros.session.run_log import Missing, RunLog

#: NIS is reported when it has been outside its probability band for this time [ns]; a single
#: outlier has a shorter effect.
NIS_PATIENCE = 5 * NS
#: Ratio of NIS to its expectation, or the inverse, above which it is an error, not a warning.
NIS_ERROR = 4.0
#: Time [ns] since the last restart of a robot within which a further one is not worth a line.
OFTEN = 10 * NS


class EstimatorDiagnostics(Diagnostics[Estimator]):
    """Reports on an estimator and its inputs."""

    node_name = 'estimator'

    def _values_of(self, robot: str) -> dict[str, object]:
        nis = self._consumer.innovations.nis[robot]
        low, high = nis.band()
        without_ids = self._consumer.landmark_manager.counts.get(robot, Counter())
        return {
            'nis': round(nis.total, 3),
            'nis_dof': nis.dof,
            'nis_ratio': round(nis.nis_per_dof(), 3),
            'nis_band': f'{low:.3f}..{high:.3f}',
            **self._clock_values(robot),
            **{f'unnamed_{event}': n for event, n in without_ids.items()},
            **self._errors(robot),
        }

    def _errors(self, robot: str) -> dict[str, float]:
        """Return RMSE and NEES of a robot's poses, empty without ground truth."""
        score = self._consumer.evaluation.scores.get(robot)
        if score is None:
            return {}
        nees = {'nees': score.mean_nees_per_dof(), 'nees_latest': score.latest_nees_per_dof}
        return {
            'position_rmse_m': round(score.position_rmse(), 6),
            'heading_rmse_rad': round(score.heading_rmse(), 6),
            **{name: round(value, 3) for name, value in nees.items() if value is not None},
        }

    def _needs_observations(self, robot: str) -> bool:
        return self._is_before_step_0(robot) or robot in self._consumer.groups.not_in_map

    def _publishes_tf(self) -> bool:
        return self.settings.publish_tf

    def _is_before_step_0(self, robot: str) -> bool:
        estimator = self._consumer
        return robot == estimator.settings.anchor and not estimator.groups.is_initialized

    def _state_of(self, robot: str) -> tuple[Level, str]:
        nis = self._consumer.innovations.nis[robot]
        level, message = _consistency(nis)
        lost = self._consumer.innovations.lost_robots.reason(robot)
        if lost:
            # Covariances that are far too small are a cause, too.
            is_overconfident = level > Level.OK and nis.nis_per_dof() > 1.0
            cause = f'; {message}' if is_overconfident else ''
            return Level.ERROR, f'likely lost: {lost}{cause}'
        not_joined = self._consumer.groups.not_in_map.get(robot)
        if not_joined:
            return Level.WARN, f'{robot} not joined: {not_joined}'
        if self._is_before_step_0(robot):
            return Level.OK, f'in {MAP}; no landmark observed yet'
        return level, message

    def _overall(self, now: int, at_rest: bool) -> Message:
        estimator = self._consumer
        state = {'state_hash': estimator.state_hash()} if at_rest else {}
        moved = [
            f'{robot}:{id_}' if robot else str(id_)
            for robot, id_ in estimator.groups.moved_landmarks()]
        if moved:
            state['moved_landmarks'] = ', '.join(moved)
        warnings = ['landmarks were moved'] if moved else []
        team = estimator.groups.team.state
        confirmed = len(team.confirmed_landmarks())
        return self._status('filter', now, warnings, {
            'filter': estimator.settings.filter,
            'robots': len(team.robots),
            'landmarks': confirmed,
            'provisional_landmarks': len(team.landmarks) - confirmed,
            'steps': len(self.step_times),
            **percentile_values('step', self.step_times),
            **percentile_values('latency', self.latencies),
            **state,
        })


def _consistency(nis: NisMonitor) -> tuple[Level, str]:
    """Return level and message of a robot in ``map`` by its NIS."""
    if nis.outside_for < NIS_PATIENCE:
        return Level.OK, 'in map'
    ratio = nis.nis_per_dof()
    over = ratio > 1.0
    factor = ratio if over else 1.0 / max(ratio, 1e-9)
    level = Level.ERROR if factor >= NIS_ERROR else Level.WARN
    return level, f'{"over" if over else "under"}confident by a factor of {factor:.1f}'


class EstimatorLog(RunLog[Estimator]):
    """The log of one run of an estimator."""

    def __init__(self, estimator: Estimator, inputs: Inputs) -> None:
        super().__init__(estimator, inputs)
        self._lost: set[str] = set()
        # When landmarks were moved last [ns] by owner and ID, 0 for those that are not forgotten.
        self._moved: dict[tuple[str, int | None], int] = {}
        self._relocalized = estimator.statistics.relocalized.copy()
        self._restart_stamps: dict[str, int] = {}  # of the latest restart of each robot [ns]
        self._restarts_often: dict[str, bool] = {}  # whether it soon followed the one before
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
        restarted = self._note_restarts(result.stamp)
        members = self._present_members()
        if members != self._members or restarted:
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
                key, stamp = (owner, rejected.id), rejected.stamp if is_forgotten else 0
                if self._moved.get(key) != stamp:
                    self._moved[key] = stamp
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

    def _note_restarts(self, stamp: int) -> list[str]:
        relocalized = self._consumer.statistics.relocalized
        restarted = [
            name for name in relocalized if relocalized[name] > self._relocalized[name]]
        for robot in restarted:
            was_in_map = self._frames.pop(robot, MAP) == MAP
            is_often = stamp - self._restart_stamps.get(robot, -sys.maxsize) < OFTEN
            self._restart_stamps[robot], self._restarts_often[robot] = stamp, is_often
            if robot in self._inputs.health.pose_priors:
                self.add(LogSeverity.INFO, f'{robot} restarts at a pose that is not known')
            else:
                # It may restart with each message: in a frame of its own, or by two drivers.
                severity = (
                    LogSeverity.WARN if was_in_map and not is_often else LogSeverity.DEBUG)
                reason = self._consumer.statistics.restart_reasons[robot]
                self.add(severity, f'{robot} restarts: {reason}')
            self._relocalized[robot] = relocalized[robot]
        return restarted

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
                self.add(
                    self._severity_of_joins(robots),
                    f'{" and ".join(robots)} joined {frame}, by {cause}')
            else:
                self.add(LogSeverity.DEBUG, f'{before} is renamed to {frame}')

    def _note_start(self, robot: str, frame: str) -> None:
        if frame == MAP:
            self.add(
                self._severity_of_joins([robot]),
                f'{robot} joined {frame}, by {self._cause_of_start(robot)}')
        else:
            self.add(LogSeverity.DEBUG, f'{robot} starts in {frame}')

    def _cause_of_start(self, robot: str) -> str:
        """Return by what a robot has begun in ``map``."""
        if self._is_placed(robot):
            return 'set_pose'
        if robot not in self._consumer.groups.void_starts:
            if robot == self._consumer.settings.anchor:
                return 'its anchor_pose'
            if self._consumer.robots[robot].start_pose is not None:
                return 'its start_pose'
        return 'its observations'

    def _is_placed(self, robot: str) -> bool:
        """Return whether a robot is where a pose prior has placed it."""
        health = self._inputs.health
        return robot in health.pose_priors and robot in health.placed

    def _severity_of_joins(self, robots: Sequence[str]) -> LogSeverity:
        are_often = all(self._restarts_often.get(robot, False) for robot in robots)
        return LogSeverity.DEBUG if are_often else LogSeverity.INFO

    def _cause(self, robots: Sequence[str], before: str, frame: str) -> str:
        """Return by what robots joined a frame from the one before."""
        if any(map(self._is_placed, robots)):
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


def _frames_of(members: Iterable[tuple[str, ...]]) -> dict[str, str]:
    """Return the frame of each robot."""
    return {robot: frame for frame, *robots in members for robot in robots}


def _shared(state: JointState, other: JointState) -> str:
    landmarks = len(state.landmarks.keys() & other.landmarks.keys())
    points = len(state.rendezvous_points.keys() & other.rendezvous_points.keys())
    counts = [(landmarks, 'shared landmark'), (points, 'robot-to-robot observation')]
    return ' and '.join(
        counted(count, what) for count, what in counts if count) or 'landmarks without ID'
