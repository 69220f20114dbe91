# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Minimum, cost and degrees of freedom of a map."""

import numpy as np

from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother

POINTS = [(1.0, 2.0), (3.0, -1.0), (0.5, 1.0)]


def part():
    """Return a smoother of two poses that both observe three landmarks, without errors."""
    def observed(x):
        return [Observation(k, point - np.array([x, 0.0]), np.eye(2))
                for k, point in enumerate(POINTS)]

    smoother = IncrementalSmoother(observed(0.0))
    smoother.add(np.array([0.2, 0.0, 0.0]), np.eye(3), observed(0.2))
    return smoother


def test_an_unknown_motion_counts_as_no_measurement():
    smoother = part()

    smoother.append(part(), np.zeros(3))

    joint = JointMap.of(LocalMap(
        'r1', smoother.problem(), smoother.values(), tuple(('', k) for k in range(3))))
    # 2 increments of 3 coordinates and 4 * 3 observations of 2, for 3 poses and 3 landmarks.
    assert joint.dof == 2 * 3 + 12 * 2 - (3 * 3 + 3 * 2)
