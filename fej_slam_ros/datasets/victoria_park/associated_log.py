# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Victoria Park with known data association: the log of one car, divided into two robots by [Liu].

The log holds the increments between 6899 poses and the landmarks observed from each. Two files
hold it, with equal entries: ``Zstate_VicPark_6898_loops.mat`` of the authors of [Liu], and
``VicPark_clean_data.mat`` of OpenSLAM's 2D I-SLSJF. The noise is that of [Liu] for both; the
covariances in the second file are not used.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
import math
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, compose, wrap
from fej_slam_ros.core.records import NS, Observation, Odometry, Record, Scan
from fej_slam_ros.core.settings import numbered_robots, Settings, Triple
from fej_slam_ros.datasets.file_checks import errors_name, require_folder, require_landmark_ids
from fej_slam_ros.datasets.matlab import joined_rows, matrices
from fej_slam_ros.errors import UserError

#: Stamp of every robot's first pose and time between poses [ns]. They are synthetic: the two
#: robots drove ten minutes apart.
LOG_START, STEP_PERIOD = NS, NS // 5
#: Covariances of an increment [m, m, rad] and of an observation [m, m].
ODOMETRY_Q: Array = np.diag(np.square([0.075, 0.075, 0.015 * math.pi]))
OBSERVATION_R: Array = np.diag(np.square([0.075, 0.075]))


@dataclass(frozen=True, slots=True, eq=False)
class AssociatedLog:
    """Measurements of a robot at K + 1 poses."""

    #: (K, 3) array, [x, y, phi] of each later pose in the frame of the one before.
    increments: Array
    #: Landmark observations from each pose, in the order of IDs.
    observations: Sequence[tuple[Observation, ...]]


@dataclass(frozen=True)
class CarTeam:
    """The robots that the car stands for."""

    #: First and last pose of each robot in the log; None is the end of the log.
    poses: Mapping[str, tuple[int, int | None]]
    #: Start of the first robot in ``map`` and its standard deviations.
    anchor_pose: Triple = (0.0, 0.0, 0.0)
    anchor_sigma: Triple = (0.0, 0.0, 0.0)


#: Teams by the number of robots; that of two is the one of [Liu].
CAR_TEAMS = {
    1: CarTeam({'r1': (0, None)}),
    2: CarTeam(
        {'r1': (719, 3264), 'r2': (3265, 5810)},
        (65.0492, 7.7931, wrap(3.3150)), (0.005, 0.005, 0.005 * math.pi)),
}


def settings(team: CarTeam) -> Settings:
    """Return the settings of a run as in [Liu]; the records carry the noise."""
    robots = numbered_robots(team.poses)
    return Settings(
        robots, anchor=robots[0].name, anchor_pose=team.anchor_pose,
        anchor_sigma=team.anchor_sigma, filter='fej', start_covariance='independent',
        gate_probability=1.0, join_probability=1.0)


def find(folder: Path) -> Path:
    """Return the path of the log in a folder; the file of the authors of [Liu] is preferred."""
    require_folder(folder, 'the Victoria Park data')
    for name in FILE_FORMATS:
        for path in sorted(folder.glob(f'{name}*.mat')):
            return path
    raise UserError(
        f'{folder} holds no associated Victoria Park data: put Zstate_VicPark_6898_loops.mat or '
        'VicPark_clean_data.mat there')


def read(path: Path) -> AssociatedLog:
    """Return the log in a file of either format."""
    with errors_name(path):
        steps, observations = _tables(path)
        _check(steps, observations)
    by_pose: list[list[Observation]] = [[] for _ in range(len(steps) + 1)]
    for pose, id_, *z in observations[np.argsort(observations[:, 1], kind='stable')].tolist():
        by_pose[int(pose)].append(Observation(int(id_), np.array(z), OBSERVATION_R))
    return AssociatedLog(steps[:, 2:], [*map(tuple, by_pose)])


