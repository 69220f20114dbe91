# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Subscribers receive the numbers of the estimate, also far from the origin."""

import numpy as np
import pytest

from helpers.ros import CLOUD, LANDMARKS, meeting, raw_record

pytestmark = pytest.mark.ros

#: Start of the anchor in UTM coordinates [m, m, rad].
UTM = [451_234.567, 5_411_876.123, 0.0]


def test_a_subscriber_gets_the_map_at_utm_coordinates_in_float64(domain):
    node = domain.estimate(robots=['r1', 'r2'], anchor_pose=UTM)
    maps = domain.listen('/estimator/landmarks', CLOUD)
    domain.until(lambda: node.count_subscribers('/estimator/landmarks') == 1)

    domain.send(*map(raw_record, meeting(8)))
    domain.until(lambda: maps and maps[-1].width == 3)

    fields = {field.name: field.offset for field in maps[-1].fields}
    rows = maps[-1].data.reshape(3, -1)
    points = np.column_stack([
        rows[:, fields[name]:fields[name] + 8].copy().view(np.float64)[:, 0]
        for name in ('x_f64', 'y_f64')])
    # The observations are exact.
    np.testing.assert_allclose(
        points, np.array([*LANDMARKS.values()]) + UTM[:2], rtol=0.0, atol=1e-8)
