# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Ground truth of the simulated worlds of [Liu], from the authors' files.

``MT_Parameters_<landmarks>fea_<environment>.mat`` holds one world. Rows of its matrices are
(step, value) or (id, value), x before y. The headings of environment 1 with 20 landmarks were
generated again after the runs of the paper; its robots drive as they do among 60 landmarks, and
that file has the original headings.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.datasets.file_checks import errors_name, require_folder
from fej_slam_ros.datasets.matlab import joined_rows, required_matrices
from fej_slam_ros.errors import UserError

#: Number of columns of each matrix.
MATRICES = dict.fromkeys(('R1XrTrue', 'R1XphiT', 'R2XrTrue', 'R2XphiT', 'XfTrueAll'), 2)
#: Number of landmarks in the file that has the headings, by (environment, landmarks).
HEADING_FILES = {(1, 20): 60}


@dataclass(frozen=True, slots=True, eq=False)
class TrueWorld:
    """Ground truth in the frame ``map``."""

    #: (K + 1, 3) array [x, y, phi] of each robot at the steps [m, m, rad].
    poses: Mapping[str, Array]
    landmarks: Mapping[int, Array]  #: (2,) position [m] of each landmark by its ID


def read(folder: Path, environment: int, landmarks: int) -> TrueWorld:
    """Return a world of the paper from a folder with the authors' files."""
    path = file_of(folder, environment, landmarks)
    heading_path = file_of(
        folder, environment, HEADING_FILES.get((environment, landmarks), landmarks))
    world, headings = _matrices(path), _matrices(heading_path)
    poses = {}
    for i in (1, 2):
        with errors_name(path):
            steps, points = _points(world[f'R{i}XrTrue'])
            _check_steps(steps, len(steps))
        with errors_name(heading_path):
            heading_steps, phi = headings[f'R{i}XphiT'].T
            _check_steps(heading_steps, len(steps))
        poses[f'r{i}'] = np.column_stack([points, phi])
    with errors_name(path):
        ids, points = _points(world['XfTrueAll'])
    return TrueWorld(poses, dict(zip(ids.astype(int).tolist(), points)))


def file_of(folder: Path, environment: int, landmarks: int) -> Path:
    """Return the path of a world's file."""
    return folder / f'MT_Parameters_{landmarks}fea_{environment}.mat'


def _matrices(path: Path) -> dict[str, Array]:
    require_folder(path.parent, 'the MT_Parameters files')
    if not path.is_file():
        raise UserError(
            f"{path.parent} holds no {path.name}: put the files of the paper's authors there, or"
            ' omit --data to use the worlds of this package')
    with errors_name(path):
        return required_matrices(path, MATRICES)


def _points(rows: Array) -> tuple[Array, Array]:
    """Return the names (n,) and points (n, 2) of rows (name, x) and (name, y) in turn."""
    names, points = joined_rows(rows[:, :1], rows[:, 1], 2)
    return names[:, 0], points


def _check_steps(steps: Array, count: int) -> None:
    if count < 2 or not np.array_equal(steps, np.arange(count)):
        raise UserError('its steps are not numbered 0, 1 and so on')
