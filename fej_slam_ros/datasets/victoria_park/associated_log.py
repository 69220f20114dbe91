# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Victoria Park with its data association: the log of one car, which [Liu] made two robots of.

The log holds the increments between 6899 poses and the landmarks seen from each. Two files have
it, with equal entries: ``Zstate_VicPark_6898_loops.mat`` of the authors of [Liu], and
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
from fej_slam_ros.core.records import Observation, Odometry, Record, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.datasets.file_errors import blaming, require_folder
from fej_slam_ros.datasets.matlab import matrices
from fej_slam_ros.errors import UserError

#: Stamps [ns] of the first pose of every robot, and from one pose to the next. They are made up:
#: the two robots drove ten minutes apart.
FIRST_STAMP = 1_000_000_000
PERIOD = 200_000_000

#: Covariances of an increment [m, m, rad] and of an observation [m, m].
Q: Array = np.diag(np.square([0.075, 0.075, 0.015 * math.pi]))
R: Array = np.diag(np.square([0.075, 0.075]))


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """
    What a robot measured on its way through K + 1 poses.

    Attributes
    ----------
    increments : (K, 3) array, [x, y, phi] of each later pose in the frame of the one before
    observations : for each pose what was seen from it, in the order of ids

    """

    increments: Array
    observations: Sequence[tuple[Observation, ...]]


@dataclass(frozen=True)
class Team:
    """
    Robots that the car stands for.

    Attributes
    ----------
    poses : first and last pose of each robot in the log; None is the end of the log
    anchor_pose, anchor_sigma : start of the first robot in ``map`` and its standard deviations

    """

    poses: Mapping[str, tuple[int, int | None]]
    anchor_pose: Triple = (0.0, 0.0, 0.0)
    anchor_sigma: Triple = (0.0, 0.0, 0.0)


#: By the number of robots; the two are those of [Liu].
TEAMS = {
    1: Team({'r1': (0, None)}),
    2: Team(
        {'r1': (719, 3264), 'r2': (3265, 5810)},
        (65.0492, 7.7931, wrap(3.3150)),
        (0.005, 0.005, 0.005 * math.pi),
    ),
}


def settings(team: Team) -> Settings:
    """Return the settings of a run as in [Liu]; the noise comes with the records."""
    robots = tuple(RobotSettings(name, number) for number, name in enumerate(team.poses, start=1))
    return Settings(
        robots,
        anchor=robots[0].name,
        anchor_pose=team.anchor_pose,
        anchor_sigma=team.anchor_sigma,
        filter='fej',
        start_covariance='independent',
        gate_probability=1.0,
        join_probability=1.0,
    )


def find(folder: Path) -> Path:
    """
    Return the file in a folder that holds the log: of both that of the authors of [Liu].

    Raises
    ------
    UserError
        There is no such file or folder.

    """
    require_folder(folder, 'the Victoria Park data')
    for form in FORMS:
        for path in sorted(folder.glob(f'{form}*.mat')):
            return path
    raise UserError(
        f'{folder} holds no associated Victoria Park data: put Zstate_VicPark_6898_loops.mat or '
        'VicPark_clean_data.mat there')


def read(path: Path) -> Log:
    """
    Return the log in a file of either form.

    Raises
    ------
    UserError
        The file holds neither form, or is damaged.

    """
    with blaming(path):
        return _log(*_tables(path))


def divide(log: Log, team: Team) -> dict[str, Log]:
    """
    Return the part of each robot of a team.

    Raises
    ------
    UserError
        The log ends before the last pose of a robot.

    """
    end = len(log.increments)
    parts = {}
    for robot, (first, given) in team.poses.items():
        last = end if given is None else given
        if last > end:
            raise UserError(
                f'the log ends at pose {end}, but robot {robot} needs poses {first} to {last}: '
                'take the whole log, or one robot')
        after = last + 1
        parts[robot] = Log(log.increments[first:last], log.observations[first:after])
    return parts


def records(logs: Mapping[str, Log]) -> Iterator[Record]:
    """Yield the records of all robots in the order of stamps; all set out at the same one."""
    for at_one_stamp in zip(*(_records(robot, log) for robot, log in logs.items())):
        for of_one_robot in at_one_stamp:
            yield from of_one_robot


