# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors by ground truth, whose headings may be off."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.calibration.systematic_errors import (
    errors_by_truth, SystematicErrors, with_errors_by_landmarks)
from fej_slam_ros.core.records import TruePose
from fej_slam_ros.core.settings import RobotSettings, Settings
from helpers.wrong_odometry import run

SETTINGS = Settings((RobotSettings('r', 1),), 'r')
#: A sensor that is turned to the right observes all bearings too far to the left.
RIGHT = (0.0, 0.0, -0.03)


def errors(heading=0.0, **changes):
    """Return the errors found by true poses with wrong headings."""
    off = np.array([0.0, 0.0, heading])
    records = [record for of_kind in run(**changes) for record in of_kind]
    return errors_by_truth([
        (replace(r, pose=r.pose + off) if isinstance(r, TruePose) else r, r.stamp)
        for r in sorted(records, key=lambda r: r.stamp)], SETTINGS)


def bearing(found):
    """Return the bearing bias of the robot, its standard error, and whether it is known."""
    observations = found.observations_by_truth['r']
    return observations.values[1], observations.sigma[1], observations.is_known[1]


@pytest.mark.parametrize('seconds', [150.0, 600.0])
@pytest.mark.parametrize(('heading', 'sensor', 'expected'), [
    (0.0, RIGHT, 0.03), (0.05, RIGHT, 0.03), (0.05, (0.0, 0.0, 0.0), 0.0)])
def test_a_bearing_bias_is_not_that_of_the_true_headings(seconds, heading, sensor, expected):
    found = errors(heading, sensor=sensor, seconds=seconds)

    value, sigma, is_known = bearing(found)
    assert is_known
    # Beyond 4 standard errors once in 16,000 such values.
    assert abs(value - expected) < 4.0 * sigma
    assert sigma < 0.01 / 4.0
    assert ('r' in found.headings) == (heading != 0.0)


def test_true_headings_that_seem_right_leave_the_bearings_as_uncertain_as_they_are():
    """Wheels that slip do not show an error of 0.02 rad."""
    found = errors(0.02, slip=0.1, seconds=150.0)

    value, sigma, _ = bearing(found)
    assert not found.headings
    assert abs(value) < 4.0 * sigma
    assert sigma > 0.005


def test_without_the_direction_of_travel_a_bearing_bias_is_not_known():
    """The robot drives for less than 20 motions of 5 s."""
    found = errors(sensor=RIGHT, seconds=99.0)

    assert bearing(found)[::2] == (0.0, False)
    assert not found.odometry_by_truth


def test_a_wrong_scale_of_distances_may_be_one_of_ranges_instead():
    odometry, scans, _ = run(seconds=150.0)
    short = [
        replace(scan, observations=tuple(
            replace(o, z=0.9 * o.z) for o in scan.observations)) for scan in scans]
    records = [(r, r.stamp) for r in sorted([*odometry, *short], key=lambda r: r.stamp)]
    found = with_errors_by_landmarks(SystematicErrors(), records, SETTINGS)
    assert found.odometry_by_landmarks['r'].values[0] == pytest.approx(0.9, abs=0.01)

    other = found.with_error_of_ranges('r')

    assert other.odometry_by_landmarks['r'].values[0] == 1.0
    scale, sigma = (
        getattr(other.observations_by_landmarks['r'], name)[0] for name in ('values', 'sigma'))
    assert abs(scale - 1.0 / 0.9) < 4.0 * sigma
    assert sigma < 0.01
