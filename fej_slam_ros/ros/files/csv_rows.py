# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of the CSV files of a run, and their rows: written, and read back to the same bits."""

from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import Array, symmetric
from fej_slam_ros.tables import Cells, finite_numbers, integer

TRAJECTORY_COLUMNS = (
    'stamp_ns', 'x', 'y', 'yaw', 'cov_xx', 'cov_xy', 'cov_xyaw', 'cov_yy', 'cov_yyaw',
    'cov_yawyaw', 'frame')
#: The frame is optional in a survey.
SURVEY_COLUMNS = ('id', 'x', 'y', 'var_x', 'cov_xy', 'var_y')
LANDMARK_COLUMNS = (*SURVEY_COLUMNS, 'frame')
ID_COLUMNS = ('landmark', 'robot', 'id')


class PoseRow(NamedTuple):
    """A pose (3,) in a frame, with its stamp [ns] and covariance P (3, 3)."""

    stamp: int
    frame: str
    pose: Array
    P: Array


class LandmarkRow(NamedTuple):
    """A landmark's position (2,) in a frame, with its covariance P (2, 2)."""

    id: int
    frame: str
    point: Array
    P: Array


def pose_line(estimate: PoseEstimate) -> bytes:
    """Return the row of a pose as a line."""
    x, y, yaw = estimate.pose.tolist()
    (xx, xy, xyaw), (_, yy, yyaw), (_, _, yawyaw) = estimate.P.tolist()
    return (
        f'{estimate.stamp},{x!r},{y!r},{yaw!r},{xx!r},{xy!r},{xyaw!r},{yy!r},{yyaw!r},{yawyaw!r},'
        f'{estimate.frame}\n').encode()


def landmark_cells(landmark: int, frame: str, point: Array, P: Array) -> list[object]:
    """Return the row of a landmark."""
    return [landmark, *point.tolist(), *P[np.triu_indices(2)].tolist(), frame]


def read_pose(cells: Cells) -> PoseRow:
    """Return a row of a trajectory; raises ValueError for cells that are not numbers."""
    numbers = np.array(finite_numbers(cells, TRAJECTORY_COLUMNS[1:-1]))
    return PoseRow(
        integer(cells, 'stamp_ns'), cells['frame'] or '', numbers[:3], symmetric(numbers[3:]))


def read_landmark(cells: Cells) -> LandmarkRow:
    """Return a row of a map; raises ValueError for cells that are not numbers."""
    numbers = np.array(finite_numbers(cells, SURVEY_COLUMNS[1:]))
    return LandmarkRow(
        integer(cells, 'id'), cells.get('frame') or '', numbers[:2], symmetric(numbers[2:]))
