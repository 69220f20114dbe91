# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What runs have left, in folders and bags, and ground truth, read back to be compared."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import csv
from decimal import Decimal, DecimalException
import json
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, TrueLandmarks, TruePose
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation.run_result import (
    EstimatedTrajectory, LandmarkMap, NisSum, RunResult)
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.run_files import LANDMARKS_HEADER, TRAJECTORY_HEADER
from fej_slam_ros.ros.messages import deserialize, incoming, Message
from fej_slam_ros.ros.messages.common import from_quaternion
from fej_slam_ros.ros.session.inputs import CLOUD, GIVEN_POSE, ODOMETRY, TRUE_LANDMARKS

#: A pose in a frame: its stamp [ns], the frame, pose (3,) and covariance (3, 3).
Row = tuple[int, str, Array, Array]
RowT = TypeVar('RowT')
GivenT = TypeVar('GivenT')

DIAGNOSTICS = 'diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'


def is_bag(path: Path) -> bool:
    """Return whether a folder is a rosbag2."""
    return (path / 'metadata.yaml').is_file()


def has_truth(bag: Path) -> bool:
    """Return whether a bag tells where robots truly were."""
    return bool(_robots(bags.topics(bag), 'ground_truth', ODOMETRY))


def bag_of(folder: Path) -> Path | None:
    """Return the bag that the files in a folder were made from, None where it is not there."""
    source = _summary(folder).get('bag')
    return Path(source) if source and is_bag(Path(source)) else None


def read_folder(folder: Path) -> RunResult:
    """
    Return what `replay`, `smooth` or a node have written.

    Raises
    ------
    UserError
        The files are not there, or damaged.

    """
    prefix = 'trajectory_'
    files = sorted(folder.glob(f'{prefix}*.csv'))
    if not files:
        raise UserError(
            f'{folder} has no {prefix}<robot>.csv and is no rosbag2: give the folder that replay,'
            ' smooth or a node wrote, or a bag with its output topics')
    ways = {
        path.stem.removeprefix(prefix): _way(_table(path, TRAJECTORY_HEADER, _pose_row))
        for path in files}
    shared_ids = not (folder / 'ids.csv').exists()
    told = _summary(folder).get('nis', {})
    nis = {name: NisSum(float(of['sum']), int(of['dof'])) for name, of in told.items()}
    return RunResult(
        {name: way for name, way in ways.items() if way is not None}, _landmarks(folder), nis,
        shared_ids)


def read_bag(path: Path) -> RunResult:
    """
    Return what the output topics in a bag hold: the last map, and all poses.

    Raises
    ------
    UserError
        It cannot be read, or holds no poses.

    """
    topics = bags.topics(path)
    robots = _robots(topics, 'pose', GIVEN_POSE)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/pose of type {GIVEN_POSE}, it has'
            f' {", ".join(sorted(topics)) or "none"}: give what replay --bag wrote, or record the'
            ' output topics')
    maps = [
        topic for topic, of in topics.items()
        if topic.endswith('/landmarks') and of.type_name == CLOUD and topic != TRUE_LANDMARKS
        and f'{topic.removesuffix("landmarks")}odom' not in topics
        and topic.removesuffix('/landmarks') not in robots]
    rows: defaultdict[str, list[Row]] = defaultdict(list)
    landmarks = NO_LANDMARKS
    nis: dict[str, NisSum] = {}
    for topic, message in _messages(path, {*maps, *(f'{r}/pose' for r in robots), DIAGNOSTICS[0]}):
        if topic in maps:
            if message.header.frame_id.lstrip('/') == MAP:
                landmarks = LandmarkMap(*incoming.map_landmarks(message))
        elif topic == DIAGNOSTICS[0]:
            nis |= {name: NisSum(*of) for name, of in incoming.nis(message).items()}
        else:
            told = incoming.pose_estimate(message, topic.partition('/')[0])
            rows[told.robot].append((told.stamp, told.frame, told.pose, told.P))
    ways = {name: _way(rows[name]) for name in robots}
    return RunResult({n: way for n, way in ways.items() if way is not None}, landmarks, nis)


def read_truth(path: Path) -> RecordedTruth:
    """
    Return ground truth: of the topics for it in a bag, or of ``<robot>.tum`` in a folder.

    A folder may tell of landmarks in ``landmarks.csv``, of which id, x and y are read, and of
    ``<robot>_truth.tum`` and ``<robot>.tum`` the former counts.

    Raises
    ------
    UserError
        There is none, or it cannot be read.

    """
    return _true_bag(path) if is_bag(path) else _true_folder(path)


NO_LANDMARKS = LandmarkMap(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))


def _true_bag(path: Path) -> RecordedTruth:
    robots = _robots(bags.topics(path), 'ground_truth', ODOMETRY)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/ground_truth of type {ODOMETRY}: give another bag, or a'
            ' folder of TUM files, with --truth')
    truth = RecordedTruth()
    wanted = {TRUE_LANDMARKS, *(f'{robot}/ground_truth' for robot in robots)}
    for topic, message in _messages(path, wanted):
        # Messages that the estimator rejects are not ground truth of the evaluation either.
        with suppress(incoming.RejectedError):
            truth.add(
                incoming.true_landmarks(message) if topic == TRUE_LANDMARKS
                else incoming.true_pose(message, topic.partition('/')[0]))
    return truth


