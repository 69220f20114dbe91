# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots in a bag by message types, and the options that give their topics the expected names."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
import re

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import decoded_as
from fej_slam_ros.ros.parameters import RESERVED_NAMES
from fej_slam_ros.ros.topic_types import CLOUD, ODOMETRY, SENT_TOPICS, TRUE_LANDMARKS

ROBOT_NAME = re.compile('[A-Za-z][A-Za-z0-9_]*')
#: Maximum number of topics of a type that a message lists.
MAX_LISTED = 6
#: Fields of a point cloud that holds observations; other clouds are those of lidars and cameras.
OBSERVATION_FIELDS = {'x', 'y', 'id'}


@dataclass(slots=True)
class RobotTopics:
    """Topics below one namespace that may be of one robot; recorded names."""

    odometry: list[str] = field(default_factory=list)
    observations: list[str] = field(default_factory=list)  #: clouds with the fields x, y and id
    truth: list[str] = field(default_factory=list)


def robots_in(topics: Mapping[str, bags.BagTopic]) -> list[str]:
    """Return the robots that have input topics in a bag; a latched map is not an input."""
    names = set()
    for topic, info in topics.items():
        name, _, kind = topic.rpartition('/')
        is_map = kind == 'landmarks' and info.latched
        if kind in SENT_TOPICS and _is_robot(name) and not is_map:
            names.add(name)
    return in_natural_order(names)


def in_natural_order(names: Iterable[str]) -> list[str]:
    """Return names in the order in which people count: r2 before r10."""
    return sorted(names, key=lambda name: (re.sub(r'\d+', '', name), len(name), name))


