# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence that a landmark was moved does not depend on the directions of the frame."""

import pytest

from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence
from helpers.core import turn


@pytest.mark.parametrize('angle', [0.0, 0.3, 0.8, 2.0])
@pytest.mark.parametrize(('distance', 'is_sufficient'), [(1.9, False), (2.1, True)])
def test_observers_are_far_apart_in_any_direction(angle, distance, is_sufficient):
    evidence = MovedLandmarkEvidence()

    for _ in range(4):
        for position in ([0.0, 0.0], [distance, 0.0], [0.0, 1.5]):
            evidence.add('r1', turn(angle) @ position)

    assert evidence.is_sufficient() == is_sufficient
