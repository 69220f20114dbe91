# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether frames are named so that robots and their sensors are told apart."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.ros.doctor.findings import ERROR, Finding, most_often, WARNING
from fej_slam_ros.ros.doctor.survey import Survey


def check(survey: Survey, robots: Sequence[str]) -> Iterator[Finding]:
    """Yield what is wrong with the frames of a team; those of scans the estimator judges."""
    named = {robot: survey.motion(robot).frames for robot in robots}
    children = {robot: survey.motion(robot).child_frames for robot in robots}
    for what, right, frames in (
            ('frame_id', 'odom', named), ('child_frame_id', 'base_link', children)):
        for robot in robots:
            yield from _of_odometry(robot, frames, what, f'set {what} to {robot}/{right}')
    yield from _shared(named, children)
    for robot in robots:
        true = survey.topics.get(f'{robot}/ground_truth')
        if true is not None and true.frames.keys() - {'', MAP}:
            yield Finding(
                WARNING, 'wrong_frame', f'{robot}/ground_truth',
                f'its frame is {most_often(true.frames)}, not {MAP!r}',
                f'give the truth in the frame {MAP}, in which the estimate is, or errors mean'
                ' nothing')


def _of_odometry(
    robot: str, of_team: Mapping[str, Counter[str]], what: str, cure: str
) -> Iterator[Finding]:
    """Yield what is wrong with a frame of a robot, of those that all robots name."""
    where, frames = f'{robot}/odom', of_team[robot]
    alien = {
        frame: count for frame, count in frames.items()
        if any(_is_of(other, frame) for other in of_team if other != robot)}
    are_own = any(_is_of(other, frame) for other, theirs in of_team.items() for frame in theirs)
    if alien:
        yield Finding(
            ERROR, 'wrong_frame', where,
            f'{what} is {most_often(alien)}, which is of another robot', cure, sum(alien.values()))
    elif len(frames) > 1:
        yield Finding(
            WARNING, 'wrong_frame', where, f'{what} changes: it is {most_often(frames)}',
            f'{cure}, always, and let one node publish the topic', min(frames.values()))
    elif frames.keys() & {MAP, f'{robot}/{MAP}'}:
        yield Finding(
            WARNING, 'wrong_frame', where, f'{what} is {most_often(frames)}',
            f'{cure}: the frame of odometry drifts, that of the map does not', frames.total())
    elif frames.keys() == {''}:
        yield Finding(
            WARNING, 'wrong_frame', where, f'{what} is empty', cure, frames.total())
    elif are_own and not all(_is_of(robot, frame) for frame in frames):
        yield Finding(
            WARNING, 'wrong_frame', where,
            f'{what} is {most_often(frames)}, while others begin theirs with their names', cure,
            frames.total())


def _shared(*told: Mapping[str, Counter[str]]) -> Iterator[Finding]:
    """Yield which frames several robots name, none of them as its own."""
    owners: defaultdict[str, set[str]] = defaultdict(set)
    for of_team in told:
        for robot, frames in of_team.items():
            for frame in frames:
                owners[frame].add(robot)
    for frame, names in owners.items():
        if frame and len(names) > 1 and not any(_is_of(robot, frame) for robot in told[0]):
            yield Finding(
                WARNING, 'shared_frame', ', '.join(f'{name}/odom' for name in sorted(names)),
                f'they all name the frame {frame!r}',
                f'begin the frames of each robot with its name, as in {min(names)}/{frame}: in one'
                ' tree of transforms a frame is one thing')


def _is_of(robot: str, frame: str) -> bool:
    return frame.startswith(f'{robot}/')
