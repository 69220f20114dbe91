# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a joined run."""

from io import BytesIO

from matplotlib.image import imread
import numpy as np
import pytest

from fej_slam_ros.experiments.andersson.experiment import CsamTask, solve
from fej_slam_ros.experiments.andersson.figure import draw

#: Rows of pixels with the titles of the upper panels, and columns beside the panels.
TITLES, MARGIN = slice(30, 50), 20


@pytest.mark.parametrize('experiment', ['map_joining', 'sensor_extension'])
def test_the_titles_of_the_figure_end_before_its_edges(experiment):
    solution, picture = solve(CsamTask(experiment, 3)), BytesIO()

    draw(picture, solution, solution.joint)

    picture.seek(0)
    pixels = imread(picture, format='png')[TITLES, :, :3]
    assert np.any(pixels < 0.5)
    assert np.all(pixels[:, :MARGIN] > 0.99)
    assert np.all(pixels[:, -MARGIN:] > 0.99)
