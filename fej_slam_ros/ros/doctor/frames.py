# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether frames are named so that robots and their sensors are told apart."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

from fej_slam_ros.core.estimator import MAP
from fej_slam_ros.ros.doctor.findings import ERROR, Finding, most_often, WARNING
from fej_slam_ros.ros.doctor.survey import Motion, Survey


def check(survey: Survey, robots: Sequence[str]) -> Iterator[Finding]:
    """Yield what is wrong with the frames of a team; those of scans the estimator judges."""
    owners: defaultdict[str, set[str]] = defaultdict(set)
    for robot in robots:
        topic = survey.motion(robot)
        for what, frames in (('frame_id', topic.frames), ('child_frame_id', topic.child_frames)):
            for frame in frames:
                owners[frame].add(robot)
            yield from _of_odometry(robot, what, topic, robots)
    shared = {frame: names for frame, names in owners.items() if frame and len(names) > 1}
    for frame, names in shared.items():
        if not any(frame.startswith(f'{robot}/') for robot in robots):
            yield Finding(
                WARNING, 'shared_frame', ', '.join(f'{name}/odom' for name in sorted(names)),
                f'they all name the frame {frame!r}',
                f'begin the frames of each robot with its name, as in {min(names)}/{frame}: in one'
                ' tree of transforms a frame is one thing')
    for robot in robots:
        true = survey.topics.get(f'{robot}/ground_truth')
        if true is not None and true.frames.keys() - {'', MAP}:
            yield Finding(
                WARNING, 'wrong_frame', f'{robot}/ground_truth',
                f'its frame is {most_often(true.frames)}, not {MAP!r}',
                f'give the truth in the frame {MAP}, in which the estimate is, or errors mean'
                ' nothing')


def _of_odometry(
    robot: str, what: str, topic: Motion, robots: Sequence[str]
) -> Iterator[Finding]:
    frames = topic.frames if what == 'frame_id' else topic.child_frames
    right = f'{robot}/{"odom" if what == "frame_id" else "base_link"}'
    cure = f'set {what} to {right} in what publishes it'
    alien = {
        frame: count for frame, count in frames.items()
        if any(frame.startswith(f'{other}/') for other in robots if other != robot)}
    if alien:
        yield Finding(
            ERROR, 'wrong_frame', f'{robot}/odom',
            f'{what} is {most_often(alien)}, which is of another robot', cure, sum(alien.values()))
    elif len(frames) > 1:
        yield Finding(
            WARNING, 'wrong_frame', f'{robot}/odom', f'{what} changes: it is {most_often(frames)}',
            f'{cure}, always, and let one node publish the topic', min(frames.values()))
    elif frames.keys() & {MAP, f'{robot}/{MAP}'}:
        yield Finding(
            WARNING, 'wrong_frame', f'{robot}/odom', f'{what} is {most_often(frames)}',
            f'{cure}: the frame of odometry drifts, that of the map does not', frames.total())
    elif frames.keys() == {''}:
        yield Finding(
            WARNING, 'wrong_frame', f'{robot}/odom', f'{what} is empty', cure, frames.total())
