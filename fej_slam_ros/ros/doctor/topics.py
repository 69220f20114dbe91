# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the topics of a team, presence and message types, and of the files that hold them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, warning
from fej_slam_ros.ros.files import bags, front_end_topics
from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots, robots_in
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.topic_types import INITIALPOSE, SENT_TOPICS, TF, TRUE_LANDMARKS


def check(
    topics: Mapping[str, BagTopic], robots: Sequence[str], initialpose_robot: str,
    recorded: RecordedRobots,
) -> Iterator[Finding]:
    """Yield missing, empty, unused and wrongly typed topics, and robots outside of the team."""
    filled = {topic for topic, info in topics.items() if info.messages}
    for robot in robots:
        for kind, type_name in SENT_TOPICS.items():
            topic = topics.get(f'{robot}/{kind}')
            if topic is not None and topic.type_name != type_name:
                yield error_if(kind != 'ground_truth')(
                    'wrong_type', f'{robot}/{kind}', f'its type is {topic.type_name}',
                    f'publish it as {type_name}: a small node can convert it', topic.messages)
        if f'{robot}/odom' not in filled:
            yield error(
                'no_odometry', f'{robot}/odom', _missing(topics, f'{robot}/odom'),
                recorded.cure(robot))
        if f'{robot}/landmarks' not in filled:
            yield _no_landmarks(topics, filled, robot, recorded)
    if INITIALPOSE in filled and len(robots) > 1 and not initialpose_robot:
        yield warning(
            'not_used', INITIALPOSE, 'it is for none of several robots',
            'set the parameter initialpose_robot to its robot', topics[INITIALPOSE].messages)
    yield from _unknown_robots(topics, robots, recorded)


def check_files(path: Path, names: TopicNames) -> Iterator[Finding]:
    """Yield files without checksums, and topics whose messages are not as many as listed."""
    for file, parts in bags.without_checksum(path).items():
        yield warning(
            'no_checksum', file, f'there is no checksum of {parts}: a flipped bit changes them'
            ' unnoticed',
            'record by ros2 bag record as mcap, not with the preset fastwrite or as sqlite3; the'
            ' Python package rosbags writes no checksums')
    for topic, (listed, recorded) in bags.miscounted(path, names).items():
        yield warning(
            'message_count', topic,
            f'metadata.yaml lists {listed} messages, the files have {recorded}',
            f'copy the bag again, or run "ros2 bag reindex {path}" if messages were removed'
            ' on purpose', abs(listed - recorded))


def _unknown_robots(
    topics: Mapping[str, BagTopic], robots: Sequence[str], recorded: RecordedRobots
) -> Iterator[Finding]:
    for name in robots_in(topics):
        if name not in robots:
            yield warning(
                'unknown_robot', name, 'it has topics, but is not in the parameter robots',
                f'add {name} to the parameter robots to include it')
    for name, (odometry, options) in recorded.unknown_robots().items():
        if name not in robots_in(topics):
            yield warning(
                'unknown_robot', odometry, 'it has odometry of no robot in the parameter robots',
                f'add {name} to the parameter robots, and {options}')


def _no_landmarks(
    topics: Mapping[str, BagTopic], filled: set[str], robot: str, recorded: RecordedRobots
) -> Finding:
    observes_robots = f'{robot}/robots' in filled
    return error_if(not observes_robots)(
        'no_landmarks', f'{robot}/landmarks',
        f'{_missing(topics, f"{robot}/landmarks")}, so {robot} observes'
        f' {"no landmarks" if observes_robots else "neither landmarks nor robots"}',
        recorded.landmarks_cure(robot) or front_end_topics.cure(topics, robot) or
        f'record sensor_msgs/PointCloud2 on {robot}/landmarks, or give the topic that has it with'
        f' --remap{_tags_cure(topics, robot)}')


def _tags_cure(topics: Mapping[str, BagTopic], robot: str) -> str:
    """Return how landmarks are computed of AprilTags, '' if the bag can have none."""
    if any(topic in topics for topic in (TF, f'{robot}/{TF}')):
        return '; if a camera saw AprilTags, fej_slam adapt computes it from the transforms on /tf'
    if any('apriltag' in topic.type_name.lower() for topic in topics.values()):
        return '; for the AprilTags record /tf, too, from which fej_slam adapt computes it'
    return ''


def _missing(topics: Mapping[str, BagTopic], topic: str) -> str:
    if topic in topics:
        return 'the topic has no messages'
    kind = topic.rpartition('/')[2]
    similar = ', '.join(sorted(
        other for other in topics if other.endswith(kind) and other != TRUE_LANDMARKS)[:4])
    return 'the topic is missing' + (f' (similar topics: {similar})' if similar else '')
