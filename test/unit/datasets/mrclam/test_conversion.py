# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands become odometry and observations scans, both with their noise."""

from collections import Counter, defaultdict
from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.stats import norm

from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import Odometry, RobotScan, Scan, TrueLandmarks, TruePose
from fej_slam_ros.datasets.mrclam.conversion import records
from fej_slam_ros.datasets.mrclam.conversion_options import CameraNoise, Noise, range_increase
from fej_slam_ros.datasets.mrclam.files import read
from helpers.mrclam import EXACT, STRAIGHT, write_set

CIRCLE = 0.5, math.tau / 10


@pytest.fixture
def convert(tmp_path):
    """Return a function that makes records, and counts, of a set with some files replaced."""

    def make(reading=EXACT, **files):
        counts = defaultdict(Counter)
        data = read(write_set(tmp_path, {**STRAIGHT, **files}))
        return list(records(data, reading, counts)), +counts[1]

    return make


def of_kind(kind, converted):
    return [record for record in converted[0] if isinstance(record, kind)]


@pytest.mark.parametrize('rate', [2, 8.3, 67])
def test_a_circle_closes_at_any_rate_of_odometry(convert, rate):
    stamps = [*np.arange(100.0, 110.0, 1 / rate), 110.0]

    path = of_kind(Odometry, convert(Robot1_Odometry=[(f'{t:.6f}', *CIRCLE) for t in stamps]))

    half = min(path, key=lambda record: abs(record.stamp / 1e9 - 105.0))
    np.testing.assert_allclose(path[-1].pose[:2], [0, 0], atol=1e-6)  # stamps are of microseconds
    # After half a circle of 5 m around, or the next stamp, the robot is a diameter away.
    assert math.hypot(*half.pose[:2]) == pytest.approx(5 / math.pi, abs=0.01)


def test_a_command_is_in_force_until_the_next_also_across_a_gap(convert):
    rows = [(100, 0.1, 0), (101.4, 0.2, 0), (102, 0, 0)]

    path = of_kind(Odometry, convert(Robot1_Odometry=rows))

    np.testing.assert_allclose([record.pose[0] for record in path], [0, 0.14, 0.26])


def test_motion_lags_and_falls_short_of_its_command(convert):
    slow = replace(EXACT, motion_delay=0.2, odometry_scale=(0.9, 0.5))
    rows = [(100, 0.1, 0.0), (101, 0, 0.4), (102, 0, 0)]

    path = of_kind(Odometry, convert(slow, Robot1_Odometry=rows))

    assert [record.stamp for record in path] == [100_200_000_000, 101_200_000_000, 102_200_000_000]
    np.testing.assert_allclose([r.pose for r in path], [[0, 0, 0], [0.09, 0, 0], [0.09, 0, 0.2]])


@pytest.mark.parametrize('rate', [2, 67])
def test_variances_of_a_path_do_not_depend_on_the_odometry_rate(convert, rate):
    noise = Noise(position=(0.01, 0.0), heading=(0.0, 0.02))
    stamps = [*np.arange(100.0, 110.0, 1 / rate), 110.0]

    path = of_kind(Odometry, convert(
        replace(EXACT, noise=noise), Robot1_Odometry=[(f'{t:.6f}', -0.1, 0.2) for t in stamps]))

    dt = np.diff([record.stamp for record in path]) / 1e9
    total = sum(d**2 * record.twist_covariance for d, record in zip(dt, path[1:]))
    # A metre driven, two radians turned, and ten seconds of 1e-6.
    np.testing.assert_allclose(np.diag(total), [0.01 + 1e-5, 1e-5, 0.04 + 1e-5])
    assert path[0].twist_covariance is None


def test_in_a_long_gap_of_commands_the_variance_covers_motion_at_top_speed(convert):
    rows = [(100, 0.2, 0.5), (101, 0.0, 0.0), (105, 0.0, 0.0), (106, 0.0, 0.0)]

    _, _, after_gap, _ = of_kind(Odometry, convert(Robot1_Odometry=rows))

    sigma = np.sqrt(np.diag(after_gap.twist_covariance))
    # The noise of every command is included.
    np.testing.assert_allclose(sigma, [0.2, 0.2, 0.5], rtol=1e-3)


def test_rows_of_one_stamp_are_one_scan_of_landmarks_and_one_of_robots(convert):
    rows = [(101, 7, 2, 0.1), (101, 14, 3, 0.2), (101, 16, 2, 0.3), (102, 7, 2, 0.1)]

    converted = convert(Robot1_Measurement=rows, Robot2_Odometry=STRAIGHT['Robot1_Odometry'])

    assert [(s.stamp / 1e9, [o.id for o in s.observations]) for s in of_kind(Scan, converted)] == [
        (101.0, [8, 17]), (102.0, [8])]
    assert [(s.stamp / 1e9, [o.observed for o in s.observations])
            for s in of_kind(RobotScan, converted)] == [(101.0, ['r2'])]


def test_noise_along_the_ray_grows_with_range_and_across_it_with_the_bearing(convert):
    exact = replace(EXACT, noise=Noise(landmarks=CameraNoise(0.05, 0.02)))

    (scan,) = of_kind(Scan, convert(exact, Robot1_Measurement=[(101, 7, 4.0, math.pi / 2)]))

    z, R = polar(4.0, math.pi / 2, sigma_r=0.2, sigma_beta=0.02)
    np.testing.assert_allclose(scan.observations[0].z, z, atol=1e-15)
    np.testing.assert_allclose(scan.observations[0].R, R, atol=1e-15)


