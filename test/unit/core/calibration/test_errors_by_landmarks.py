# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bearing bias of a sensor is found from the direction of travel by odometry."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.calibration.errors_by_landmarks import fit_to_landmarks
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import RobotSettings
from helpers.wrong_odometry import run

#: A sensor that is turned to the left observes all bearings too far to the right.
LEFT, RIGHT = (0.0, 0.0, 0.03), (0.0, 0.0, -0.03)
#: A sensor whose place on the robot is not in its settings.
AHEAD = (0.3, 0.0, 0.0)


def fit(odometry, scans, _=None, **given):
    return fit_to_landmarks(odometry, scans, RobotSettings('r', 1, **given))


@pytest.mark.parametrize(('sensor', 'expected'), [(LEFT, -0.03), (RIGHT, 0.03)])
@pytest.mark.parametrize(('scale', 'bias'), [((1.0, 1.0), 0.0), ((0.95, 1.04), 0.01)])
def test_bearing_biases_and_errors_of_odometry_are_those_of_the_simulation(
        sensor, expected, scale, bias):
    errors = fit(*run(scale, bias, sensor=sensor))
    bearing, sigma = errors.observations.values[1], errors.observations.sigma[1]

    # Beyond 4 standard errors once in 16,000 such values.
    assert abs(bearing - expected) < 4.0 * sigma
    assert sigma < 0.003
    assert (np.abs(errors.odometry.values - [*scale, bias]) < 4.0 * errors.odometry.sigma).all()


def test_the_range_scale_remains_as_given():
    odometry, scans, _ = run(sensor=LEFT)
    short = [
        replace(scan, observations=tuple(
            replace(o, z=o.z / 1.1) for o in scan.observations)) for scan in scans]

    errors = fit(odometry, short, observation_range_scale=1.1)

    assert errors.observations.values[0] == 1.1
    assert not errors.observations.is_known[0]
    assert errors.observations.values[1] == pytest.approx(-0.03, abs=0.01)
    assert errors.odometry.values[0] == 1.0


@pytest.mark.parametrize('given', [-0.03, 0.2])
def test_the_bias_does_not_depend_on_the_given_one(given):
    expected = fit(*run(sensor=LEFT)).observations

    found = fit(*run(sensor=LEFT), observation_bearing_bias=given).observations

    assert found.values[1] == pytest.approx(expected.values[1], abs=1e-6)


def test_a_sensor_without_bias_has_none_whatever_was_given():
    found = fit(*run(), observation_bearing_bias=0.1).observations

    assert found.is_known[1]
    assert found.values[1] == 0.0


@pytest.mark.parametrize(('radius', 'sensor'), [(None, (0.0, 0.0, 0.03)), (4.0, AHEAD)])
def test_no_position_is_reported_that_is_small_or_not_determined(radius, sensor):
    assert not fit(*run(radius=radius, sensor=sensor)).position.any()


def test_wheels_that_skid_show_no_position():
    # Turns are half as large as by odometry.
    found = fit(*run(scale=(1.0, 0.5), turn_rate=0.3))

    assert found.odometry.values[1] == pytest.approx(0.5, abs=0.01)
    assert not found.position.any()


@pytest.mark.parametrize('delay', [0.2, -0.3])
@pytest.mark.parametrize(('scale', 'bias'), [((1.0, 1.0), 0.0), ((0.95, 1.06), 0.01)])
def test_late_stamps_are_no_error_of_odometry(delay, scale, bias):
    odometry, scans, _ = run(scale, bias, is_abrupt=True)
    late = [replace(scan, stamp=scan.stamp + round(delay * NS)) for scan in scans]

    errors = fit(odometry, late)

    # Without the delay among what is fitted, turns seem to be 10 % too large.
    assert errors.delay == pytest.approx(delay, abs=0.01)
    assert errors.odometry.values == pytest.approx([*scale, bias], abs=0.02)


@pytest.mark.parametrize('changes', [
    {}, {'radius': 4.0}, {'radius': np.inf}, {'scale': (1.0, 0.6), 'turn_rate': 0.3},
    {'sensor': AHEAD, 'turn_rate': 0.3}])
def test_stamps_that_are_right_are_not_called_late(changes):
    assert fit(*run(**changes)).delay == 0.0


@pytest.mark.parametrize('position', [(0.15, 0.0), (0.0, 0.15), (-0.2, 0.15)])
def test_a_sensor_beside_the_origin_is_not_turned(position):
    """At 0.3 rad/s and 0.5 m/s, 0.15 m ahead turns the direction of travel by 0.09 rad."""
    errors = fit(*run(sensor=(*position, 0.0), turn_rate=0.3))

    # The standard error of a coordinate is 1 mm.
    assert errors.position == pytest.approx(position, abs=0.005)
    assert errors.observations.is_known[1]
    assert errors.observations.values[1] == 0.0
    assert (errors.odometry.values == [1.0, 1.0, 0.0]).all()


@pytest.mark.parametrize(('radius', 'sensor'), [(0.8, LEFT), (4.0, LEFT), (4.0, AHEAD)])
def test_on_circles_about_one_centre_a_bias_is_not_told_from_the_position(radius, sensor):
    """On circles of 4 m, 0.3 m ahead is the same as 0.075 rad."""
    found = fit(*run(radius=radius, sensor=sensor), observation_bearing_bias=0.01).observations

    assert not found.is_known[1]
    assert found.values[1] == 0.01


def test_a_bias_that_is_none_of_a_sensor_is_reported():
    found = fit(*run(sensor=(0.0, 0.0, 0.5))).observations

    assert found.is_at_limit[1]
    assert not found.is_known[1]
