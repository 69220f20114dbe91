# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read ground truth from a bag or a folder of files, for evaluation."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from fej_slam_ros.atomic_files import short_path
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, TrueLandmarks, TruePose
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.row_files import DamagedRowError, read_lines, read_table
from fej_slam_ros.ros.files.run_results import is_bag, read_messages, robots_with
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import incoming, incoming_clouds, Message
from fej_slam_ros.ros.messages.common import from_quaternion
from fej_slam_ros.ros.topic_types import CLOUD, ODOMETRY, TRUE_LANDMARKS
from fej_slam_ros.tables import Cells, finite_numbers

#: How ground truth is given, and what judges a run without.
TRUTH_OR_NIS = (
    'with --truth; without any, NIS/dof judges the consistency: nis in summary.json of replay, and'
    ' in /diagnostics')
#: Columns of a TUM file after the time.
TUM_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')


def has_truth(bag: Path, names: TopicNames) -> bool:
    """Return whether a bag has ground truth of any robot."""
    return bool(robots_with(bags.topics(bag, names), 'ground_truth', ODOMETRY))


def read_truth(path: Path, names: TopicNames) -> tuple[RecordedTruth, int]:
    """
    Return ground truth, and the number of invalid messages that are left out.

    It comes from its topics in a bag or from ``<robot>.tum`` in a folder.
    In a folder, ``<robot>_truth.tum`` takes precedence over ``<robot>.tum``, and true landmarks
    may be in the columns id, x and y of ``landmarks.csv``.

    """
    return _true_bag(path, names) if is_bag(path) else (_true_folder(path), 0)


def _true_bag(path: Path, names: TopicNames) -> tuple[RecordedTruth, int]:
    robots = robots_with(bags.topics(path, names), 'ground_truth', ODOMETRY)
    if not robots:
        raise UserError(
            f'{short_path(path)} has no topic <robot>/ground_truth of type {ODOMETRY}: give'
            f' another bag, or a folder of TUM files, {TRUTH_OR_NIS}')
    truth = RecordedTruth()

    def read(topic: str, message: Message) -> None:
        reason = truth.add(
            incoming_clouds.true_landmarks(message) if topic == TRUE_LANDMARKS
            else incoming.true_pose(message, topic.partition('/')[0]))
        if reason is not None:
            raise incoming.RejectedError(reason)

    # Messages that the estimator rejects are not ground truth of the evaluation either.
    invalid = read_messages(path, {
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
    landmarks = folder / 'landmarks.csv'
    if landmarks.exists():
        truth.add(TrueLandmarks(_true_landmarks(landmarks)))
    for name in sorted({name.removesuffix('_truth') for name in files}):
        path = files.get(f'{name}_truth') or files[name]
        for stamp, pose in read_lines(path, _tum_row):
            if truth.add(TruePose(name, stamp, pose)) is not None:
                raise UserError(
                    f'{path} has two poses at {stamp / NS:.9f} s: remove one, or write the times'
                    ' with all their digits')
    return truth


def _true_landmarks(path: Path) -> dict[int, Array]:
    positions: dict[int, Array] = {}
    for landmark, position in read_table(path, ('id', 'x', 'y'), _true_landmark):
        if not np.array_equal(positions.setdefault(landmark, position), position):
            raise UserError(f'{path} has two positions of landmark {landmark}: remove one')
    return positions


def _true_landmark(cells: Cells) -> tuple[int, Array]:
    return int(cells['id'] or ''), np.array(finite_numbers(cells, 'xy'))


def _tum_row(line: str) -> tuple[int, Array]:
    seconds, *words = line.replace(',', ' ').split()
    if len(words) != len(TUM_COLUMNS):
        raise DamagedRowError(
            f'has {1 + len(words)} columns, not 8: time [s], {", ".join(TUM_COLUMNS)}')
    numbers = finite_numbers(dict(zip(TUM_COLUMNS, words)), TUM_COLUMNS)
    x, y, _, *quaternion = numbers
    if abs(sum(np.square(quaternion)) - 1.0) > incoming.NORM_TOLERANCE:
        raise DamagedRowError('has a quaternion whose norm is not 1')
    # A float would lose the nanoseconds.
    return round(Decimal(seconds) * NS), np.array([x, y, from_quaternion(*quaternion)])
