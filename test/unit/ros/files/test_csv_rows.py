# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the CSV files are read back to the same bits."""

import csv
import io

import numpy as np

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.ros.files import csv_rows

#: Symmetric, with digits that decimal rounding would lose.
P = np.array([
    [0.1, 0.2 / 3.0, 1e-17], [0.2 / 3.0, 0.7, -1.0 / 3.0], [1e-17, -1.0 / 3.0, 2.0**-40]])


def through_csv(columns, cells):
    """Return a row as it is read from a file."""
    file = io.StringIO()
    csv.writer(file).writerows([columns, cells])
    file.seek(0)
    return next(csv.DictReader(file))


def test_a_pose_survives_the_round_trip_bit_for_bit():
    pose = PoseEstimate('r1', 1_795_000_000_003_456_789, 'map', np.array([0.1, -1e9, 3.0]), P)

    lines = ','.join(csv_rows.TRAJECTORY_COLUMNS), csv_rows.pose_line(pose).decode()
    row = csv_rows.read_pose(next(csv.DictReader(lines)))

    assert (row.stamp, row.frame) == (pose.stamp, 'map')
    np.testing.assert_array_equal(row.pose, pose.pose)
    np.testing.assert_array_equal(row.P, P)


def test_a_landmark_survives_the_round_trip_bit_for_bit():
    cells = csv_rows.landmark_cells(-7, 'r1/map', np.array([1.0 / 3.0, 1e-300]), P[:2, :2])

    row = csv_rows.read_landmark(through_csv(csv_rows.LANDMARK_COLUMNS, cells))

    assert (row.id, row.frame) == (-7, 'r1/map')
    np.testing.assert_array_equal(row.point, [1.0 / 3.0, 1e-300])
    np.testing.assert_array_equal(row.P, P[:2, :2])
