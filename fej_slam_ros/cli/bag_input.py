# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag has for the robots of a team: messages, and landmarks of observations without ID."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
import logging
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.matches import Matches
from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags, front_end_topics
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots, robots_in
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import decoded_as, RawMessage
from fej_slam_ros.ros.messages.incoming import RejectedError
from fej_slam_ros.ros.messages.incoming_clouds import has_unknown_landmarks
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.record_collector import collect
from fej_slam_ros.ros.topic_types import CLOUD, expected_topics


def team_messages(bag: Path, settings: CommonSettings, names: TopicNames) -> Iterable[RawMessage]:
    """
    Return the messages of a bag, read under other names, with a progress bar.

    A UserError says that it has odometry of no robot of the settings, or only of another type.

    """
    team = [robot.name for robot in settings.robots]
    topics = bags.topics(bag, names)
    names.check_new([*expected_topics(team), *front_end_topics.inputs(topics, team)])
    types = {name: topic.type_name for name, topic in topics.items() if topic.messages}
    absent = [f'{robot}/odom' for robot in team if f'{robot}/odom' not in types]
    if absent:
        recorded = RecordedRobots(bag, names, team)
        found = f'it has {recorded.found()}: {recorded.cure()}'
        others = ', '.join(name for name in robots_in(topics) if name not in team)
        if len(absent) == len(team):
            raise UserError(
                f'{bag} has messages on none of the topics {", ".join(absent)}, {found}'
                + (f', or name its robots ({others}) in the parameter robots' if others else ''))
        logging.getLogger(__name__).warning('%s has no %s, %s', bag, ', '.join(absent), found)
    _check_types(bag, team, types)
    for robot in team:
        computed = front_end_topics.cure(topics, robot)
        if computed and f'{robot}/landmarks' not in topics:
            logging.getLogger(__name__).warning(
                '%s has no %s/landmarks: %s', bag, robot, computed)
    return bags.read_with_bar(bag, names, topics)


def _check_types(bag: Path, team: Iterable[str], types: Mapping[str, str]) -> None:
    """Name the input topics of a team with messages of another type; some odometry is needed."""
    faults = {
        name: f'{bag} has {name} of the type {types[name]}, which is not used: record'
        f' {expected} on it, or give the topic that has it with --remap'
        for name, expected in expected_topics(team).items()
        if types.get(name, expected) != expected}
    odometry = [f'{robot}/odom' for robot in team if f'{robot}/odom' in types]
    if faults.keys() >= {*odometry}:
        raise UserError(faults[odometry[0]])
    for fault in faults.values():
        logging.getLogger(__name__).warning(fault)


def matches_in(bag: Path, settings: RunSettings, names: TopicNames) -> Matches | None:
    """Return what the estimator matches in a bag, None if all observations have IDs."""
    estimation = settings.estimation
    # The filter that linearises about true landmarks matches nothing.
    if LINEARIZATIONS[estimation.filter].needs_truth or (
            not _has_landmarks_without_ids(bag, estimation, names)):
        return None
    # What the bag lacks is said where it is read for the run itself.
    records = collect(bags.read(bag, names), settings, needs_ids=False).records
    with tqdm(desc='match', unit='step', disable=None) as bar:
        return match(estimation, records, prior_map(settings), bar.update)


def _has_landmarks_without_ids(bag: Path, settings: CommonSettings, names: TopicNames) -> bool:
    """Return whether a robot in a bag observed a landmark without ID."""
    for message in bags.read(bag, names, [f'{robot.name}/landmarks' for robot in settings.robots]):
        cloud = decoded_as(message, CLOUD)
        with suppress(RejectedError):
            if cloud is not None and has_unknown_landmarks(cloud):
                return True
    return False
