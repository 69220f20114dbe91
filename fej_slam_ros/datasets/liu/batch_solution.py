# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The Gauss-Newton solution of Victoria Park that [Liu] uses as ground truth.

``X_GNI.mat`` holds a matrix X with rows [1, pose, value] for x, y and the heading of poses 1, 2
and so on, then rows [2, id, value] for x and y of the landmarks. Pose 0 is the origin and is not
stored; headings are not wrapped.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.datasets.file_checks import errors_name
from fej_slam_ros.datasets.matlab import joined_rows, required_matrices
from fej_slam_ros.errors import UserError


@dataclass(frozen=True, slots=True, eq=False)
class XGni:
    """Poses (K + 1, 3) [m, m, rad], pose 0 included, and a point (2,) [m] for each landmark ID."""

    poses: Array
    points: Mapping[int, Array]


def find(folder: Path) -> Path | None:
    """Return the path of the file in a folder, or None if there is none."""
    path = folder / 'X_GNI.mat'
    return path if path.is_file() else None


def read(path: Path) -> XGni:
    """Return the solution in a file."""
    with errors_name(path):
        X = required_matrices(path, {'X': 3})['X']
        if not np.isin(X[:, 0], (1, 2)).all():
            raise UserError('a row is neither of a pose nor of a landmark')
        of_poses, of_landmarks = X[X[:, 0] == 1], X[X[:, 0] == 2]
        steps, poses = joined_rows(of_poses[:, 1:2], of_poses[:, 2], 3)
        ids, points = joined_rows(of_landmarks[:, 1:2], of_landmarks[:, 2], 2)
        if (steps[:, 0] != np.arange(1, len(steps) + 1)).any():
            raise UserError('its poses are not numbered 1, 2 and so on')
    poses[:, 2] = wrap_all(poses[:, 2])
    landmarks = dict(zip(ids[:, 0].astype(int).tolist(), points))
    return XGni(np.vstack([np.zeros(3), poses]), landmarks)
