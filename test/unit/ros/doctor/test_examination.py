# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings that others explain are left out; what explains an error is one."""

import pytest

from fej_slam_ros.ros.doctor.examination import unexplained
from fej_slam_ros.ros.doctor.findings import error, warning

DOES_NOT_FIT = error('does_not_fit', 'r1', '', '')


def names(findings):
    return [(f.severity.value, f.name, f.where) for f in unexplained(findings, 2)]


@pytest.mark.parametrize('name', ['sensor_pose', 'sensor_mirrored'])
def test_a_wrong_pose_of_a_sensor_is_an_error_where_its_robot_fits_nothing(name):
    found = [
        warning(name, 'r1/landmarks', '', ''), DOES_NOT_FIT, error('never_joins', 'r2', '', '')]

    assert names(found) == [('error', name, 'r1/landmarks')]


def test_it_stays_a_warning_where_its_robot_fits():
    found = [warning('sensor_pose', 'r2/landmarks', '', ''), DOES_NOT_FIT]

    assert names(found) == [
        ('warning', 'sensor_pose', 'r2/landmarks'), ('error', 'does_not_fit', 'r1')]