def _true_folder(folder: Path) -> RecordedTruth:
    files = {path.stem: path for path in sorted(folder.glob('*.tum'))}
    if not files:
        raise UserError(
            f'{folder} is no rosbag2 and has no <robot>.tum: give a bag with <robot>/ground_truth,'
            ' or a folder of TUM files, with --truth')
    chosen = {name.removesuffix('_truth') for name in files}
    truth = RecordedTruth()
    truth.add(TrueLandmarks(_true_landmarks(folder)))
    for name in sorted(chosen):
        for stamp, pose in _lines(files.get(f'{name}_truth') or files[name], _tum_row):
            truth.add(TruePose(name, stamp, pose))
    return truth


def _robots(topics: Mapping[str, bags.BagTopic], kind: str, type_name: str) -> list[str]:
    names = (topic.rpartition('/') for topic in topics if topics[topic].type_name == type_name)
    return sorted(name for name, _, end in names if end == kind and name and '/' not in name)


def _messages(path: Path, topics: set[str]) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of some topics in a bag."""
    for message in bags.read(path):
        if message.topic in topics:
            yield message.topic, deserialize(message.raw, message.type_name)


def _way(rows: Iterable[Row]) -> EstimatedTrajectory | None:
    """Return the poses in ``map``, or else in the last frame; the last of a stamp counts."""
    told = [*rows]
    if not told:
        return None
    frame = MAP if any(row[1] == MAP for row in told) else told[-1][1]
    in_frame = sorted({row[0]: row for row in told if row[1] == frame}.items())
    stamps, poses, P = zip(*((stamp, row[2], row[3]) for stamp, row in in_frame))
    return EstimatedTrajectory(
        np.array(stamps, np.int64), np.array(poses), np.array(P), frame,
        len({row[0] for row in told}))


def _summary(folder: Path) -> dict[str, Any]:
    path = folder / 'summary.json'
    if not path.exists():
        return {}
    try:
        told: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise UserError(f'{path} cannot be read, make it anew: {error}') from None
    return told


def _landmarks(folder: Path) -> LandmarkMap:
    path = folder / 'landmarks.csv'
    if not path.exists():
        return NO_LANDMARKS
    rows = [row for row in _table(path, LANDMARKS_HEADER, _landmark_row) if row[3] == MAP]
    if not rows:
        return NO_LANDMARKS
    ids, points, P, _ = zip(*rows)
    return LandmarkMap(np.array(ids, np.int64), np.array(points), np.array(P))


def _true_landmarks(folder: Path) -> dict[int, Array]:
    path = folder / 'landmarks.csv'
    return dict(_table(path, 'id,x,y', _true_landmark_row)) if path.exists() else {}


def _table(path: Path, header: str, read: Callable[[Mapping[str, str]], RowT]) -> Iterator[RowT]:
    """Yield what is read from each row of a table that has at least some columns."""
    with _reading(path), path.open(encoding='utf-8', newline='') as file:
        rows = csv.DictReader(file)
        missing = [name for name in header.split(',') if name not in (rows.fieldnames or ())]
        if missing:
            raise UserError(
                f'{path} lacks the column {missing[0]} of {header}: give a file that this package'
                ' wrote')
        yield from _each(path, rows, read, first=2)


def _lines(path: Path, read: Callable[[str], RowT]) -> Iterator[RowT]:
    """Yield what is read from each line of a file that is no comment."""
    with _reading(path), path.open(encoding='utf-8') as file:
        told = (line for line in file if line.strip() and not line.startswith('#'))
        yield from _each(path, told, read, first=1)


def _each(
    path: Path, rows: Iterable[GivenT], read: Callable[[GivenT], RowT], first: int
) -> Iterator[RowT]:
    number = first
    try:
        for number, row in enumerate(rows, first):  # noqa: B007
            yield read(row)
    except (ValueError, TypeError, DecimalException, OverflowError):
        raise UserError(
            f'{path}: row {number} is damaged, correct it or make the file anew') from None


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f'{path} cannot be read, give another one: {error}') from None


def _pose_row(row: Mapping[str, str]) -> Row:
    names = TRAJECTORY_HEADER.split(',')
    numbers = _finite(row[name] for name in names[1:-1])
    P = np.zeros((3, 3))
    P[np.triu_indices(3)] = numbers[3:]
    return int(row['stamp_ns']), row['frame'], numbers[:3], P + np.triu(P, 1).T


def _landmark_row(row: Mapping[str, str]) -> tuple[int, Array, Array, str]:
    x, y, var_x, cov_xy, var_y = _finite(row[name] for name in LANDMARKS_HEADER.split(',')[1:-1])
    return (
        int(row['id']), np.array([x, y]), np.array([[var_x, cov_xy], [cov_xy, var_y]]),
        row['frame'])


def _true_landmark_row(row: Mapping[str, str]) -> tuple[int, Array]:
    return int(row['id']), _finite(row[name] for name in 'xy')


def _tum_row(line: str) -> tuple[int, Array]:
    seconds, *words = line.replace(',', ' ').split()
    x, y, _, *quaternion = _finite(words).tolist()
    # As a float it would lose the nanoseconds.
    return round(Decimal(seconds) * NS), np.array([x, y, from_quaternion(*quaternion)])


def _finite(words: Iterable[str]) -> Array:
    numbers = np.array([float(word) for word in words])
    if not np.isfinite(numbers).all():
        raise ValueError('not finite')
    return numbers
