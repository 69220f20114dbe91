# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What the authors of [Liu] took for the truth of Victoria Park: their Gauss-Newton solution.

``X_GNI.mat`` holds a matrix X with rows [1, pose, value] for x, y and the heading of poses 1, 2
and so on, then rows [2, id, value] for x and y of the landmarks. Pose 0 is the origin and is not
stored; headings are not wrapped.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.datasets.file_errors import blaming
from fej_slam_ros.datasets.matlab import matrices
from fej_slam_ros.errors import UserError


@dataclass(frozen=True, slots=True, eq=False)
class XGni:
    """Poses (K + 1, 3) [m, m, rad], pose 0 included, and a point (2,) [m] for each landmark id."""

    poses: Array
    points: Mapping[int, Array]


def find(folder: Path) -> Path | None:
    """Return the file in a folder, or None where there is none."""
    path = folder / 'X_GNI.mat'
    return path if path.is_file() else None


def read(path: Path) -> XGni:
    """
    Return the solution in a file.

    Raises
    ------
    UserError
        The file holds something else, or is damaged.

    """
    with blaming(path):
        return _solution(_matrix(path))


def _matrix(path: Path) -> Array:
    found = matrices(path, {'X': 3})
    if 'X' not in found:
        raise UserError('the variable X is not in it')
    return found['X']


def _solution(X: Array) -> XGni:
    if not (np.isfinite(X).all() and np.isin(X[:, 0], (1, 2)).all()):
        raise UserError('a value is not finite, or neither of a pose nor of a landmark')
    numbers, poses = _joined(X[X[:, 0] == 1], 3)
    ids, points = _joined(X[X[:, 0] == 2], 2)
    if (numbers != np.arange(1, len(numbers) + 1)).any():
        raise UserError('its poses do not go from 1 to 2 and so on')
    poses[:, 2] = wrap_all(poses[:, 2])
    return XGni(np.vstack([np.zeros(3), poses]), dict(zip(ids.astype(int).tolist(), points)))


def _joined(rows: Array, count: int) -> tuple[Array, Array]:
    """Return the number that each ``count`` rows name, (n,), and their values, (n, count)."""
    if len(rows) % count:
        raise UserError(f'{len(rows)} of its rows do not go by {count}')
    numbers, values = rows[:, 1].reshape(-1, count), rows[:, 2].reshape(-1, count)
    if (numbers != numbers[:, :1]).any():
        raise UserError('rows that belong together name different poses or landmarks')
    return numbers[:, 0], values
