# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of one stamp in a file are scans that the estimator accepts."""

import numpy as np

from fej_slam_ros.core.records import NO_ID, Observation
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets.scans import distinct, divided


def seen(id_, x=1.0, R=None):
    return Observation(id_, np.array([x, 0.0]), np.eye(2) if R is None else R)


def test_a_scan_observes_a_landmark_once_and_any_number_without_id():
    scans = [[o.id for o in scan] for scan in divided(map(seen, [1, NO_ID, NO_ID, 2, 1, 3]))]

    assert scans == [[1, NO_ID, NO_ID, 2], [1, 3]]


def test_a_scan_has_no_more_observations_than_the_default_limit():
    most = Settings.max_observations

    assert [len(scan) for scan in divided(map(seen, range(2 * most + 3)))] == [most, most, 3]


def test_equal_positions_of_different_noise_are_two_observations():
    assert len(distinct([seen(1), seen(1), seen(1, R=2.0 * np.eye(2)), seen(1, x=2.0)])) == 3
