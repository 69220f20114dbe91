# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Check of frame names: each robot's frames begin with its own name.

Robots whose topics were renamed keep the frames of their recorded name.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from functools import partial

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.ros.doctor.findings import error_if, Finding, most_frequent, warning
from fej_slam_ros.ros.doctor.survey import Survey

#: Number of messages by frame, of each robot by the name with which its frames begin.
FramesByRobot = Mapping[str, Counter[str]]


def check(survey: Survey, recorded_names: Mapping[str, str], share_tf: bool) -> Iterator[Finding]:
    """
    Yield wrong frames of odometry and ground truth; the estimator checks those of scans.

    Robots that `share_tf` must have different frames.

    """
    owners = _owners(survey, recorded_names)
    frames = {owner: survey.odometry(robot).frames for robot, owner in owners.items()}
    children = {owner: survey.odometry(robot).child_frames for robot, owner in owners.items()}
    topics = {owner: f'{robot}/odom' for robot, owner in owners.items()}
    for owner, topic in topics.items():
        yield from _odometry_frame(
            owner, topic, frames, 'frame_id', f'set frame_id to {owner}/odom')
        yield from _odometry_frame(
            owner, topic, children, 'child_frame_id',
            f'set child_frame_id to {owner}/{_base_name(children[owner])}')
    if share_tf:
        yield from _shared_frames(topics, frames, children)
    for robot in owners:
        truth = survey.topics.get(f'{robot}/ground_truth')
        if truth is not None and truth.frames.keys() - {'', MAP}:
            yield warning(
                'wrong_frame', f'{robot}/ground_truth',
                f'its frame is {most_frequent(truth.frames)}, not {MAP!r}',
                f'publish ground truth in the frame of the estimate, {MAP}')


def _owners(survey: Survey, recorded_names: Mapping[str, str]) -> dict[str, str]:
    """Return the name with which the frames of each robot begin: its recorded one or its own."""
    owners = {
        robot: name if any(_belongs_to(name, frame) for frame in survey.odometry(robot).frames)
        else robot for robot, name in recorded_names.items()}
    is_unique = len({*owners.values()}) == len(owners)
    return owners if is_unique else {robot: robot for robot in owners}


def _base_name(frames: Counter[str]) -> str:
    """Return the last part of the usual child frame of a robot."""
    ((frame, _),) = frames.most_common(1) or [('', 0)]
    return frame.rpartition('/')[2] or 'base_link'


def _odometry_frame(
    robot: str, topic: str, by_robot: FramesByRobot, field: str, cure: str
) -> Iterator[Finding]:
    frames = by_robot[robot]
    foreign = Counter({
        frame: count for frame, count in frames.items()
        if any(_belongs_to(other, frame) for other in by_robot if other != robot)})
    are_prefixed = any(
        _belongs_to(other, frame) for other, theirs in by_robot.items() for frame in theirs)
    finding = partial(error_if(bool(foreign)), 'wrong_frame', topic)
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


def _shared_frames(
    topics: Mapping[str, str], *fields: FramesByRobot
) -> Iterator[Finding]:
    users: defaultdict[str, set[str]] = defaultdict(set)
    for by_robot in fields:
        for robot, frames in by_robot.items():
            for frame in frames:
                users[frame].add(robot)
    for frame, names in users.items():
        if frame and len(names) > 1 and not any(_belongs_to(robot, frame) for robot in fields[0]):
            yield warning(
                'shared_frame', ', '.join(sorted(topics[name] for name in names)),
                f'they all use the frame {frame!r}',
                f'begin the frames of each robot with its name, as in {min(names)}/{frame}, or set'
                ' tf_topics: robot')


def _belongs_to(robot: str, frame: str) -> bool:
    return frame.startswith(f'{robot}/')
