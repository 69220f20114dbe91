# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What operators must see: the state of every robot and of the filter, REP-107."""

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticStatus as DiagnosticStatus)

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings, QOS_OVERRIDES
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import DIAGNOSTICS, Publication
from fej_slam_ros.ros.session.percentiles import spread

#: So many times are kept from one report to the next.
KEPT = 10_000
#: NIS that has been outside of its band for so long [ns] is told, and from this ratio on an error.
NIS_PATIENCE = 5 * NS
NIS_ERROR = 4.0

#: What a publisher offers and a subscription wants where that keeps them apart.
QOS_STRENGTHS = {
    'reliability': ('BEST_EFFORT', 'RELIABLE'), 'durability': ('VOLATILE', 'TRANSIENT_LOCAL')}


@dataclass(frozen=True)
class IncompatibleQos:
    """
    An end of a topic elsewhere with which this node exchanges nothing.

    Attributes
    ----------
    topic : its full name
    own : what this node has there, ``subscription`` or ``publisher``
    policy : of quality of service that does not fit, such as ``reliability``

    """

    topic: str
    own: str
    policy: str

    def __str__(self) -> str:
        if self.policy not in QOS_STRENGTHS:
            return (
                f'{self.topic}: a subscription wants a {self.policy} that this node does not'
                ' offer: leave it out there')
        offered, wanted = QOS_STRENGTHS[self.policy]
        ends, cure = f'a subscription wants {wanted}, this node offers {offered}', wanted
        if self.own == 'subscription':
            ends, cure = f'a publisher offers {offered}, this node wants {wanted}', offered
        name = f'{QOS_OVERRIDES}{self.topic}.{self.own}.{self.policy}'
        return f'{self.topic}: {ends}: set {name}: {cure.lower()}'


class AnyDiagnostics(ABC):
    """
    What reports on an estimator and on a smoother have in common.

    Parameters
    ----------
    of, inputs : what is reported on
    clock_limit : warn if stamps and clock of reception differ by more [s]

    Attributes
    ----------
    step_times : durations [s] of the steps since the last report, filled in by the caller
    latencies : of each pose published since, how long [s] after its stamp, likewise
    hold_times : durations [s] for which nothing else could be done, likewise
    incompatible : what is wrong with the topics, filled in by the caller

    """

    def __init__(
        self, of: Estimator | TeamSmoother, inputs: Inputs, clock_limit: float
    ) -> None:
        self._of = of
        self._clock_limit = clock_limit
        self._inputs = inputs
        self._received: Counter[str] = Counter()
        self._at: int | None = None
        self.step_times: deque[float] = deque(maxlen=KEPT)
        self.latencies: deque[float] = deque(maxlen=KEPT)
        self.hold_times: deque[float] = deque(maxlen=KEPT)
        self.incompatible: Sequence[IncompatibleQos] = ()

    def report(self, now: int, at_rest: bool) -> Publication:
        """
        Return the report for a time [ns]; rates are since the last one.

        At rest, when the input has paused or ended, the hash of the state is also told, which
        would take too long otherwise.

        """
        elapsed = 0.0 if self._at is None else (now - self._at) * 1e-9
        statuses = [*self._robots(elapsed), self._qos(), self._whole(at_rest)]
        self._at = now
        self._received = self._of.statistics.received.copy()
        self.step_times.clear()
        self.latencies.clear()
        self.hold_times.clear()
        return DIAGNOSTICS, outgoing.diagnostics(now, statuses)

    @abstractmethod
    def _state_of(self, robot: str) -> tuple[int, str]:
        """Return level and message of a robot."""

    @abstractmethod
    def _values_of(self, robot: str) -> dict[str, object]:
        """Return figures of a robot besides what became of its input."""

    @abstractmethod
    def _whole(self, at_rest: bool) -> Message:
        """Return the state of the estimate as a whole."""

    def _robots(self, elapsed: float) -> Iterator[Message]:
        statistics = self._of.statistics
        for name in self._of.robots:
            since = statistics.received[name] - self._received[name]
            yield outgoing.diagnostic_status(
                name, *self._with_clock(name, *self._state_of(name)), {
                    'received': statistics.received[name],
                    'used': self._of.used(name),
                    'sightings_used': statistics.observations_used[name],
                    'sightings_relaxed': statistics.observations_inflated[name],
                    'rate_hz': round(since / elapsed, 2) if elapsed > 0.0 else 0.0,
                    'delay_s': round(self._inputs.delays.get(name, 0) * 1e-9, 6),
                    'released_without': statistics.released_without[name],
                    'located_anew': statistics.relocalized[name],
                    'longest_late_s': round(statistics.longest_delay[name] * 1e-9, 6),
                    **self._values_of(name),
                    **{reason.value: n for reason, n in statistics.rejection_counts[name].items()},
                })

    def _clock_values(self, robot: str) -> dict[str, float]:
        offset = self._inputs.clocks.offset(robot)
        return {} if offset is None else {'clock_offset_s': round(offset / NS, 6)}

    def _with_clock(self, robot: str, level: int, message: str) -> tuple[int, str]:
        """Add to level and message of a robot that its stamps and the clock differ."""
        delay = self._inputs.clocks.delay(robot) or 0
        if abs(delay) <= self._clock_limit * NS:
            return level, message
        side = 'behind' if delay > 0 else 'ahead of'
        told = f'stamps of {robot} are {abs(delay) / NS:.3f} s {side} the clock of reception'
        return max(level, DiagnosticStatus.WARN), f'{message}; {told}'

    def _judged(
        self, name: str, warnings: Sequence[str], values: Mapping[str, object]
    ) -> Message:
        """Return the state of the whole: an error once time has jumped back."""
        jump = self._inputs.time_jump_detector.jump
        if jump is None:
            level = DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK
            return outgoing.diagnostic_status(
                name, level, '; '.join(warnings) or 'running', values)
        told = (
            f'time jumped back by {jump.by / NS:.3f} s, all input is refused: call ~/reset for a'
            ' new run')
        return outgoing.diagnostic_status(
            name, DiagnosticStatus.ERROR, '; '.join([told, *warnings]), values)

    def _qos(self) -> Message:
        return outgoing.diagnostic_status(
            'qos', DiagnosticStatus.ERROR if self.incompatible else DiagnosticStatus.OK,
            '; '.join(map(str, self.incompatible)) or 'compatible', {})


