# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`doctor` names systematic errors of odometry and bearings that landmarks show."""

from dataclasses import replace

import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor import systematic_errors
from helpers.wrong_odometry import run


def whats(scale=(1.0, 1.0), bias=0.0, yaw=0.0, position=(0.0, 0.0), **given):
    """Return the descriptions of the findings on odometry with errors and a misplaced sensor."""
    odometry, scans, _ = run(scale, bias, seconds=300.0, sensor=(*position, yaw))
    robot = RobotSettings('r', 1, **given)
    return [finding.what for finding in systematic_errors.check(robot, odometry, scans)]


@pytest.mark.parametrize(('scale', 'bias', 'words'), [
    ((1.08, 1.0), 0.0, ('distances', 'too short')),
    ((0.92, 1.0), 0.0, ('distances', 'too long')),
    ((1.0, 1.1), 0.0, ('turns', 'too small')),
    ((1.0, 0.9), 0.0, ('turns', 'too large')),
    ((1.0, 1.0), 0.02, ('turn rate', 'too high')),
    ((1.0, 1.0), -0.02, ('turn rate', 'too low')),
])
def test_an_error_is_named_with_its_sign_alone(scale, bias, words):
    (what,) = whats(scale, bias)

    assert what.count(' too ') == 1
    for word in words:
        assert word in what


@pytest.mark.parametrize(('delay', 'words'), [
    (0.2, ('0.20 s too late', 'sensor_delay of the robot to 0.25')),
    (-0.2, ('0.20 s too early', 'sensor_delay of the robot to -0.15'))])
def test_stamps_of_another_time_are_named_with_the_parameter_that_corrects_them(delay, words):
    odometry, scans, _ = run(seconds=300.0)
    late = [replace(scan, stamp=scan.stamp + round(delay * NS)) for scan in scans]

    # The stamps have been corrected by 0.05 s before.
    (finding,) = systematic_errors.check(
        RobotSettings('r', 1, sensor_delay=0.05), odometry, late)

    assert finding.name == 'sensor_time'
    for word, text in zip(words, (finding.what, finding.cure)):
        assert word in text


def test_all_errors_are_in_one_finding():
    (what,) = whats((1.08, 0.9), 0.02)

    assert what.count(' too ') == 3


@pytest.mark.parametrize(('scale', 'bias'), [((1.0, 1.0), 0.0), ((1.015, 0.99), 0.002)])
def test_odometry_without_errors_and_with_small_ones_has_no_finding(scale, bias):
    assert not whats(scale, bias)


def test_errors_that_parameters_correct_have_no_finding():
    given = {'odometry_scale': (1.08, 0.9), 'odometry_turn_bias': 0.02}

    assert not whats((1.08, 0.9), 0.02, **given)
    assert whats(**given)


@pytest.mark.parametrize(('yaw', 'side'), [(0.03, 'right'), (-0.03, 'left')])
def test_a_turned_sensor_is_named_with_its_side(yaw, side):
    (what,) = whats(yaw=yaw)

    assert what.endswith(f'rad too far to the {side}')
    assert not whats(yaw=yaw, observation_bearing_bias=-yaw)


def test_a_sensor_elsewhere_on_the_robot_is_named_with_its_place():
    (what,) = whats(position=(0.3, -0.15))

    assert '+0.30 m further ahead and -0.15 m further to the left' in what
