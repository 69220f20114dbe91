# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Read the results of a run from a folder or a bag, for evaluation.

Missing or damaged files raise UserError.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
import json
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation.run_result import EstimatedTrajectory, LandmarkMap, NisSum, RunResult
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.csv_rows import (
    LANDMARK_COLUMNS, PoseRow, read_landmark, read_pose, TRAJECTORY_COLUMNS)
from fej_slam_ros.ros.files.row_files import read_table
from fej_slam_ros.ros.files.topic_names import topic_names, TopicNames
from fej_slam_ros.ros.messages import decoded, incoming, Message, own_results
from fej_slam_ros.ros.topic_types import (
    CLOUD, DIAGNOSTICS_TOPIC, OUTPUT_TYPES, POSE_WITH_COVARIANCE, TRUE_LANDMARKS)

#: Beginning of the names of the files with trajectories.
TRAJECTORY = 'trajectory_'

#: Names of /diagnostics in a bag, without and with a namespace of the robots.
DIAGNOSTICS = {DIAGNOSTICS_TOPIC.lstrip('/'), DIAGNOSTICS_TOPIC}
NO_LANDMARKS = LandmarkMap(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))

#: Entries of ``summary.json`` that are read, as they are where there is no such file.
NO_SUMMARY: dict[str, Any] = {'bag': '', 'remap': [], 'namespace': '', 'nis': {}}


def is_bag(path: Path) -> bool:
    """Return whether a path is a rosbag2: a folder, or a single file of one."""
    return path.is_file() or (path / 'metadata.yaml').is_file()


def bag_of(folder: Path) -> Path | None:
    """Return the bag that the files in a folder were made from, None if it is missing."""
    source = _summary(folder)['bag']
    return Path(source) if source and is_bag(Path(source)) else None


def names_of(folder: Path) -> TopicNames:
    """Return the names under which the files in a folder were made from a bag."""
    summary = _summary(folder)
    return topic_names(summary['remap'], summary['namespace'])


def read_folder(folder: Path) -> RunResult:
    """Return the results in files of `replay`, `smooth` or a node."""
    refuse_other_folder(folder)
    rows = {
        path.stem.removeprefix(TRAJECTORY): [*read_table(path, TRAJECTORY_COLUMNS, read_pose)]
        for path in _trajectory_files(folder)}
    shared_ids = not (folder / 'ids.csv').exists()
    nis = {
        name: NisSum(float(sums['sum']), int(sums['dof']))
        for name, sums in _summary(folder)['nis'].items()}
    return RunResult(_trajectories(rows), landmarks(folder), nis, shared_ids)


def landmarks(folder: Path, frame: str = MAP) -> LandmarkMap:
    """Return the landmarks of a run in one frame, from its folder."""
    path = folder / 'landmarks.csv'
    if not path.exists():
        return NO_LANDMARKS
    rows = [row for row in read_table(path, LANDMARK_COLUMNS, read_landmark) if row.frame == frame]
    if not rows:
        return NO_LANDMARKS
    ids, _, points, P = zip(*rows)
    return LandmarkMap(np.array(ids, np.int64), np.array(points), np.array(P))


def refuse_other_folder(folder: Path) -> None:
    """Raise UserError for a folder without trajectories, which no run wrote."""
    if not _trajectory_files(folder):
        raise UserError(
            f'{folder} has no {TRAJECTORY}<robot>.csv and is no rosbag2: give the folder that'
            ' replay, smooth or a node wrote, or a bag with its output topics')


def _trajectory_files(folder: Path) -> list[Path]:
    return sorted(folder.glob(f'{TRAJECTORY}*.csv'))


def read_bag(path: Path, names: TopicNames) -> RunResult:
    """Return the results on the output topics in a bag: all poses and the last map."""
    topics = bags.topics(path, names)
    robots = robots_with(topics, 'pose', POSE_WITH_COVARIANCE)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/pose of type {POSE_WITH_COVARIANCE}, it has'
            f' {", ".join(sorted(topics)) or "none"}: give a bag that replay --bag'
            ' wrote, or one with recorded output topics')
    maps = [
        topic for topic, bag_topic in topics.items()
        if topic.endswith('/landmarks') and bag_topic.type_name == CLOUD
        and topic != TRUE_LANDMARKS and f'{topic.removesuffix("landmarks")}odom' not in topics
        and topic.removesuffix('/landmarks') not in robots]
    results = _PublishedResults(robots, maps)
    invalid = read_messages(path, results.types, names, results.add)
    # The first node that reports NIS; a second one would be another estimator.
    nis = next(iter(results.nis.values()), {})
    return RunResult(
        _trajectories(results.rows), results.landmarks, nis, invalid_messages=invalid)