def test_the_correlation_factor_multiplies_the_standard_deviations_of_all_observations(convert):
    rows = [(101, 7, 4.0, math.pi / 2), (101, 14, 2.0, 0.0)]
    noise = Noise(
        landmarks=CameraNoise(0.05, 0.02, 0.15), robots=CameraNoise(0.04, 0.01, 0.06))

    doubled = convert(
        replace(EXACT, noise=noise, correlation_factor=2.0), Robot1_Measurement=rows,
        Robot2_Odometry=STRAIGHT['Robot1_Odometry'])

    (scan,), (robots,) = (of_kind(kind, doubled) for kind in (Scan, RobotScan))
    # Twice 0.25 m, of 0.15 m and 0.05 of 4 m, and twice 0.1 m, of 0.06 m and 0.04 of 2 m.
    _, R_landmark = polar(4.0, math.pi / 2, 0.5, 0.04)
    _, R_robot = polar(2.0, 0.0, 0.2, 0.02)
    np.testing.assert_allclose(scan.observations[0].R, R_landmark, atol=1e-15)
    np.testing.assert_allclose(robots.observations[0].R, R_robot, atol=1e-15)


def test_thinning_counts_from_the_observation_that_was_kept(convert):
    rows = [(101 + 0.5 * k, 7, 2, 0.1) for k in range(7)] + [(101.5, 16, 2, 0.1)]

    converted = convert(replace(EXACT, thin=1.2), Robot1_Measurement=rows)

    stamps = [(s.stamp / 1e9, s.observations[0].id) for s in of_kind(Scan, converted)]
    assert stamps == [(101.0, 8), (101.5, 17), (102.5, 8), (104.0, 8)]
    assert converted[1]['observation thinned'] == 4


@pytest.mark.parametrize(('row', 'reason'), [
    ((100.1, 7, 2, 0.1), 'observation before odometry'),
    ((110.3, 7, 2, 0.1), 'observation after odometry'),
    ((105.0, 41, 2, 0.1), 'observation of a robot without odometry'),
    ((105.0, 14, 2, 0.1), 'observation of a robot'),
])
def test_unused_observations_are_counted_by_reason(convert, row, reason):
    options = replace(EXACT, motion_delay=0.2, robot_observations=False)

    converted = convert(
        options, Robot1_Measurement=[row], Robot2_Odometry=STRAIGHT['Robot1_Odometry'])

    assert not of_kind((Scan, RobotScan), converted)
    assert converted[1] == {reason: 1}


def test_errors_of_a_camera_are_removed_from_ranges(convert):
    options = replace(EXACT, range_errors={1: (0.1, -0.02)})

    converted = convert(options, Robot1_Measurement=[
        (105, 7, 0.98 * 2.0 + 0.1, 0.3), (106, 7, 0.09, 0.3)])

    scan, = of_kind(Scan, converted)
    assert np.hypot(*scan.observations[0].z) == pytest.approx(2.0, rel=1e-12)
    assert converted[1]['range below the error of the camera'] == 1


@pytest.mark.parametrize(('code', 'kind'), [(7, Scan), (14, RobotScan)])
def test_ranges_whose_noise_grows_with_them_are_right_in_their_weighted_mean(convert, code, kind):
    # 10 % of noise, by its quantiles; without an increase the mean would be 4 cm too short.
    quantiles = norm.ppf((np.arange(500) + 0.5) / 500)
    noisy = CameraNoise(0.1, 0.01)
    options = replace(
        EXACT, noise=Noise(landmarks=noisy, robots=noisy),
        range_increases=(range_increase(0.1),) * 2)

    scans = of_kind(kind, convert(
        options, Robot2_Odometry=STRAIGHT['Robot1_Odometry'], Robot1_Measurement=[
            (100.0 + 0.02 * k, code, 2.0 * (1.0 + 0.1 * q), 0.0)
            for k, q in enumerate(quantiles)]))

    ranges = [scan.observations[0].z[0] for scan in scans]
    weights = [1.0 / scan.observations[0].R[0, 0] for scan in scans]
    # The next term is of fourth order, 2 m of 10 %^4 by a factor of 10.
    assert np.average(ranges, weights=weights) == pytest.approx(2.0, abs=0.003)


def test_records_come_in_the_order_of_stamps_with_true_poses_within_the_odometry(convert):
    truth = [(99.0 + 0.5 * k, 0.0, 0.0, 0.0) for k in range(30)]

    converted, _ = convert(Robot1_Groundtruth=truth)

    stamps = [record.stamp for record in converted]
    assert stamps == sorted(stamps)
    assert isinstance(converted[0], TrueLandmarks)
    assert [r.stamp / 1e9 for r in converted if isinstance(r, TruePose)] == [
        100 + 0.5 * k for k in range(21)]


def test_an_isolated_true_pose_is_moved_to_the_next_odometry(convert):
    truth = [(100.0, 1, 1, math.pi / 2), (104.6, 1, 1.46, math.pi / 2)]

    true = of_kind(TruePose, convert(Robot1_Groundtruth=truth))

    assert [record.stamp / 1e9 for record in true] == [100, 105]
    # Until then 0.1 m/s are commanded, straight ahead.
    np.testing.assert_allclose(true[1].pose, [1, 1.5, math.pi / 2])


def test_a_true_pose_in_a_gap_of_odometry_or_next_to_others_is_not_moved(convert):
    truth = [(100.3, 1, 1, 0), (105.1, 1, 1, 0), (105.2, 1, 1, 0), (105.3, 1, 1, 0)]

    true = of_kind(TruePose, convert(Robot1_Groundtruth=truth))

    assert [record.stamp / 1e9 for record in true] == [100.3, 105.1, 105.2, 105.3]
