# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the topics of a team: presence and message types."""

from collections.abc import Iterator, Mapping, Sequence
import re

from fej_slam_ros.ros.doctor.findings import error, Finding, Severity, warning
from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.parameters import RESERVED_NAMES
from fej_slam_ros.ros.session.inputs import SENT_TOPICS

ROBOT_NAME = re.compile('[A-Za-z][A-Za-z0-9_]*')
OBSERVATION_TOPICS = ('landmarks', 'robots')


def robots_in(topics: Mapping[str, BagTopic]) -> list[str]:
    """Return the robots that have input topics in a bag; a latched map is not an input."""
    names = set()
    for topic, info in topics.items():
        name, _, kind = topic.rpartition('/')
        is_map = kind == 'landmarks' and info.latched
        is_robot = ROBOT_NAME.fullmatch(name) and name not in RESERVED_NAMES
        if kind in SENT_TOPICS and is_robot and not is_map:
            names.add(name)
    return sorted(names, key=lambda name: (re.sub(r'\d+', '', name), len(name), name))


def check(topics: Mapping[str, BagTopic], robots: Sequence[str]) -> Iterator[Finding]:
    """Yield missing, empty and wrongly typed topics, and robots that are not in the team."""
    filled = {topic for topic, info in topics.items() if info.messages}
    for robot in robots:
        yield from _wrong_types(topics, robot)
        if f'{robot}/odom' not in filled:
            yield error(
                'no_odometry', f'{robot}/odom', _missing(topics, f'{robot}/odom'),
                f'record nav_msgs/Odometry on {robot}/odom, or remap the topic that has it;'
                f' without it {robot} is not estimated')
        if f'{robot}/landmarks' not in filled:
            yield _no_landmarks(topics, filled, robot)
    for name in robots_in(topics):
        if name not in robots:
            yield warning(
                'unknown_robot', name, 'it has topics, but is not in the parameter robots',
                f'add {name} to the parameter robots to include it')


def _wrong_types(topics: Mapping[str, BagTopic], robot: str) -> Iterator[Finding]:
    for kind, type_name in SENT_TOPICS.items():
        topic = topics.get(f'{robot}/{kind}')
        if topic is not None and topic.type_name != type_name:
            yield Finding(
                Severity.WARNING if kind == 'ground_truth' else Severity.ERROR, 'wrong_type',
                f'{robot}/{kind}', f'its type is {topic.type_name}',
                f'publish it as {type_name}: a small node can convert it', topic.messages)


def _no_landmarks(topics: Mapping[str, BagTopic], filled: set[str], robot: str) -> Finding:
    no_landmarks_in_bag = not any(topic.endswith('/landmarks') for topic in filled)
    observes_robots = f'{robot}/robots' in filled
    is_usual = observes_robots and no_landmarks_in_bag
    return Finding(
        Severity.WARNING if is_usual else Severity.ERROR, 'no_landmarks', f'{robot}/landmarks',
        f'{_missing(topics, f"{robot}/landmarks")}, so {robot} observes'
        f' {"no landmarks" if observes_robots else "neither landmarks nor robots"}',
        f'record sensor_msgs/PointCloud2 on {robot}/landmarks, or remap the topic that has it;'
        ' without it the robot drifts like its odometry')


def _missing(topics: Mapping[str, BagTopic], topic: str) -> str:
    if topic in topics:
        return 'the topic has no messages'
    kind = topic.rpartition('/')[2]
    similar = sorted(other for other in topics if other.endswith(kind) and other != topic)
    return 'the topic is missing' + (
        f' (similar topics: {", ".join(similar[:4])})' if similar else '')