def divide(log: AssociatedLog, team: CarTeam) -> dict[str, AssociatedLog]:
    """Return the part of each robot of a team; raise a `UserError` if the log is too short."""
    end = len(log.increments)
    parts = {}
    for robot, (first, team_last) in team.poses.items():
        last = end if team_last is None else team_last
        if last > end:
            raise UserError(
                f'the log ends at pose {end}, but robot {robot} needs poses {first} to {last}: '
                'take the whole log, or one robot')
        parts[robot] = AssociatedLog(
            log.increments[first:last], log.observations[first:last + 1])
    return parts


def records(logs: Mapping[str, AssociatedLog]) -> Iterator[Record]:
    """Yield the records of all robots in the order of stamps; all start at the same stamp."""
    for at_one_stamp in zip(*(_records(robot, log) for robot, log in logs.items())):
        for of_one_robot in at_one_stamp:
            yield from of_one_robot


def _records(robot: str, log: AssociatedLog) -> Iterator[tuple[Record, ...]]:
    """Yield the records at each pose; a pose without observations has no scan."""
    twist_covariance = ODOMETRY_Q / (STEP_PERIOD / NS) ** 2
    poses = accumulate(log.increments, compose, initial=np.zeros(3))
    for k, (pose, observations) in enumerate(zip(poses, log.observations)):
        stamp = LOG_START + k * STEP_PERIOD
        odometry = Odometry(robot, stamp, pose, twist_covariance if k else None)
        yield (odometry, Scan(robot, stamp, observations)) if observations else (odometry,)


def _tables(path: Path) -> tuple[Array, Array]:
    """
    Return the tables that both formats hold.

    Rows of the steps (K, 5) are [pose at the beginning, pose at the end, increment x, y, phi],
    those of the observations (m, 4) are [pose, landmark ID, x, y] in the frame of the pose.
    """
    columns = {name: columns for name, (columns, _) in FILE_FORMATS.items()}
    for name, rows in matrices(path, columns).items():
        return FILE_FORMATS[name][1](rows)
    raise UserError(f'neither of the variables {" and ".join(FILE_FORMATS)} is in it')


def _from_zstate(rows: Array) -> tuple[Array, Array]:
    """Convert rows of [value, 1 or 2, to-pose or ID, from-pose], one for each coordinate."""
    steps, observations = _divided(rows, 1, 2)
    return (
        np.hstack(joined_rows(steps[:, :1:-1], steps[:, 0], 3)),
        np.hstack(joined_rows(observations[:, :1:-1], observations[:, 0], 2)))


def _from_clean_data(rows: Array) -> tuple[Array, Array]:
    """Convert rows of [1 or 0, a row of the steps or the observations, its covariance]."""
    steps, observations = _divided(rows, 0, 0)
    return steps[:, 1:6], observations[:, 1:5]


def _divided(rows: Array, column: int, observation: int) -> tuple[Array, Array]:
    """Return the rows of steps and of observations, by the number in a column; a step has 1."""
    kind = rows[:, column]
    if not np.isin(kind, (1, observation)).all():
        raise UserError(f'column {column + 1} holds something other than 1 and {observation}')
    return rows[kind == 1], rows[kind == observation]


def _check(steps: Array, observations: Array) -> None:
    end = len(steps)
    if not end or not len(observations):
        raise UserError('there are no steps or no observations')
    if (steps[:, :2] != np.arange(end)[:, None] + (0, 1)).any():
        raise UserError('the steps do not lead from pose 0 to 1, from 1 to 2 and so on')
    if not np.isin(observations[:, 0], np.arange(end + 1)).all():
        raise UserError(f'an observation belongs to none of the poses 0 to {end}')
    require_landmark_ids(observations[:, 0], observations[:, 1])


#: Number of columns and converter of each file format, by the name of its variable, with which
#: the file name begins, too.
FILE_FORMATS: Mapping[str, tuple[int, Callable[[Array], tuple[Array, Array]]]] = {
    'Zstate': (4, _from_zstate),
    'VicPark_clean_data': (12, _from_clean_data),
}