class RecordedRobots:
    """
    Odometry and observations in a bag that are no input yet, and how to make them inputs.

    Parameters
    ----------
    bag, names : the bag, and the names under which it is read
    team : names of the robots; if it is empty, robots are named after the first part of topics

    Attributes
    ----------
    missing : the robots without odometry

    """

    def __init__(self, bag: Path, names: TopicNames, team: Sequence[str] = ()) -> None:
        self._topics = bags.topics(bag)
        self._names = names
        used = {names.name(topic) for topic, info in self._topics.items() if info.messages}
        self.missing = [robot for robot in team if f'{robot}/odom' not in used]
        self._team = team
        self._complete = {*team} - {*self.missing}
        self._groups: defaultdict[str, RobotTopics] = defaultdict(RobotTopics)
        for topic in self._unused(ODOMETRY):
            self._groups[self._group_name(topic)].odometry.append(topic)
        for topic in sorted(_with_observations(bag, self._unused(CLOUD))):
            self._groups[self._group_name(topic)].observations.append(topic)
        for topic in self._unused(ODOMETRY, is_truth=True):
            self._groups[self._group_name(topic)].truth.append(topic)
        if not team:
            self.missing = self._in_one_namespace() or self._unknown() or ['r1']

    def found(self) -> str:
        """Return the topics by type, for a sentence that begins with ``it has``."""
        odometry, clouds = [*self._unused(ODOMETRY)], [*self._unused(CLOUD)]
        if not odometry and not clouds:
            return ', '.join(sorted(self._topics)[:2 * MAX_LISTED]) or 'no topics'
        return f'{ODOMETRY} on {self._listed(odometry)} and {CLOUD} on {self._listed(clouds)}'

    def cure(self, *robots: str) -> str:
        """Return how to read topics as those of some missing robots, by default of all."""
        wanted = [f'{robot}/odom' for robot in robots or self.missing]
        if all(topic in self._topics and self._names.name(topic) != topic for topic in wanted):
            renamed = f'the --remap of {", ".join(f"/{topic}" for topic in wanted)}'
            return f'leave out {"--namespace" if self._names.namespace else renamed}'
        spaces = self._namespaces()
        if spaces:
            return f'add {" or ".join(f"--namespace /{space}" for space in spaces)}'
        options = [o for robot in robots or self.missing for o in self._options(robot)]
        if options:
            return f'add {" ".join(options)}'
        topic = next(self._unused(ODOMETRY), None)
        if topic is None:
            return f'record {ODOMETRY} on {", ".join(wanted)}, or name its topic with --remap'
        if '/' not in topic and len(self.missing) > 1:
            return (
                f'start the drivers of each robot in its namespace (-r __ns:=/{self.missing[0]}),'
                f' as /{topic} is of one robot, or of several that are mixed up')
        return (
            'choose the topics of each robot with --remap, for example'
            f' --remap /{topic}:=/{[*robots, *self.missing][0]}/odom')

    def landmarks_cure(self, robot: str) -> str:
        """Return how to read a topic as the landmarks of a robot, '' if no single one may be."""
        if robot in self.missing:
            return self.cure(robot) if self._group_of(robot).observations else ''
        groups = self._groups.values() if len(self._team) == 1 else [
            self._groups.get(robot, RobotTopics())]
        found = [
            topic for group in groups for topic in group.observations
            if topic.rpartition('/')[2] != 'robots']
        return f'add --remap /{found[0]}:=/{robot}/landmarks' if len(found) == 1 else ''

    def recorded_names(self) -> dict[str, str]:
        """Return the recorded name of each robot: the first part of its odometry topic."""
        owners = {robot: robot for robot in self._team}
        space = self._names.namespace.lstrip('/')
        for topic in self._topics:
            robot, _, kind = self._names.name(topic).rpartition('/')
            owner, below, _ = topic.removeprefix(f'{space}/').partition('/')
            if kind == 'odom' and robot in owners and below:
                owners[robot] = owner
        return owners

    def unknown_robots(self) -> dict[str, tuple[str, str]]:
        """Return odometry and cure of robots with observations outside a complete team."""
        return {} if self.missing else {
            name: (self._groups[name].odometry[0], self._joined_options(name))
            for name in self._unknown() if self._groups[name].observations}

    def _joined_options(self, robot: str) -> str:
        odometry = self._groups[robot].odometry[0]
        return ' '.join(self._options(robot)) or f'--remap /{odometry}:=/{robot}/odom'

    def _unknown(self) -> list[str]:
        """Return the groups with odometry that could be robots outside the team."""
        return in_natural_order(
            name for name, group in self._groups.items()
            if group.odometry and name not in self._complete and _is_robot(name))

    def _namespaces(self) -> list[str]:
        """Return the namespaces in which robots have odometry, if none has it outside."""
        return [] if self._complete or self._names.namespace else sorted({
            space for space, robot in self._nested() if robot in self.missing})

    def _in_one_namespace(self) -> list[str]:
        """Return the robots with odometry of the expected name in the only namespace."""
        spaces = {space for space, _ in self._nested()}
        return in_natural_order(robot for _, robot in self._nested()) if len(spaces) == 1 else []

    def _nested(self) -> Iterator[tuple[str, str]]:
        """Yield namespace and robot of each topic ``<namespace>/<robot>/odom``."""
        for topic in self._unused(ODOMETRY):
            space, _, robot = topic.rpartition('/')[0].rpartition('/')
            if space and topic.endswith('/odom'):
                yield space, robot

    def _options(self, robot: str) -> list[str]:
        """Return the options that name the topics of a robot, none if they are ambiguous."""
        group = self._group_of(robot)
        if len(group.odometry) != 1:
            return []
        kinds = {group.odometry[0]: 'odom'}
        for topic in group.observations:
            kind = topic.rpartition('/')[2]
            if len(group.observations) == 1 and kind != 'robots':
                kinds[topic] = 'landmarks'
            elif kind in {'landmarks', 'robots'}:
                kinds[topic] = kind
        if len(group.truth) == 1:
            kinds[group.truth[0]] = 'ground_truth'
        if len({*kinds.values()}) < len(kinds):
            return []
        owners = {topic.removesuffix(f'/{kind}') for topic, kind in kinds.items()}
        if len(owners) == 1 and not owners & kinds.keys():
            return [f'--remap /{owners.pop()}/:=/{robot}/']
        return [
            f'--remap /{topic}:=/{robot}/{kind}' for topic, kind in kinds.items()
            if self._names.name(topic) != f'{robot}/{kind}']

    def _group_of(self, robot: str) -> RobotTopics:
        """Return the topics below a robot's name, or the only ones of an unknown robot."""
        own = self._groups.get(robot, RobotTopics())
        if own.odometry:
            return own
        others = [
            group for name, group in self._groups.items()
            if group.odometry and name not in self._complete]
        if len(others) != 1 or len(self.missing) != 1:
            return RobotTopics()
        free = (group.observations for group in self._groups.values())
        return RobotTopics(
            others[0].odometry, others[0].observations or [*chain(*free)], others[0].truth)

    def _unused(self, type_name: str, is_truth: bool = False) -> Iterator[str]:
        """Yield the recorded topics of a type that are no input of a robot with odometry."""
        for topic, info in sorted(self._topics.items()):
            owner, _, kind = self._names.name(topic).rpartition('/')
            is_input = owner in self._complete and kind in SENT_TOPICS
            is_map = info.latched or f'/{topic}'.endswith(f'/{TRUE_LANDMARKS}')
            if info.type_name == type_name and info.messages and not (is_input or is_map) and (
                    is_truth == (kind == 'ground_truth')):
                yield topic

    def _group_name(self, topic: str) -> str:
        return self._names.name(topic).lstrip('/').rpartition('/')[0].partition('/')[0]

    def _listed(self, topics: Sequence[str]) -> str:
        listed = [f'/{topic} ({self._topics[topic].messages})' for topic in topics[:MAX_LISTED]]
        more = len(topics) - len(listed)
        return ', '.join(listed + [f'{more} more topics'] * (more > 0)) or 'no topic'


def _is_robot(name: str) -> bool:
    return ROBOT_NAME.fullmatch(name) is not None and name not in RESERVED_NAMES


def _with_observations(bag: Path, clouds: Iterable[str]) -> set[str]:
    """Return the clouds whose first points have the fields of observations."""
    found, remaining = set(), {*clouds}
    for message in bags.read(bag) if remaining else ():
        if message.topic not in remaining:
            continue
        cloud = decoded_as(message, CLOUD)
        fields = set() if cloud is None else {point_field.name for point_field in cloud.fields}
        if fields:
            remaining.discard(message.topic)
        if fields >= OBSERVATION_FIELDS:
            found.add(message.topic)
        if not remaining:
            break
    return found
