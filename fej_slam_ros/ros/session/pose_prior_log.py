# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log of the poses that are given to robots on ``set_pose``: accepted or rejected, and why."""

from collections import deque
from collections.abc import Iterator

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.ordering.consumer import Consumer
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.input_health import are_repeated, REPEATED_POSES
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity, RepeatableLines

#: Reasons for which a pose prior is rejected when it is used.
PRIOR_REASONS = {
    RejectionReason.ALREADY_LOCATED:
        'the robot has joined map at the same step, by what it observes',
    RejectionReason.DOES_NOT_FIT: 'it contradicts what the robot shares with the team',
    RejectionReason.NOT_JOINED: 'it is not known where the robot was in map'}
#: Time [ns] from the stamp of a pose to the step that uses it, above which the robot has moved on.
MAX_PRIOR_AGE = NS // 2
#: What a pose that is no prior needs, by the reason of its rejection.
PRIOR_CURES = {
    RejectionReason.WRONG_FRAME:
        'wrong_frame, give it in {frame!r}, which is to be the fixed frame of RViz',
    RejectionReason.BAD_COVARIANCE:
        'bad_covariance, give the variances of x, y and yaw, all of them above zero'}


class PosePriorLog:
    """Lines on the pose priors of a run."""

    def __init__(self, consumer: Consumer, inputs: Inputs) -> None:
        self._consumer = consumer
        self._inputs = inputs
        self._repeatable = RepeatableLines()
        # Steps [ns] that have used the latest poses of each robot, and robots with too many.
        self._used: dict[str, deque[int]] = {}
        self._warned: set[str] = set()

    def rejected(self) -> Iterator[LogLine]:
        """Yield the lines of the poses that were rejected when they were received."""
        rejected = self._inputs.health.rejected_priors
        while rejected:
            robot, reason = rejected.popleft()
            cure = PRIOR_CURES.get(reason, reason.value).format(
                frame=self._inputs.frames.published(MAP))
            yield from self._repeatable.lines(
                LogSeverity.WARN, f'set_pose of {robot} rejected: {cure}')

    def due(self, robot: str, until: int) -> Iterator[LogLine]:
        """Yield the lines of the poses that were given to a robot up to a stamp [ns]."""
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
            cause = ''
            if reasons:
                line = LogSeverity.WARN, f'set_pose of {robot} rejected: {reasons[0]}'
            elif given and until - given > MAX_PRIOR_AGE:
                cause = f'late set_pose of {robot}'
                line = LogSeverity.WARN, (
                    f'set_pose of {robot} accepted {(until - given) / NS:.1f} s after its stamp:'
                    ' the robot is placed where it was then')
            else:
                line = LogSeverity.INFO, f'set_pose of {robot} accepted'
            yield from self._repeatable.lines(*line, cause)
            if not reasons:
                yield from self._repeated(robot, until)

    def _repeated(self, robot: str, stamp: int) -> Iterator[LogLine]:
        """Yield a warning, once, if a robot is given too many poses."""
        latest = self._used.setdefault(robot, deque(maxlen=REPEATED_POSES))
        latest.append(stamp)
        if are_repeated([*latest]) and robot not in self._warned:
            self._warned.add(robot)
            yield LogLine(LogSeverity.WARN, (
                f'set_pose of {robot} has come {REPEATED_POSES} times in'
                f' {(latest[-1] - latest[0]) / NS:.1f} s: each restarts the robot, so that poses'
                ' of GPS or of another localisation make it less accurate'))
