# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A published map is read with all its digits."""

import numpy as np

from fej_slam_ros.ros.messages import own_results
from helpers.ros import cloud


def test_a_published_map_is_read_in_its_highest_precision():
    fields = {'x': ('f4', [451_234.567]), 'y': ('f4', [5_411_876.123]), 'id': ('i4', [7])}
    exact = {'x_f64': ('f8', [451_234.567]), 'y_f64': ('f8', [5_411_876.123])}

    ids, points, _ = own_results.map_landmarks(cloud(fields | exact))
    _, of_another_node, _ = own_results.map_landmarks(cloud(fields))

    assert (ids.tolist(), points.tolist()) == ([7], [[451_234.567, 5_411_876.123]])
    assert of_another_node.tolist() == [[np.float32(451_234.567), np.float32(5_411_876.123)]]
