# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a joined run."""

from io import BytesIO

from fej_slam_ros.experiments.andersson.experiment import CsamTask, solve
from fej_slam_ros.experiments.andersson.figure import draw


def test_the_figure_is_a_png():
    solution = solve(CsamTask('map_joining', 3))
    picture = BytesIO()

    draw(picture, solution, solution.joint)

    assert picture.getvalue().startswith(b'\x89PNG')
