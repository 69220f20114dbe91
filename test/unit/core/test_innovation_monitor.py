# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of innovations: sums over robots and updates."""

import numpy as np
import pytest

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association
from fej_slam_ros.core.ekf.state import Robot
from fej_slam_ros.core.innovation_monitor import InnovationMonitor


def innovation(y, log_det, *observers):
    robots = {name: Robot(name, None, 0) for name in observers}
    associations = [Association(robots[name], robots[name], None) for name in observers]
    return Innovation(associations, np.array(y), (), (), log_det)


def test_nis_is_summed_by_robot_and_the_likelihood_over_all():
    monitor = InnovationMonitor()
    monitor.nis = {'r1': NisMonitor(), 'r2': NisMonitor()}

    monitor.add(1, innovation([1.0, 2.0, 3.0, 0.0], 0.5, 'r1', 'r2'), {})
    monitor.add(2, innovation([0.0, 2.0], 1.5, 'r1'), {})

    assert (monitor.nis['r1'].total, monitor.nis['r1'].dof) == (9.0, 4)
    assert (monitor.nis['r2'].total, monitor.nis['r2'].dof) == (9.0, 2)
    # -1/2 (1 + 4 + 9 + 0.5) - 1/2 (4 + 1.5), exact in binary.
    assert monitor.log_likelihood == pytest.approx(-10.0, abs=1e-15)