def _records(robot: str, log: Log) -> Iterator[tuple[Record, ...]]:
    """Yield what there is at each pose; where the log holds no observation there was no scan."""
    twist_covariance = Q / (PERIOD / 1e9) ** 2
    poses = accumulate(log.increments, compose, initial=np.zeros(3))
    for k, (pose, seen) in enumerate(zip(poses, log.observations)):
        stamp = FIRST_STAMP + k * PERIOD
        odometry = Odometry(robot, stamp, pose, twist_covariance if k else None)
        yield (odometry, Scan(robot, stamp, seen)) if seen else (odometry,)


def _tables(path: Path) -> tuple[Array, Array]:
    """
    Return what both forms have in common.

    Returns
    -------
    steps : (K, 5) array
        Pose where the step begins, pose where it ends, increment [x, y, phi].
    observations : (m, 4) array
        Pose, number of the landmark, its place [x, y] in the frame of the pose.

    """
    found = matrices(path, {name: columns for name, (columns, _) in FORMS.items()})
    for name, (_, tables) in FORMS.items():
        if name in found:
            return tables(found[name])
    raise UserError(f'neither of the variables {" and ".join(FORMS)} is in it')


def _from_zstate(rows: Array) -> tuple[Array, Array]:
    """Take apart rows of [value, 1 or 2, to-pose or id, from-pose], one for each coordinate."""
    steps, observations = _by_kind(rows, 1, 1, 2)
    return _joined(steps, 3), _joined(observations, 2)


def _from_clean_data(rows: Array) -> tuple[Array, Array]:
    """Take apart rows of [1 or 0, a row of the steps or the observations, its covariance]."""
    steps, observations = _by_kind(rows, 0, 1, 0)
    return steps[:, 1:6], observations[:, 1:5]


def _by_kind(rows: Array, column: int, step: int, observation: int) -> tuple[Array, Array]:
    kind = rows[:, column]
    if not np.isin(kind, (step, observation)).all():
        raise UserError(f'column {column + 1} holds something other than {step} and {observation}')
    return rows[kind == step], rows[kind == observation]


def _joined(rows: Array, count: int) -> Array:
    """Make one row of each ``count`` rows, which must name the same poses and landmarks."""
    if len(rows) % count:
        raise UserError(f'the {len(rows)} rows of type {rows[0, 1]:.0f} do not go by {count}')
    groups = rows.reshape(-1, count, 4)
    names = groups[:, :, :1:-1]
    if (names != names[:, :1]).any():
        raise UserError(f'rows of type {rows[0, 1]:.0f} that belong together name different poses')
    return np.hstack([names[:, 0], groups[:, :, 0]])


def _log(steps: Array, observations: Array) -> Log:
    """Check the tables and put the observations to their poses."""
    _check(steps, observations)
    by_pose: list[list[Observation]] = [[] for _ in range(len(steps) + 1)]
    for pose, number, *z in observations[np.argsort(observations[:, 1], kind='stable')].tolist():
        by_pose[int(pose)].append(Observation(int(number), np.array(z), R))
    return Log(steps[:, 2:], [tuple(seen) for seen in by_pose])


def _check(steps: Array, observations: Array) -> None:
    end = len(steps)
    if not end or not len(observations):
        raise UserError('there are no steps or no observations')
    if not (np.isfinite(steps).all() and np.isfinite(observations).all()):
        raise UserError('a value is not finite')
    if (steps[:, :2] != np.arange(end)[:, None] + (0, 1)).any():
        raise UserError('the steps do not lead from pose 0 to 1, from 1 to 2 and so on')
    poses, ids = observations[:, 0], observations[:, 1]
    if not np.isin(poses, np.arange(end + 1)).all():
        raise UserError(f'an observation belongs to none of the poses 0 to {end}')
    if ((ids != np.floor(ids)) | (ids < 0) | (ids >= 2**31)).any():
        raise UserError('a landmark has an id that is not an integer from 0 to 2147483647')
    if len(np.unique(observations[:, :2], axis=0)) < len(observations):
        raise UserError('a pose sees one landmark twice')


#: By the variable, which also begins the file's name: its columns, and what takes it apart.
FORMS: Mapping[str, tuple[int, Callable[[Array], tuple[Array, Array]]]] = {
    'Zstate': (4, _from_zstate),
    'VicPark_clean_data': (12, _from_clean_data),
}