class Diagnostics(AnyDiagnostics):
    """
    Reports on an estimator.

    Parameters
    ----------
    estimator, inputs : what is reported on

    Attributes
    ----------
    unsaved : why the run could not be saved, '' where it could, filled in by the caller

    """

    def __init__(
        self, estimator: Estimator, inputs: Inputs, clock_limit: float = NodeSettings.clock_limit
    ) -> None:
        super().__init__(estimator, inputs, clock_limit)
        self._estimator = estimator
        self.unsaved = ''

    def _values_of(self, robot: str) -> dict[str, object]:
        """Return how consistent a robot is."""
        nis = self._estimator.innovations.nis[robot]
        low, high = nis.band()
        return {
            'nis': round(nis.total, 3),
            'nis_dof': nis.dof,
            'nis_ratio': round(nis.ratio(), 3),
            'nis_band': f'{low:.3f}..{high:.3f}',
            **self._clock_values(robot),
            **self._without_identity(robot),
            **self._scores(robot),
        }

    def _without_identity(self, robot: str) -> dict[str, int]:
        """Return what became of observations whose landmark nobody has named, if there were any."""
        counts = self._estimator.landmark_manager.counts
        return {f'unnamed_{event}': n for event, n in counts.get(robot, Counter()).items()}

    def _scores(self, robot: str) -> dict[str, float]:
        """Return how a robot's poses compare with ground truth, where there is any."""
        score = self._estimator.evaluation.scores.get(robot)
        if score is None:
            return {}
        nees = {'nees': score.mean_nees(), 'nees_latest': score.latest_nees}
        return {
            'position_rmse_m': round(score.position_rmse(), 6),
            'heading_rmse_rad': round(score.heading_rmse(), 6),
            **{name: round(value, 3) for name, value in nees.items() if value is not None},
        }

    def _state_of(self, robot: str) -> tuple[int, str]:
        """Return level and message of a robot, the worst first."""
        lost = self._estimator.innovations.lost_robots.why(robot)
        if lost:
            return DiagnosticStatus.ERROR, f'likely lost: {lost}'
        not_joined = self._estimator.groups.not_in_map.get(robot)
        if not_joined:
            return DiagnosticStatus.WARN, f'{robot} not joined: {not_joined}'
        return _consistency(self._estimator.innovations.nis[robot])

    def _whole(self, at_rest: bool) -> Message:
        estimator = self._estimator
        state = {'state_hash': estimator.state_hash()} if at_rest else {}
        moved = [f'{robot}:{n}' if robot else str(n) for robot, n in estimator.groups.moved_landmarks()]
        if moved:
            state['moved_landmarks'] = ', '.join(moved)
        warnings = ['landmarks were moved'] if moved else []
        if estimator.statistics.depends_on_arrival():
            warnings.append('the result depended on arrival')
        if self.unsaved:
            warnings.append(f'not saved: {self.unsaved}')
        team = estimator.maps()[0]
        return self._judged('filter', warnings, {
            'filter': estimator.settings.filter,
            'robots': len(team.robots),
            'landmarks': len(team),
            'provisional_landmarks': team.tentative,
            'steps': len(self.step_times),
            **_spread('step', self.step_times),
            **_spread('latency', self.latencies),
            **state,
        })


