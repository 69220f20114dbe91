# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a run has the shape of its scene."""

from io import BytesIO
import struct

import numpy as np
import pytest

from fej_slam_ros.cli.run_picture import draw_run
from fej_slam_ros.evaluation.run_result import EstimatedTrajectory, LandmarkMap, RunResult


def size(width, height):
    """Return the size [pixels] of the picture of a robot that crosses an area [m]."""
    file = BytesIO()
    poses = np.linspace([0.0, 0.0, 0.0], [width, height, 0.0], 9)
    trajectory = EstimatedTrajectory(
        np.arange(9), poses, np.tile(1e-4 * np.eye(3), (9, 1, 1)), 'map', 9)
    landmarks = LandmarkMap(
        np.array([1]), np.array([[0.5 * width, 0.1 * height]]), 1e-4 * np.eye(2)[None])
    draw_run(file, 'scene', RunResult({'r1': trajectory}, landmarks, {}), ['r1'], {}, [])
    # Width and height follow the signature and the first chunk's name.
    return struct.unpack('>2I', file.getvalue()[16:24])


@pytest.mark.needs('matplotlib')
def test_the_picture_of_a_wide_scene_has_no_empty_space_below_it():
    wide, high = size(30.0, 5.0), size(5.0, 30.0)

    # Beside a sixth of its width, title, axis and legend need about a fifth of it.
    assert wide[1] < 0.5 * wide[0]
    assert high[1] > high[0]
