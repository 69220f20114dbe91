# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The textbook EKF equals the standard filter of this package."""

import numpy as np
from numpy.testing import assert_allclose

from fej_slam_ros.benchmark.synthetic_drive import drive, START_P
from fej_slam_ros.benchmark.textbook import Textbook
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import Standard
from fej_slam_ros.core.ekf.state import JointState


def test_the_textbook_ekf_has_the_estimate_of_the_standard_filter_at_every_step():
    course = drive(30, 60, 1.0, 5, np.random.default_rng(1))
    textbook, team = Textbook(), Filter(JointState(), Standard(), Gate(1.0))
    for name, pose in course.starts.items():
        textbook.insert_robot(name, 0, pose, START_P)
        team.state.insert_robot(name, 0, pose, START_P)

    for motions, scans in course.steps:
        found = textbook.step(motions, scans)
        team.step(motions, scans)

        for name, robot in team.state.robots.items():
            x, P = found[name]
            # Rounding of two paths to compute the same, over sixty steps.
            assert_allclose(x, team.state.estimate(robot), atol=1e-8)
            assert_allclose(P, team.state.marginal([robot]), atol=1e-8)
    assert len(team.state.landmarks) > 20
