# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scales and turn bias of odometry are found, by ground truth or by landmarks, and corrected."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.calibration.errors_by_landmarks import fit_to_landmarks
from fej_slam_ros.core.calibration.odometry_errors import fit_to_truth
from fej_slam_ros.core.calibration.true_motions import true_motions
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import NS, Odometry
from fej_slam_ros.core.settings import RobotSettings
from helpers.wrong_odometry import DT, run

NO_ERRORS = np.array([1.0, 1.0, 0.0])


def by_truth(odometry, _, true, given=NO_ERRORS):
    truth = RecordedTruth()
    for record in true:
        truth.add(record)
    motions = true_motions(odometry, truth)
    return None if motions is None else fit_to_truth(motions, given)


def by_landmarks(odometry, scans, _, given=NO_ERRORS):
    *scale, bias = given
    fit = fit_to_landmarks(odometry, scans, RobotSettings(
        'r', 1, odometry_scale=tuple(scale), odometry_turn_bias=bias))
    return None if fit is None else fit.odometry


FITS = pytest.mark.parametrize('fit', [by_truth, by_landmarks])


@FITS
@pytest.mark.parametrize(('scale', 'bias'), [
    ((0.95, 1.0), 0.0), ((1.0, 1.04), 0.0), ((1.0, 1.0), 0.01), ((1.06, 0.93), -0.02),
    ((1.0, 0.55), 0.0)])
def test_errors_are_those_of_the_simulation(fit, scale, bias):
    errors = fit(*run(scale, bias))

    # Beyond 4 standard errors once in 16,000 such values.
    assert (np.abs(errors.values - [*scale, bias]) < 4.0 * errors.sigma).all()
    assert (errors.sigma < [0.005, 0.005, 0.001]).all()
    assert_array_equal(errors.values != NO_ERRORS, np.array([*scale, bias]) != NO_ERRORS)


def test_where_a_robot_stands_most_of_the_time_its_errors_are_those_of_driving():
    """Its turn bias is of uneven wheels, and its true headings have no error."""
    odometry, _, true = run(bias=0.01)
    halves = len(odometry) // 2
    standing = range(halves, halves + 3 * len(odometry))
    records = {
        kind: [
            *some[:halves],
            *(replace(some[halves - 1], stamp=round(k * DT * NS)) for k in standing),
            *(replace(r, stamp=r.stamp + round(len(standing) * DT * NS)) for r in some[halves:])]
        for kind, some in (('odometry', odometry), ('true', true))}

    errors = by_truth(records['odometry'], None, records['true'])

    assert errors.values[2] == pytest.approx(0.01, abs=4.0 * errors.sigma[2])
    truth = RecordedTruth()
    for record in records['true']:
        truth.add(record)
    heading, sigma = true_motions(records['odometry'], truth).heading_error(errors.values)
    assert abs(heading) < 4.0 * sigma
    assert sigma < 0.005


@FITS
def test_large_noise_of_odometry_does_not_make_its_scale_too_small(fit):
    errors = fit(*run((0.95, 1.0), seconds=3000.0, slip=0.06))

    # The noise of 5 s, 0.4 m, is a sixth of the distance: its square would be 3 % of the scale. By
    # landmarks, that of 3 s is a fifth, which would be 4 %.
    assert errors.values[0] == pytest.approx(0.95, abs=3.0 * errors.sigma[0])
    assert errors.sigma[0] < 0.01


@FITS
def test_odometry_without_errors_has_none_whatever_was_given(fit):
    errors = fit(*run(), np.array([0.9, 1.1, 0.05]))

    assert errors.is_known.all()
    assert_array_equal(errors.values, NO_ERRORS)


@FITS
def test_what_the_motion_does_not_show_is_left_as_it_is(fit):
    errors = fit(*run((0.95, 0.8), radius=np.inf), np.array([0.9, 1.1, 0.0]))

    assert errors.values[0] == pytest.approx(0.95, abs=0.005)
    assert errors.is_known[0]
    assert not errors.is_known[1]
    assert errors.values[1] == 1.1


def test_gaps_in_the_ground_truth_are_not_bridged():
    # Truth in 20 s of each 50 s, between which the robot turns by more than half a turn.
    odometry, scans, true = run((0.9, 0.9), 0.03, seconds=1500.0)
    some = [record for record in true if record.stamp % (50 * NS) < 20 * NS]

    errors = by_truth(odometry, scans, some)

    assert_allclose(errors.values, [0.9, 0.9, 0.03], atol=0.005)


@FITS
def test_errors_that_are_none_of_odometry_are_reported(fit):
    errors = fit(*run(scale=(0.6, 1.0)))

    assert errors.is_at_limit.any()
    assert not errors.is_known[0]


def test_too_little_data_give_no_errors():
    assert by_truth(*run(seconds=100.0)) is None
    assert by_landmarks(*run(seconds=1.5)) is None


def test_many_pairs_within_seconds_are_too_little_data():
    odometry, scans, true = run()
    first = [scan for scan in scans if scan.stamp < 80 * NS]

    assert by_landmarks(odometry, scans, true) is not None
    assert by_landmarks(odometry, first, true) is None
    assert by_truth([], [], []) is None
    assert by_landmarks([], [], []) is None


def test_corrected_increments_are_the_true_ones():
    settings = RobotSettings('r', 1, odometry_scale=(0.9, 1.1), odometry_turn_bias=0.05)
    true, dt = np.array([0.3, 0.02, 0.25]), 0.5
    measured = np.array([0.3 / 0.9, 0.02 / 0.9, (0.25 + 0.05 * dt) / 1.1])
    begin = Odometry('r', 0, np.array([4.0, -2.0, 3.0]), None)
    end = replace(begin, stamp=round(dt * NS), pose=compose(begin.pose, measured))

    u, _ = increment(begin, end, settings)

    assert_allclose(u, true, atol=1e-12)
    assert_allclose(
        increment(begin, end, RobotSettings('r', 1))[0], between(begin.pose, end.pose),
        atol=1e-15)