class SmootherDiagnostics(AnyDiagnostics):
    """
    Reports on a smoother.

    Parameters
    ----------
    team, inputs : what is reported on

    Attributes
    ----------
    solve_time : how long the last solution took [s]

    """

    def __init__(self, team: TeamSmoother, inputs: Inputs, clock_limit: float) -> None:
        super().__init__(team, inputs, clock_limit)
        self._team = team
        self.solve_time = 0.0

    def _state_of(self, robot: str) -> tuple[int, str]:
        """Return level and message of a robot, the worst first."""
        way = self._team.trajectories.get(robot)
        trouble = way.error if way is not None else ''
        trouble = trouble or self._team.solution.unsolved.get(robot, '')
        if trouble:
            return DiagnosticStatus.ERROR, f'not smoothed: {trouble}'
        not_joined = self._team.not_in_map().get(robot)
        if not_joined:
            return DiagnosticStatus.WARN, f'{robot} not joined: {not_joined}'
        return DiagnosticStatus.OK, f'in {MAP}'

    def _values_of(self, robot: str) -> dict[str, object]:
        return {'steps': self._team.steps[robot], **self._clock_values(robot)}

    def _whole(self, at_rest: bool) -> Message:
        team = self._team
        state = {'state_hash': team.state_hash()} if at_rest else {}
        arrived = team.statistics.depends_on_arrival()
        return self._judged('smoother', ['the result depended on arrival'] if arrived else [], {
            'robots': sum(way.frame == MAP for way in team.trajectories.values()),
            'landmarks': team.solution.landmarks_in_map(),
            'poses': sum(len(way.stamps) for way in team.trajectories.values()),
            'poses_since_solution': team.new_poses,
            'solve_time_s': round(self.solve_time, 6),
            'steps': len(self.step_times),
            **_spread('step', self.step_times),
            **_spread('hold', self.hold_times),
            **state,
        })


def _spread(of: str, times: Collection[float]) -> dict[str, float]:
    """Return how times [s] of something are spread, half of them below the median."""
    return {
        f'{name}_{of}_s': round(value, 6)
        for name, value in asdict(spread(np.array([*times]))).items()}


def _consistency(nis: NisMonitor) -> tuple[int, str]:
    """Return level and message of a robot in the map."""
    if nis.outside_for < NIS_PATIENCE:
        return DiagnosticStatus.OK, 'in map'
    ratio = nis.ratio()
    over = ratio > 1.0
    factor = ratio if over else 1.0 / max(ratio, 1e-9)
    level = DiagnosticStatus.ERROR if factor >= NIS_ERROR else DiagnosticStatus.WARN
    return level, f'{"over" if over else "under"}confident by {factor:.1f}'
