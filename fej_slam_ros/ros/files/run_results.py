# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Read the results of a run from a folder or a bag, and ground truth, for evaluation.

Missing or damaged files raise UserError.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import csv
from decimal import Decimal, DecimalException
import json
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, TrueLandmarks, TruePose
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation.run_result import EstimatedTrajectory, LandmarkMap, NisSum, RunResult
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.csv_rows import (
    LANDMARK_COLUMNS, PoseRow, read_landmark, read_pose, TRAJECTORY_COLUMNS)
from fej_slam_ros.ros.files.topic_names import topic_names, TopicNames
from fej_slam_ros.ros.messages import decoded, incoming, incoming_clouds, Message, own_results
from fej_slam_ros.ros.messages.common import from_quaternion
from fej_slam_ros.ros.session.inputs import CLOUD, ODOMETRY, POSE_WITH_COVARIANCE, TRUE_LANDMARKS
from fej_slam_ros.ros.session.outputs import DIAGNOSTICS_TOPIC, TYPES
from fej_slam_ros.tables import Cells, finite_numbers

#: Beginning of the names of the files with trajectories.
TRAJECTORY = 'trajectory_'
#: Columns of a TUM file after the time.
TUM_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
SourceT = TypeVar('SourceT')
RowT = TypeVar('RowT')

#: Names of /diagnostics in a bag, without and with a namespace of the robots.
DIAGNOSTICS = {DIAGNOSTICS_TOPIC.lstrip('/'), DIAGNOSTICS_TOPIC}
NO_LANDMARKS = LandmarkMap(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))

#: Entries of ``summary.json`` that are read, as they are where there is no such file.
NO_SUMMARY: dict[str, Any] = {'bag': '', 'remap': [], 'namespace': '', 'nis': {}}


def is_bag(path: Path) -> bool:
    """Return whether a path is a rosbag2: a folder, or a single file of one."""
    return path.is_file() or (path / 'metadata.yaml').is_file()


def has_truth(bag: Path, names: TopicNames) -> bool:
    """Return whether a bag has ground truth of any robot."""
    return bool(_robots(bags.topics(bag, names), 'ground_truth', ODOMETRY))


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
        path.stem.removeprefix(TRAJECTORY): [*_table(path, TRAJECTORY_COLUMNS, read_pose)]
        for path in _trajectory_files(folder)}
    shared_ids = not (folder / 'ids.csv').exists()
    nis = {
        name: NisSum(float(sums['sum']), int(sums['dof']))
        for name, sums in _summary(folder)['nis'].items()}
    return RunResult(_trajectories(rows), _landmarks(folder), nis, shared_ids)


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
    robots = _robots(topics, 'pose', POSE_WITH_COVARIANCE)
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
    invalid = _read_messages(path, results.types, names, results.add)
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
            **dict.fromkeys(DIAGNOSTICS, TYPES[DIAGNOSTICS_TOPIC]),
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


def read_truth(path: Path, names: TopicNames) -> tuple[RecordedTruth, int]:
    """
    Return ground truth, and the number of invalid messages that are left out.

    It comes from its topics in a bag or from ``<robot>.tum`` in a folder.
    In a folder, ``<robot>_truth.tum`` takes precedence over ``<robot>.tum``, and true landmarks
    may be in the columns id, x and y of ``landmarks.csv``.

    """
    return _true_bag(path, names) if is_bag(path) else (_true_folder(path), 0)


def _true_bag(path: Path, names: TopicNames) -> tuple[RecordedTruth, int]:
    robots = _robots(bags.topics(path, names), 'ground_truth', ODOMETRY)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/ground_truth of type {ODOMETRY}: give another bag, or a'
            ' folder of TUM files, with --truth')
    truth = RecordedTruth()

    def read(topic: str, message: Message) -> None:
        truth.add(
            incoming_clouds.true_landmarks(message) if topic == TRUE_LANDMARKS
            else incoming.true_pose(message, topic.partition('/')[0]))

    # Messages that the estimator rejects are not ground truth of the evaluation either.
    invalid = _read_messages(path, {
        TRUE_LANDMARKS: CLOUD, **{f'{robot}/ground_truth': ODOMETRY for robot in robots}},
        names, read)
    return truth, invalid


