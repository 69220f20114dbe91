# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two observations of a landmark that stands still agree after the motion between them."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.calibration.observation_pairs import observation_pairs
from fej_slam_ros.core.geometry import compose, inverse, transform
from fej_slam_ros.core.records import NO_ID, NS, Observation, Odometry, Scan
from helpers.core import central_differences

SENSOR = np.array([0.3, -0.2, 2.0])


@pytest.fixture(params=[True, False], ids=['IDs', 'no IDs'])
def pairs(request):
    """Return exact observations of two landmarks by a sensor on a robot that turns."""
    landmarks = np.array([[14.0, 21.0], [12.0, 15.0]])
    odometry, scans, pose = [], [], np.array([10.0, 20.0, 3.0])
    for k in range(50):
        stamp = k * NS // 10
        odometry.append(Odometry('r', stamp, pose, None))
        z = transform(inverse(compose(pose, SENSOR)), landmarks)
        scans.append(Scan('r', stamp, tuple(
            Observation(id_ if request.param else NO_ID, z_k, 0.01 * np.eye(2))
            for id_, z_k in enumerate(z))))
        pose = compose(pose, np.array([0.05, 0.0, 0.03]))
    return observation_pairs(odometry, scans, NS)


def test_exact_observations_agree_at_the_pose_of_the_sensor(pairs):
    # Of two landmarks, by scans 0.6 to 4.2 s after the first one; the scan at 4.3 s is the last.
    assert len(pairs.sigma) == 2 * 37
    assert (np.diff(pairs.stamps, axis=0) <= NS).all()
    assert_allclose(pairs.at_odometry(0.0).residuals(SENSOR), 0.0, atol=1e-9)


def test_the_jacobian_is_the_derivative_of_the_residuals(pairs):
    placed = pairs.at_odometry(0.0)

    expected = central_differences(lambda pose: placed.residuals(pose).ravel(), SENSOR)

    assert_allclose(placed.jacobian(SENSOR).reshape(-1, 3), expected, atol=1e-6)
