# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise added to a set is estimated back; set 6 has the noise that its README states."""

from collections import Counter
from dataclasses import replace
from itertools import accumulate
import math

import numpy as np
import pytest

from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.camera_errors import clock_offsets
from fej_slam_ros.datasets.mrclam.command_errors import increments
from fej_slam_ros.datasets.mrclam.conversion import observations as observations_used, speeds
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions, Noise
from fej_slam_ros.datasets.mrclam.files import read
from fej_slam_ros.datasets.mrclam.noise import best_options, is_measurable, turn_correlation
from fej_slam_ros.datasets.mrclam.observation_errors import error_statistics, observation_errors
from fej_slam_ros.datasets.series import Series
from helpers.mrclam import LANDMARKS, write_set
from helpers.slow import slow

RATE, SECONDS = 50, 900
DELAY, SCALE = 0.14, (0.9, 0.8)
HEADING, POSITION = 0.002, 0.0005
RANGE, BEARING = 0.02, 0.02
EXACT = ConversionOptions(motion_delay=DELAY, odometry_scale=SCALE)


@pytest.fixture(scope='module')
def synthetic(tmp_path_factory):
    """Return a synthetic set of one robot with the errors above."""
    return synthetic_set(tmp_path_factory.mktemp('set'))


def synthetic_set(
        folder, own_turns=(0.0, 0.0), truth_seconds=0.0, turn_rate=0.5, held=1, speed=0.1,
        heading=(0.0, HEADING), seconds=SECONDS, seed=1, tau=0.0, slowdown=0.0,
        sigmas=(RANGE, BEARING)):
    """Write and read a set whose robot also turns by itself, with few true poses on request."""
    rng = np.random.default_rng(seed)
    stamps = 100.0 + np.arange(RATE * seconds) / RATE
    commands = np.repeat(
        rng.uniform((0.0, -turn_rate), (speed, turn_rate), (seconds // held, 2)), RATE * held, 0)
    steps = commands * SCALE / RATE
    steps[:, 0] -= slowdown * np.minimum(np.abs(commands[:, 1]), 0.41) * commands[:, 0] / RATE
    steps[:, 1] += steps @ own_turns
    noise = rng.normal(size=steps.shape) * np.sqrt(
        np.abs(commands) @ np.transpose([(POSITION, 0.0), heading]) / RATE)
    u = np.insert(steps + noise, 1, 0.0, axis=1)
    poses = np.array(list(accumulate(u, compose, initial=np.zeros(3)))[:-1])
    every = round(truth_seconds * RATE) or 1
    truth = [(f'{t + DELAY:.3f}', *pose) for t, pose in [*zip(stamps, poses)][::every]]
    return read(write_set(folder, {
        'Robot1_Odometry': [(t, *command) for t, command in zip(stamps, commands)],
        'Robot1_Groundtruth': truth,
        'Robot1_Measurement': list(observations(stamps + DELAY, poses, rng, tau, sigmas))}))


def correlation(seconds, tau):
    """Return the correlation of errors with a time constant [s]; 0: independent."""
    return math.exp(-seconds / tau) if tau else 0.0


def observations(stamps, poses, rng, tau, sigmas):
    """Yield observations of landmarks 8, 17 and 18 twice a second; every 100th is an outlier."""
    codes = {8: 7, 17: 16, 18: 9}
    rho, errors = correlation(1.5, tau), {}
    for k in range(50, len(stamps), RATE // 2):
        subject, *point = LANDMARKS[k % 3][:3]
        dx, dy = np.subtract(point, poses[k, :2])
        new = rng.normal(0.0, sigmas)
        e = errors[subject] = rho * errors.get(subject, new) + math.sqrt(1.0 - rho ** 2) * new
        r = math.hypot(dx, dy) * (1 + e[0])
        beta = math.atan2(dy, dx) - poses[k, 2] + e[1]
        wrong = 2.0 if k % (50 * RATE) == 0 else 0.0
        yield f'{stamps[k]:.3f}', codes[subject], r + wrong, math.remainder(beta, math.tau)


def test_delay_and_scale_are_measured(synthetic):
    measured = best_options(synthetic)

    assert measured.motion_delay == pytest.approx(DELAY, abs=0.01)
    # At the mean turn rate, 0.25 rad/s; 3 sigma of 900 s.
    ahead, turning = measured.odometry_scale
    assert (ahead - 0.25 * measured.slowdown, turning) == pytest.approx(SCALE, abs=0.02)


@pytest.mark.parametrize('truth_seconds', [slow(0.0), 10.0])
def test_the_speed_that_is_lost_while_turning_is_measured(tmp_path, truth_seconds):
    data = synthetic_set(tmp_path, truth_seconds=truth_seconds, slowdown=0.9, heading=(0, 0.0005))

    measured = best_options(data, DELAY)

    # With sparse truth turns are taken as 0.947 of the commands instead of 0.8.
    assert measured.slowdown == pytest.approx(0.9, abs=0.2)
    assert measured.odometry_scale[0] == pytest.approx(SCALE[0], abs=0.06)


@pytest.mark.parametrize('seed', [0, slow(1), slow(2)])
def test_the_delay_is_measured_with_the_noise_of_set_6(tmp_path, seed):
    # Variances per metre and per radian of docs/data.md.
    noisy = synthetic_set(tmp_path, heading=(0.0060, 0.0068), held=2, seed=seed)

    # Turn rates change by 0.4 rad/s in 450 places, noise is 0.02 rad in each window of 0.2 s:
    # 0.02 / 0.4 / sqrt(450) is 0.0024 s, and this is four times as much.
    assert best_options(noisy).motion_delay == pytest.approx(DELAY, abs=0.01)


def test_the_scale_of_turns_is_measured_on_robots_that_turn_around(tmp_path):
    # A turn of up to 3.6 rad in each of the windows of 5 s, which headings alone do not show.
    turning = synthetic_set(tmp_path / 'set', turn_rate=0.9, held=10)

    assert best_options(turning).odometry_scale == pytest.approx(SCALE, abs=0.02)


@pytest.mark.parametrize('truth_seconds', [slow(0.0), slow(10.0), 50.0])
def test_turns_that_were_not_commanded_are_measured_also_with_sparse_truth(
        tmp_path, truth_seconds):
    data = synthetic_set(tmp_path, (-0.5, 0.03), truth_seconds)

    measured = best_options(data, DELAY, SCALE).own_turns[1]

    # A heading variance of 0.002 * 0.25 / s * 900 s is a sigma of 0.7 rad over 40 m and 200 rad
    # turned to both sides; three of these, and what the prior of 0.1 rad/m takes away.
    assert measured == pytest.approx((-0.5, 0.03), abs=0.06)


def test_without_true_poses_a_robot_turns_as_commanded(tmp_path):
    data = synthetic_set(tmp_path, truth_seconds=10.0)
    log = data.logs[1]
    unknown = replace(data, logs={1: replace(log, truth=log.truth[:0])})

    assert best_options(unknown).own_turns == {1: (0.0, 0.0)}


def test_given_delay_and_scale_are_kept(synthetic):
    measured = best_options(synthetic, 0.3, (0.7, 0.6))

    assert (measured.motion_delay, measured.odometry_scale) == (0.3, (0.7, 0.6))


def test_the_noise_of_commands_is_measured(synthetic):
    noise = best_options(synthetic).noise

    # At the mean speeds; 180 windows determine a variance to 10 %, on curved paths a little worse.
    assert np.dot(noise.heading, (0.05, 0.25)) == pytest.approx(0.25 * HEADING, rel=0.3)
    assert np.dot(noise.position, (0.05, 0.25)) == pytest.approx(0.05 * POSITION, rel=0.4)


@pytest.mark.parametrize('seed', range(4))
def test_a_short_log_makes_neither_driving_nor_turning_exact(tmp_path, seed):
    data = synthetic_set(tmp_path, speed=0.5, heading=(HEADING, HEADING), seconds=200, seed=seed)

    per_metre, per_radian = best_options(data).noise.heading

    # Either term alone would explain the errors in the ten windows of this log, which determine
    # their sum to 45 %.
    assert per_metre == pytest.approx(HEADING, rel=0.75)
    assert per_radian == pytest.approx(HEADING, rel=0.75)


def test_observation_noise_is_estimated_without_outliers(synthetic):
    landmarks, _ = observation_errors(synthetic)

    measured = error_statistics(landmarks)

    # 1800 observations determine a sigma to 2 %.
    assert measured.relative_range_rms == pytest.approx(RANGE, rel=0.1)
    assert measured.bearing_rms == pytest.approx(BEARING, rel=0.1)
    assert measured.outliers >= 17
    assert measured.correlation[1.0, 2.0] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize('sigmas', [(0.2, 0.02), slow((0.02, 0.4))])
def test_the_noise_of_coarse_sensors_is_measured_without_outliers(tmp_path, sigmas):
    noise = best_options(synthetic_set(tmp_path, sigmas=sigmas, speed=0.5)).noise

    # 1,800 observations determine a sigma to 2 %; five sigma keep nearly all of them.
    assert (noise.landmarks.range, noise.landmarks.bearing) == pytest.approx(sigmas, rel=0.1)


def test_the_angle_of_a_camera_is_measured_and_removed(synthetic):
    log = synthetic.logs[1]
    turned = replace(log.observations, rows=np.add(log.observations.rows, [0.0, 0.0, 0.03]))
    data = replace(synthetic, logs={1: replace(log, observations=turned)})

    options = best_options(data)

    # 1,800 bearings with a standard deviation of 0.02; the prior takes 0.0003.
    offset, sigma = options.bearing_offsets[1]
    assert offset == pytest.approx(0.03, abs=0.0015)
    assert abs(offset - 0.03) < 3.0 * sigma < 0.01
    assert options.noise.landmarks.bearing == pytest.approx(BEARING, rel=0.05)
    used, before = (
        observations_used(data, 1, variant, Counter()).rows[:, 2]
        for variant in (options, replace(options, bearing_offsets={})))
    np.testing.assert_allclose(used, before - offset, rtol=0.0, atol=1e-12)


# Below zero, it is the ground truth that is late.
@pytest.mark.parametrize('late_by', [
    -500_000_000, -300_000_000, -80_000_000, 60_000_000, 300_000_000, 500_000_000])
def test_the_delay_of_a_camera_is_measured_and_removed(synthetic, late_by):
    log = synthetic.logs[1]
    late = replace(log, observations=log.observations.shifted(late_by))

    options = best_options(replace(synthetic, logs={1: late}))

    # 1,800 bearings with a standard deviation of 0.02 at turn rates of 0.23 rad/s: 0.002 s.
    assert options.camera_delay == pytest.approx(late_by / NS, abs=0.006)
    assert options.noise.landmarks.bearing == pytest.approx(BEARING, rel=0.05)
    before, used = (
        observations_used(synthetic, 1, replace(options, camera_delay=delay), Counter()).stamps
        for delay in (0.0, late_by / NS))
    np.testing.assert_array_equal(used[:len(before)], before[:len(used)] - late_by)


@pytest.mark.parametrize(('late_by', 'found'), [
    (0.0, {}), (2.0, {2: 2.0}), (-1.0, {2: -1.0}), (2.9, {2: 2.9})])
def test_a_robot_with_another_clock_than_its_ground_truth_is_found(synthetic, late_by, found):
    log = synthetic.logs[1]
    late = replace(log, robot=2, observations=log.observations.shifted(round(late_by * NS)))

    offsets = clock_offsets(replace(synthetic, logs={1: log, 2: late}), 0.0)

    # In steps of 0.1 s.
    assert offsets == pytest.approx(found, abs=0.05)


def test_the_delay_of_a_camera_at_rest_is_the_default(tmp_path):
    still = synthetic_set(tmp_path, turn_rate=0.0, speed=0.0)

    assert best_options(still, DELAY, SCALE).camera_delay == pytest.approx(
        ConversionOptions().camera_delay, abs=0.002)


@pytest.mark.parametrize(
    ('offset', 'per_metre'), [slow(0.08, 0.0), slow(0.0, -0.03), (0.06, -0.03)])
@pytest.mark.parametrize('truth_seconds', [0.0, 2.0])
def test_systematic_errors_of_ranges_are_measured_and_removed(
        tmp_path, truth_seconds, offset, per_metre):
    data = synthetic_set(tmp_path, truth_seconds=truth_seconds)
    log = data.logs[1]
    rows = log.observations.rows * [1.0, 1.0 + per_metre, 1.0] + [0.0, offset, 0.0]
    wrong = replace(log, observations=replace(log.observations, rows=rows))
    data = replace(data, logs={1: wrong})

    options = best_options(data, DELAY, SCALE, camera_delay=0.0)

    used = observations_used(data, 1, replace(options, thin=0.0), Counter())
    right = log.observations[np.isin(log.observations.stamps, used.stamps)].rows[:, 1]
    # Ranges of 1 to 6 m, wrong by up to 8 %: 450 or more errors of 0.02 determine them to 0.002.
    assert np.abs(used.rows[:, 1] / right - 1.0).max() < 0.01
    assert options.noise.landmarks.range == pytest.approx(RANGE, rel=0.15)


def test_with_sparse_true_poses_the_angle_of_a_camera_and_the_noise_are_measured(tmp_path):
    sparse = synthetic_set(tmp_path / 'set', truth_seconds=4.0)
    log = sparse.logs[1]
    turned = replace(log.observations, rows=np.add(log.observations.rows, [0.0, 0.0, 0.03]))

    options = best_options(
        replace(sparse, logs={1: replace(log, observations=turned)}), DELAY, SCALE, 0.0)

    # One bearing with a standard deviation of 0.02 in each of 225 quarters of a second.
    offset, sigma = options.bearing_offsets[1]
    assert offset == pytest.approx(0.03, abs=0.006)
    assert abs(offset - 0.03) < 3.0 * sigma < 0.02
    assert (options.noise.landmarks.range, options.noise.landmarks.bearing) == pytest.approx(
        (RANGE, BEARING), rel=0.15)
    # The defaults are of odometry that turns away three times as fast; errors of position, which
    # noise of the same kind in two directions makes, count as well.
    factor = options.noise.heading[1] / Noise().heading[1]
    assert factor == pytest.approx(HEADING / Noise().heading[1], rel=0.5)
    assert options.noise.position == pytest.approx(
        [factor * variance for variance in Noise().position])


@pytest.mark.parametrize('tau', [slow(0.0), 6.0])
def test_the_factor_for_errors_that_persist_is_measured(tmp_path, tau):
    data = synthetic_set(tmp_path, tau=tau)

    # A landmark is observed every 1.5 s, four times in a window of 5 s.
    rho = correlation(1.5, tau)
    expected = math.sqrt((4 + 2 * (3 * rho + 2 * rho ** 2 + rho ** 3)) / 4)
    # 450 windows of two errors, of which those of 6 s or more are independent: 2 to 5 %.
    assert best_options(data).correlation_factor == pytest.approx(expected, rel=0.1)


def test_with_few_observations_the_factor_is_the_default(synthetic):
    log = synthetic.logs[1]
    few = replace(synthetic, logs={1: replace(log, observations=log.observations[:20])})

    assert best_options(few).correlation_factor == ConversionOptions().correlation_factor


def test_exact_observations_have_the_resolution_of_the_files(tmp_path):
    still = [(100 + 0.02 * k, 0, 0) for k in range(3000)]
    noise = best_options(read(write_set(tmp_path, {
        'Robot1_Odometry': still, 'Robot1_Groundtruth': [(t, 0, 0, 0) for t, *_ in still],
        'Robot1_Measurement': [
            (101 + 0.2 * k, 7, math.sqrt(5), math.atan2(1, 2)) for k in range(250)]}))).noise

    # A millimetre and a milliradian.
    assert (noise.landmarks.range, noise.landmarks.bearing) == (0.001, 0.001)


def test_only_outliers_leave_the_default_noise(synthetic):
    elsewhere = {subject: point + 100.0 for subject, point in synthetic.landmarks.items()}

    noise = best_options(replace(synthetic, landmarks=elsewhere)).noise

    assert (noise.landmarks.range, noise.landmarks.bearing) == (
        Noise().landmarks.range, Noise().landmarks.bearing)


def test_windows_with_a_long_gap_of_commands_are_ignored(synthetic):
    log = synthetic.logs[1]
    # Three seconds inside of one window.
    kept = np.abs(log.commands.stamps - 202_500_000_000) > 1_500_000_000
    gappy = replace(synthetic, logs={1: replace(log, commands=log.commands[kept])})

    windows, fewer = (len(increments(data, EXACT, 5.0).true) for data in (synthetic, gappy))

    assert fewer == windows - 1


def test_without_observations_of_robots_their_noise_is_the_default(synthetic):
    assert best_options(synthetic).noise.robots.range == ConversionOptions().noise.robots.range


def test_ranges_are_increased_where_their_noise_was_measured(synthetic):
    options = best_options(synthetic)

    # The derivative of p^2 r^2 by r, per metre; robots are not observed here.
    assert options.range_increases == (2 * options.noise.landmarks.range ** 2, 0.0)


def test_noise_is_not_measurable_without_motion_capture(tmp_path):
    folder = write_set(tmp_path, {'Robot1_Odometry': [(1, 0, 0), (2, 0, 0)]})

    assert not is_measurable(read(folder))


def test_noise_is_not_measurable_with_motion_capture_of_another_time(synthetic):
    log = synthetic.logs[1]
    late = Series(log.truth.stamps + 1_000_000_000_000, log.truth.rows)

    assert is_measurable(synthetic)
    assert not is_measurable(replace(synthetic, logs={1: replace(log, truth=late)}))


# The tests below need the published data.

@pytest.fixture(scope='module')
def set_6(data):
    return read(data / 'mrclam_6')


@pytest.mark.slow
def test_observations_of_set_6_have_the_noise_in_its_readme(set_6):
    landmarks, robots = map(error_statistics, observation_errors(set_6))

    # Within the last digit of the README; true poses at jumps are dropped here.
    assert landmarks.range_sd == pytest.approx(0.173, abs=1e-3)
    assert landmarks.range_mean == pytest.approx(-0.036, abs=1e-3)
    assert landmarks.bearing_sd == pytest.approx(0.0124, abs=2e-4)
    assert landmarks.bearing_mean == pytest.approx(-0.0020, abs=1e-4)
    assert robots.range_sd == pytest.approx(0.117, abs=1e-3)
    assert robots.range_mean == pytest.approx(0.010, abs=1e-3)
    assert robots.bearing_sd == pytest.approx(0.0110, abs=2e-4)
    assert robots.bearing_mean == pytest.approx(-0.0021, abs=1e-4)
    gross = (landmarks.outliers + robots.outliers) / (landmarks.count + robots.count)
    assert gross == pytest.approx(0.0016, abs=5e-5)


@pytest.mark.slow
def test_commands_of_set_6_have_the_delay_and_scale_in_its_readme(set_6):
    measured = best_options(set_6)

    assert 0.16 <= measured.motion_delay <= 0.20
    # Of 0.067 m/s straight ahead 0.067 to 0.069, of 0.086 at 0.4 rad/s 0.05: means of windows
    # in which commands were constant.
    straight, turning = speeds(np.array([(0.067, 0.0), (0.086, 0.4)]), measured)
    assert straight[0] == pytest.approx(0.068, rel=0.05)
    assert turning[0] == pytest.approx(0.050, rel=0.05)
    assert 0.92 <= measured.odometry_scale[1] <= 0.98


@pytest.mark.slow
@pytest.mark.parametrize(('window', 'v', 'w'), [
    (0.2, 0.014, (0.046, 0.064)), (1.0, 0.011, (0.023, 0.031))])
def test_speeds_of_set_6_have_the_errors_in_its_readme(set_6, window, v, w):
    errors = increments(set_6, best_options(set_6, odometry_scale=(1.0, 1.0)), window).errors()

    # The windows of the README begin at other times.
    assert errors[:, 0].std() / window == pytest.approx(v, abs=1e-3)
    assert w[0] <= errors[:, 2].std() / window <= w[1]


@pytest.mark.parametrize(('own_turns', 'expected'), [((0.0, 0.0), 1.0), ((10.0, 0.0), 0.0)])
def test_turns_of_a_robot_that_is_told_to_drive_straight_agree_unless_it_turns(
        tmp_path, own_turns, expected):
    data = synthetic_set(tmp_path, own_turns, turn_rate=0.0, held=10, seconds=200)

    assert turn_correlation(data, ConversionOptions()) == expected
