# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of the messages and objects of an adapter, and what users have to know of them."""

from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.frames import FrameNames
from fej_slam_ros.ros.session.front_end import RECENT_REPORTS, RobotCounts
from fej_slam_ros.ros.session.landmark_ids import LandmarkIds
from fej_slam_ros.ros.session.object_queue import ObjectQueue, Origin
from fej_slam_ros.ros.session.sensor_frames import SensorFrames

#: What detections need that are rejected, by the reason, where the reason does not say it.
CURES = {
    RejectionReason.NO_IDENTITY.value:
        'they have no hypothesis, use the format detection3d_track or detection3d_anonymous',
    RejectionReason.DUPLICATE_ID.value:
        'objects of one class are no landmarks by it, use the format detection3d_track or'
        ' detection3d_anonymous; print each tag once',
    RejectionReason.BAD_COVARIANCE.value:
        'give variances of x, y and z above zero, or all zero if they are unknown',
    RejectionReason.OUT_OF_RANGE.value: 'give metres and m^2, see max_range'}
#: Name in reports of what is on topics of the team and of an unknown robot.
UNKNOWN_ROBOT = 'unknown robot'


class AdapterCounts:
    """Counts of the messages and objects of each robot, and warnings that follow from them."""

    def __init__(
        self, robots: Collection[str], object_topics: Collection[str], frames: SensorFrames,
        queue: ObjectQueue, ids: LandmarkIds,
    ) -> None:
        self._robots, self._object_topics = robots, object_topics
        self._frames, self._queue, self._ids = frames, queue, ids
        # The name of an ignored object, by the robot of its topic, '' for those of the team.
        self._ignored: dict[str, str] = {}
        self._counts: dict[str, Counter[str]] = {
            name: Counter(messages=0, landmarks=0, robots=0)
            for name in (*robots, UNKNOWN_ROBOT)}
        # The counts at the latest reports.
        self._earlier: deque[dict[str, Counter[str]]] = deque([{}], RECENT_REPORTS)

    def add(self, robot: str, **counts: int) -> None:
        self._counts[robot].update(counts)

    def reject(self, robot: str, reason: RejectionReason, count: int = 1) -> None:
        """Count rejected messages or objects."""
        if count:
            self._counts[robot or UNKNOWN_ROBOT][f'rejected_{reason.value}'] += count

    def ignore(self, robot: str, frame: str, names: Sequence[str]) -> None:
        """Count objects that are not used, with one as an example if it is no link of a robot."""
        self._counts[robot or UNKNOWN_ROBOT]['ignored'] += len(names)
        if not any(
            self._frames.names.is_base(other, frame) or self._frames.is_fixed(other, frame)
            for other in self._robots
        ):
            self._ignored[robot] = names[-1]

    def report(self) -> Iterator[RobotCounts]:
        """Yield each robot, its warning, and the counts of its messages and observations."""
        counts = {name: Counter(of_robot) for name, of_robot in self._counts.items()}
        for origin, number in self._queue.waiting().items():
            counts[self._reported(origin)]['waiting'] += number
        for origin, number in self._queue.dropped.items():
            counts[self._reported(origin)][f'rejected_{RejectionReason.WRONG_FRAME.value}'] += (
                number)
        earlier = self._earlier[0]
        self._earlier.append(counts)
        for name, of_robot in counts.items():
            if name != UNKNOWN_ROBOT or of_robot.total() > of_robot['ignored']:
                warning = (
                    self._why_nothing(name, of_robot)
                    or _why_rejected(of_robot - earlier.get(name, Counter()), of_robot))
                yield name, [warning] if warning else [], {
                    **of_robot, 'waiting': of_robot['waiting'],
                    'transforms_rejected': self._frames.rejected.total()}

    def _reported(self, origin: Origin) -> str:
        return self._queue.owner(origin) or UNKNOWN_ROBOT

    def _why_nothing(self, name: str, counts: Counter[str]) -> str:
        """Return why nothing of a robot, or not all, can be used at all, '' if all can be."""
        origins = self._queue.unknown()
        frames = [origin.frame for origin in origins if self._reported(origin) == name]
        if frames and self._frames.is_fixed(name, frames[0]):
            return (
                f'the frame {frames[0]!r} is that of a map or of odometry: publish detections in'
                ' the frame of their camera')
        if frames:
            return _unknown_pose(name, frames[0], self._frames.names)
        if self._ids.conflicts:
            return (
                f'{len(self._ids.conflicts)} names have no ID of their own, such as'
                f' {min(self._ids.conflicts)!r}: give them IDs in ids_file')
        if name != UNKNOWN_ROBOT and not counts['messages']:
            return self._why_no_messages(name, origins)
        return ''

    def _why_no_messages(self, name: str, origins: Sequence[Origin]) -> str:
        """Return why no message of a robot was used."""
        ignored = self._ignored.get(name) or self._ignored.get('')
        if ignored:
            return (
                "no object has a name that matches the parameter 'names', for example"
                f' {ignored!r}')
        if not all(map(self._queue.owner, origins)):
            return f'no detections that are known to be its own, see {UNKNOWN_ROBOT}'
        topics = ', '.join(topic for topic in self._object_topics if topic.startswith(f'{name}/'))
        return f'no detections: publish them on {topics or "/tf"}'


def _why_rejected(recent: Counter[str], counts: Counter[str]) -> str:
    """Return why most of the recent detections were rejected, '' if most were used."""
    rejected = Counter({
        key.removeprefix('rejected_'): n for key, n in recent.items()
        if key.startswith('rejected_')})
    used = recent['landmarks'] + recent['robots']
    if counts['landmarks'] + counts['robots']:
        # What is too far away may be so on purpose.
        del rejected[RejectionReason.OUT_OF_RANGE.value]
    if rejected.total() <= used:
        return ''
    (reason, _), = rejected.most_common(1)
    return f'{"most" if used else "all"} detections are rejected, most as {reason}' + (
        f': {CURES[reason]}' if reason in CURES else '')


def _unknown_pose(name: str, frame: str, names: FrameNames) -> str:
    """Return the sentence on a sensor whose robot, or whose pose on its robot, is unknown."""
    if name == UNKNOWN_ROBOT:
        return (
            f'the frame {frame!r} is of no robot, or which one is not known from odometry'
            ' and static transforms: begin it with the name of the robot, or publish on'
            ' <robot>/tf')
    if not frame:
        return f'the messages have no frame_id: set it in the detector, or set {name}.sensor_pose'
    return (
        f'no static transform from the frame {frame!r} to the base frame {names.base(name)!r}:'
        f' publish it on /tf_static, or set {name}.sensor_pose')
