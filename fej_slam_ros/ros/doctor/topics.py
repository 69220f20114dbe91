# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a bag has the topics of a team, of the right types."""

from collections.abc import Iterator, Mapping, Sequence
import re

from fej_slam_ros.ros.doctor.findings import ERROR, Finding, WARNING
from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.parameters import TAKEN
from fej_slam_ros.ros.session.inputs import SENT_TOPICS

NAME = re.compile('[A-Za-z][A-Za-z0-9_]*')
SEEING = ('landmarks', 'robots')


def robots_in(topics: Mapping[str, BagTopic]) -> list[str]:
    """Return the robots of which a bag has topics; maps, which are latched, are nobody's."""
    names = set()
    for topic, of in topics.items():
        name, _, kind = topic.rpartition('/')
        is_map = kind == 'landmarks' and of.latched
        if kind in SENT_TOPICS and NAME.fullmatch(name) and name not in TAKEN and not is_map:
            names.add(name)
    return sorted(names, key=lambda name: (re.sub(r'\d+', '', name), len(name), name))


def check(topics: Mapping[str, BagTopic], robots: Sequence[str]) -> Iterator[Finding]:
    """Yield what is missing, empty or of a wrong type, and who is not of the team."""
    filled = {topic for topic, of in topics.items() if of.messages}
    for robot in robots:
        yield from _types(topics, robot)
        if f'{robot}/odom' not in filled:
            yield Finding(
                ERROR, 'no_odometry', f'{robot}/odom', _missing(topics, f'{robot}/odom'),
                f'record nav_msgs/Odometry on {robot}/odom, or remap the topic that has it;'
                f' without it {robot} takes no part')
        if f'{robot}/landmarks' not in filled:
            yield _unseeing(topics, filled, robot)
    for stranger in robots_in(topics):
        if stranger not in robots:
            yield Finding(
                WARNING, 'unknown_robot', stranger, 'it has topics, but is not in robots',
                f'add {stranger} to the parameter robots, if it is to take part')


def _types(topics: Mapping[str, BagTopic], robot: str) -> Iterator[Finding]:
    for kind, type_name in SENT_TOPICS.items():
        found = topics.get(f'{robot}/{kind}')
        if found is not None and found.type_name != type_name:
            severity = WARNING if kind == 'ground_truth' else ERROR
            yield Finding(
                severity, 'wrong_type', f'{robot}/{kind}', f'it is of type {found.type_name}',
                f'publish it as {type_name}: a small node can convert it', found.messages)


def _unseeing(topics: Mapping[str, BagTopic], filled: set[str], robot: str) -> Finding:
    others = any(topic.endswith('/landmarks') for topic in filled)
    sees = f'{robot}/robots' in filled
    severity = WARNING if sees and not others else ERROR
    lacks = 'no landmarks' if sees else 'neither landmarks nor robots'
    return Finding(
        severity, 'no_landmarks', f'{robot}/landmarks',
        f'{_missing(topics, f"{robot}/landmarks")}, so that {robot} sees {lacks}',
        f'record sensor_msgs/PointCloud2 on {robot}/landmarks, or remap the topic that has it;'
        ' without it the robot drifts as its odometry does')


def _missing(topics: Mapping[str, BagTopic], topic: str) -> str:
    if topic in topics:
        return 'the topic has no message'
    kind = topic.rpartition('/')[2]
    alike = sorted(other for other in topics if other.endswith(kind) and other != topic)
    return 'there is no such topic' + (f' (there is {", ".join(alike[:4])})' if alike else '')