class _PublishedResults:
    """
    Results from messages on output topics.

    Parameters
    ----------
    robots : names of robots with topics of poses
    maps : topics of maps

    Attributes
    ----------
    types : types of the topics that are read
    rows : poses of each robot
    landmarks : the last map
    nis : NIS of each robot, by node

    """

    def __init__(self, robots: Iterable[str], maps: Iterable[str]) -> None:
        self.rows: dict[str, list[PoseRow]] = {robot: [] for robot in robots}
        self.landmarks = NO_LANDMARKS
        self.nis: dict[str, dict[str, NisSum]] = {}
        self._maps = {*maps}
        self._own_frames = {*map(own_frame, self.rows)}
        self.types = {
            **dict.fromkeys(self._maps, CLOUD),
            **dict.fromkeys(DIAGNOSTICS, OUTPUT_TYPES[DIAGNOSTICS_TOPIC]),
            **{f'{robot}/pose': POSE_WITH_COVARIANCE for robot in self.rows}}

    def add(self, topic: str, message: Message) -> None:
        """Add a message, or raise RejectedError."""
        if topic in self._maps:
            if message.header.frame_id not in self._own_frames:
                self.landmarks = LandmarkMap(*own_results.map_landmarks(message))
        elif topic in DIAGNOSTICS:
            for node, robots in own_results.nis(message).items():
                self.nis.setdefault(node, {}).update(
                    (name, NisSum(*sums)) for name, sums in robots.items())
        else:
            estimate = own_results.pose_estimate(message, topic.partition('/')[0])
            # The parameter map_frame gives the frame map another name in messages.
            frame = estimate.frame if estimate.frame in self._own_frames else MAP
            self.rows[estimate.robot].append(
                PoseRow(estimate.stamp, frame, estimate.pose, estimate.P))


def robots_with(topics: Mapping[str, bags.BagTopic], kind: str, type_name: str) -> list[str]:
    """Return the robots that have a topic of a kind and type."""
    names = (topic.rpartition('/') for topic in topics if topics[topic].type_name == type_name)
    return sorted(name for name, _, end in names if end == kind and name and '/' not in name)


def read_messages(
    path: Path, types: Mapping[str, str], names: TopicNames, read: Callable[[str, Message], None]
) -> int:
    """Read the messages on topics of given types; return the number of invalid ones."""
    invalid = 0
    for recorded in bags.read(path, names):
        if types.get(recorded.topic) == recorded.type_name:
            message = decoded(recorded.raw, recorded.type_name)
            try:
                if message is not None:
                    read(recorded.topic, message)
            except incoming.RejectedError:
                message = None
            invalid += message is None
    return invalid


def _trajectories(rows: Mapping[str, Sequence[PoseRow]]) -> dict[str, EstimatedTrajectory]:
    return {robot: _trajectory(poses) for robot, poses in rows.items() if poses}


def _trajectory(rows: Sequence[PoseRow]) -> EstimatedTrajectory:
    """Return the poses in ``map``, or else in the last frame, the last one of each stamp."""
    frame = MAP if any(row.frame == MAP for row in rows) else rows[-1].frame
    in_frame = sorted({row.stamp: row for row in rows if row.frame == frame}.items())
    stamps, poses, P = zip(*((stamp, row.pose, row.P) for stamp, row in in_frame))
    return EstimatedTrajectory(
        np.array(stamps, np.int64), np.array(poses), np.array(P), frame,
        len({row.stamp for row in rows}))


def _summary(folder: Path) -> dict[str, Any]:
    """Return the entries of the summary of a run that are needed, checked."""
    path = folder / 'summary.json'
    try:
        content = json.loads(path.read_text(encoding='utf-8')) if path.exists() else {}
        return _checked_summary(content)
    except (OSError, TypeError, ValueError, RecursionError) as error:
        raise UserError(f'{path} cannot be read, run again to replace it: {error}') from None


def _checked_summary(content: object) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise TypeError('it is no JSON object')
    entries = {name: content.get(name) or empty for name, empty in NO_SUMMARY.items()}
    for name, empty in NO_SUMMARY.items():
        if not isinstance(entries[name], type(empty)) or not _is_written(name, entries[name]):
            raise ValueError(f'the entry {name!r} is not what a run writes')
    return entries


def _is_written(name: str, entry: Any) -> bool:
    """Return whether a run writes such content of an entry."""
    if name == 'nis':
        return all(
            isinstance(sums, dict) and all(
                isinstance(sums.get(key), (int, float)) and np.isfinite(sums[key])
                for key in ('sum', 'dof'))
            for sums in entry.values())
    return name != 'remap' or all(isinstance(rule, str) for rule in entry)
