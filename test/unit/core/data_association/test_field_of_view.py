# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The field of view is that of most observations."""

import numpy as np
import pytest

from fej_slam_ros.core.data_association.landmark_manager import FieldOfView, VIEW_OBSERVATIONS
from fej_slam_ros.core.records import NO_ID, Observation


def observations(rng, count):
    """Return observations of points that are uniform in a sector of 10 m and 1 rad."""
    r, beta = 10.0 * np.sqrt(rng.random(count)), rng.uniform(-1.0, 1.0, count)
    return [
        Observation(NO_ID, z, np.eye(2))
        for z in np.column_stack([r * np.cos(beta), r * np.sin(beta)])]


def test_it_contains_nearly_all_objects_of_a_sector():
    view = FieldOfView()
    view.add(observations(np.random.default_rng(1), VIEW_OBSERVATIONS))

    # Quantiles of 95 %: sqrt(0.95) of the range, 0.95 of the bearing; 500 samples, three sigma.
    assert view.range == pytest.approx(10.0 * np.sqrt(0.95), abs=0.15)
    assert view.bearing == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize('far', [100.0, 65_535.0])
def test_single_far_points_do_not_extend_it(far):
    rng, view = np.random.default_rng(2), FieldOfView()
    for k in range(100):
        view.add(observations(rng, 5))
        if k % 10 == 0:
            view.add([Observation(NO_ID, np.array([-far, 0.0]), np.eye(2))])

    assert view.range < 10.0
    assert view.bearing < 1.0
