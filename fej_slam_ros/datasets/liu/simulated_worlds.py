# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated worlds of [Liu]: what is true of robots and landmarks, from the authors' files.

``MT_Parameters_<landmarks>fea_<environment>.mat`` holds one world. Rows of its matrices are
(step, value) or (id, value), x before y. The headings of environment 1 with 20 landmarks were
made anew after the runs of the paper; its robots drive as they do among 60, whose file has the
original ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.datasets.file_errors import blaming, require_folder
from fej_slam_ros.datasets.matlab import matrices
from fej_slam_ros.errors import UserError

ROBOTS = ('r1', 'r2')
MATRICES = ('R1XrTrue', 'R1XphiT', 'R2XrTrue', 'R2XphiT', 'XfTrueAll')

#: By (environment, landmarks), the number of landmarks in whose file the headings are.
HEADINGS = {(1, 20): 60}


@dataclass(frozen=True, slots=True, eq=False)
class TrueWorld:
    """
    The truth, in the frame ``map``.

    Attributes
    ----------
    poses : (K + 1, 3) array [x, y, phi] of each robot at the steps [m, m, rad]
    landmarks : (2,) position [m] of each landmark by its id

    """

    poses: Mapping[str, Array]
    landmarks: Mapping[int, Array]


def read(folder: Path, environment: int, landmarks: int) -> TrueWorld:
    """
    Return a world of the paper.

    Raises
    ------
    UserError
        A file is missing or not one of the authors'.

    """
    path = file_of(folder, environment, landmarks)
    turned = file_of(folder, environment, HEADINGS.get((environment, landmarks), landmarks))
    world, headings = _matrices(path), _matrices(turned)
    with blaming(path):
        points = {robot: _pairs(world[f'R{i}XrTrue']) for i, robot in enumerate(ROBOTS, 1)}
        places = _pairs(world['XfTrueAll'])
        for rows in points.values():
            _check_steps(rows, len(rows))
    with blaming(turned):
        for i, rows in enumerate(points.values(), 1):
            _check_steps(headings[f'R{i}XphiT'], len(rows))
    return TrueWorld(
        {robot: np.column_stack([rows[:, 1:], headings[f'R{i}XphiT'][:, 1]])
         for i, (robot, rows) in enumerate(points.items(), 1)},
        {int(number): np.array(point) for number, *point in places.tolist()})


def file_of(folder: Path, environment: int, landmarks: int) -> Path:
    """Return the path of a world's file."""
    return folder / f'MT_Parameters_{landmarks}fea_{environment}.mat'


def _matrices(path: Path) -> dict[str, Array]:
    require_folder(path.parent, 'the MT_Parameters files')
    if not path.is_file():
        raise UserError(
            f"{path.parent} holds no {path.name}: put the files of the paper's authors there, or"
            ' leave out --data to use worlds of our own')
    with blaming(path):
        found = matrices(path, dict.fromkeys(MATRICES, 2))
        missing = [name for name in MATRICES if name not in found]
        if missing:
            raise UserError(f'it lacks {", ".join(missing)}')
        if not all(np.isfinite(matrix).all() for matrix in found.values()):
            raise UserError('a value is not finite')
    return found


def _check_steps(rows: Array, count: int) -> None:
    if count < 2 or not np.array_equal(rows[:, 0], np.arange(count)):
        raise UserError('its trajectories do not lead from step 0 to 1, from 1 to 2 and so on')


def _pairs(rows: Array) -> Array:
    """Return rows (name, x, y) of pairs of rows (name, x) and (name, y)."""
    if len(rows) % 2 or not len(rows) or (rows[::2, 0] != rows[1::2, 0]).any():
        raise UserError('its rows do not go by pairs of x and y')
    return np.column_stack([rows[::2], rows[1::2, 1]])