def _true_folder(folder: Path) -> RecordedTruth:
    files = {path.stem: path for path in sorted(folder.glob('*.tum'))}
    if not files:
        raise UserError(
            f'{folder} is no rosbag2 and has no <robot>.tum: give a bag with <robot>/ground_truth,'
            ' or a folder of TUM files, with --truth')
    truth = RecordedTruth()
    truth.add(TrueLandmarks(_true_landmarks(folder)))
    for name in sorted({name.removesuffix('_truth') for name in files}):
        for stamp, pose in _lines(files.get(f'{name}_truth') or files[name], _tum_row):
            truth.add(TruePose(name, stamp, pose))
    return truth


def _robots(topics: Mapping[str, bags.BagTopic], kind: str, type_name: str) -> list[str]:
    names = (topic.rpartition('/') for topic in topics if topics[topic].type_name == type_name)
    return sorted(name for name, _, end in names if end == kind and name and '/' not in name)


def _read_messages(
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


def _landmarks(folder: Path) -> LandmarkMap:
    path = folder / 'landmarks.csv'
    if not path.exists():
        return NO_LANDMARKS
    rows = [row for row in _table(path, LANDMARK_COLUMNS, read_landmark) if row.frame == MAP]
    if not rows:
        return NO_LANDMARKS
    ids, _, points, P = zip(*rows)
    return LandmarkMap(np.array(ids, np.int64), np.array(points), np.array(P))


def _true_landmarks(folder: Path) -> dict[int, Array]:
    path = folder / 'landmarks.csv'
    return dict(_table(path, ('id', 'x', 'y'), _true_landmark)) if path.exists() else {}


def _table(path: Path, columns: Sequence[str], read: Callable[[Cells], RowT]) -> Iterator[RowT]:
    """Yield the rows of a CSV file that has at least some columns."""
    with _reading(path), path.open(encoding='utf-8', newline='') as file:
        rows = csv.DictReader(file)
        missing = [name for name in columns if name not in (rows.fieldnames or ())]
        if missing:
            raise UserError(
                f'{path} lacks the column {missing[0]} of {",".join(columns)}: give a file that'
                ' this package wrote')
        yield from _parsed(path, rows, read, first=2)


def _lines(path: Path, read: Callable[[str], RowT]) -> Iterator[RowT]:
    """Yield the content of each line of a file that is not empty and no comment."""
    with _reading(path), path.open(encoding='utf-8') as file:
        lines = (line for line in file if line.strip() and not line.startswith('#'))
        yield from _parsed(path, lines, read, first=1)


def _parsed(
    path: Path, rows: Iterable[SourceT], read: Callable[[SourceT], RowT], first: int
) -> Iterator[RowT]:
    number = first
    try:
        for number, row in enumerate(rows, first):  # noqa: B007
            yield read(row)
    except (ValueError, TypeError, DecimalException, OverflowError):
        raise UserError(
            f'{path}: row {number} is damaged, correct it or write the file again') from None


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f'{path} cannot be read, give another file: {error}') from None


def _true_landmark(cells: Cells) -> tuple[int, Array]:
    return int(cells['id'] or ''), np.array(finite_numbers(cells, 'xy'))


def _tum_row(line: str) -> tuple[int, Array]:
    seconds, *words = line.replace(',', ' ').split()
    numbers = finite_numbers(dict(zip(TUM_COLUMNS, words, strict=True)), TUM_COLUMNS)
    x, y, _, *quaternion = numbers
    if abs(sum(np.square(quaternion)) - 1.0) > incoming.NORM_TOLERANCE:
        raise ValueError('its quaternion does not have the norm 1')
    # A float would lose the nanoseconds.
    return round(Decimal(seconds) * NS), np.array([x, y, from_quaternion(*quaternion)])
