# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of frame names: each robot's frames begin with its own name."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.ros.doctor.findings import error_if, Finding, most_frequent, warning
from fej_slam_ros.ros.doctor.survey import Survey

#: Number of messages by frame, of each robot.
FramesByRobot = Mapping[str, Counter[str]]


def check(survey: Survey, robots: Sequence[str]) -> Iterator[Finding]:
    """Yield wrong frames of odometry and ground truth; the estimator checks those of scans."""
    frames = {robot: survey.odometry(robot).frames for robot in robots}
    children = {robot: survey.odometry(robot).child_frames for robot in robots}
    for field, right, by_robot in (
            ('frame_id', 'odom', frames), ('child_frame_id', 'base_link', children)):
        for robot in robots:
            yield from _odometry_frame(robot, by_robot, field, f'set {field} to {robot}/{right}')
    yield from _shared_frames(frames, children)
    for robot in robots:
        truth = survey.topics.get(f'{robot}/ground_truth')
        if truth is not None and truth.frames.keys() - {'', MAP}:
            yield warning(
                'wrong_frame', f'{robot}/ground_truth',
                f'its frame is {most_frequent(truth.frames)}, not {MAP!r}',
                f'publish ground truth in the frame of the estimate, {MAP}')


def _odometry_frame(
    robot: str, by_robot: FramesByRobot, field: str, cure: str
) -> Iterator[Finding]:
    frames = by_robot[robot]
    foreign = Counter({
        frame: count for frame, count in frames.items()
        if any(_belongs_to(other, frame) for other in by_robot if other != robot)})
    are_prefixed = any(
        _belongs_to(other, frame) for other, theirs in by_robot.items() for frame in theirs)
    finding = partial(error_if(bool(foreign)), 'wrong_frame', f'{robot}/odom')
    what, count = f'{field} is {most_frequent(foreign or frames)}', frames.total()
    if foreign:
        yield finding(f'{what}, a frame of another robot', cure, foreign.total())
    elif len(frames) > 1:
        yield finding(
            f'{what}: it changes', f'{cure} in all messages, and publish the topic from one node'
            ' only', min(frames.values()))
    elif frames.keys() & {MAP, f'{robot}/{MAP}'}:
        yield finding(what, f'{cure}: the odometry frame drifts, the map frame does not', count)
    elif frames.keys() == {''}:
        yield finding(f'{field} is empty', cure, count)
    elif are_prefixed and not all(_belongs_to(robot, frame) for frame in frames):
        yield finding(
            f'{what}, while frames of other robots begin with their names', cure, count)


def _shared_frames(*fields: FramesByRobot) -> Iterator[Finding]:
    users: defaultdict[str, set[str]] = defaultdict(set)
    for by_robot in fields:
        for robot, frames in by_robot.items():
            for frame in frames:
                users[frame].add(robot)
    for frame, names in users.items():
        if frame and len(names) > 1 and not any(_belongs_to(robot, frame) for robot in fields[0]):
            yield warning(
                'shared_frame', ', '.join(f'{name}/odom' for name in sorted(names)),
                f'they all use the frame {frame!r}',
                f'begin the frames of each robot with its name, as in {min(names)}/{frame}')


def _belongs_to(robot: str, frame: str) -> bool:
    return frame.startswith(f'{robot}/')
