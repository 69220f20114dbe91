# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariances that observations contradict."""

from types import SimpleNamespace

import numpy as np
import pytest

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.stated_noise import check
from fej_slam_ros.ros.doctor.survey import OdometrySeries


# NIS/dof of 88 degrees of freedom has a standard deviation of 0.15.
@pytest.mark.parametrize(('dof', 'expected'), [
    (40, []), (88, []), (1000, ['optimistic_odometry'])])
def test_precise_odometry_is_not_blamed_for_the_chance_of_a_short_bag(dof, expected):
    stamps = (np.arange(200) * NS // 10).tolist()
    odometry = OdometrySeries(
        stamps, stamps, poses=[(0.1 * k, 0.0, 0.0) for k in range(200)],
        covariances=[1e-5 * np.eye(3)] * 200)
    nis = {'r1': NisMonitor(total=1.25 * dof, dof=dof)}
    trial = SimpleNamespace(estimator=SimpleNamespace(innovations=SimpleNamespace(nis=nis)))

    found = check(RobotSettings('r1', 1), odometry, trial)

    assert [finding.name for finding in found] == expected
