# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A wrong pose, handedness or time of a sensor is found from what it sees while it moves."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fej_slam_ros.core.calibration.sensor_pose import fit_sensor
from fej_slam_ros.core.geometry import between, compose, inverse, poses_at, transform
from fej_slam_ros.core.records import NO_ID, NS, Observation, Odometry, Scan

SIGMA = 0.03
DT = 0.02


def drive(seconds, circle=False):
    """Return stamps and true poses of a robot whose speed and turn rate vary, or do not."""
    poses = [np.zeros(3)]
    for t in np.arange(0.0, seconds, DT):
        v = 0.5 if circle else 0.5 + 0.4 * np.sin(0.9 * t)
        w = 0.1 if circle else 0.6 * np.sin(0.5 * t)
        poses.append(compose(poses[-1], np.array([v * DT, 0.0, w * DT])))
    return (np.arange(len(poses)) * DT * NS).astype(np.int64), np.array(poses)


def data(
        pose=(0.0, 0.0, 0.0), late=0.0, mirrored=False, ids=True, circle=False, seconds=60.0,
        noise=(5e-4, 1e-4, 2e-4)):
    """Return odometry and scans of a sensor with an unknown pose, whose stamps are late [s]."""
    rng = np.random.default_rng(0)
    stamps, poses = drive(seconds, circle)
    # Around the places after each minute.
    minutes = np.repeat(np.arange(round(seconds / 60.0)), 25)
    landmarks = poses[minutes * round(60.0 / DT), :2] + rng.uniform(-8.0, 8.0, (len(minutes), 2))
    odometry, integrated = [Odometry('r', 0, np.zeros(3), None)], np.zeros(3)
    for k in range(1, len(stamps)):
        measured = between(poses[k - 1], poses[k]) + rng.normal(0.0, noise)
        integrated = compose(integrated, measured)
        odometry.append(Odometry('r', int(stamps[k]), integrated, None))
    scans = []
    for t in np.arange(1.0, seconds - 2.0, 0.1):
        at, = poses_at(np.array([round(t * NS)]), stamps, poses)
        z = transform(inverse(compose(at, np.array(pose))), landmarks)
        near = np.flatnonzero(np.hypot(*z.T) < 6.0)
        z = (z[near] + rng.normal(0.0, SIGMA, (len(near), 2))) * [1.0, -1.0 if mirrored else 1.0]
        scans.append(Scan('r', round((t + late) * NS), tuple(
            Observation(int(i) if ids else NO_ID, point, SIGMA**2 * np.eye(2))
            for i, point in zip(near, z))))
    return odometry, scans


@pytest.mark.parametrize('ids', [True, False])
def test_a_sensor_that_is_where_it_should_be_agrees(ids):
    fit = fit_sensor(*data(ids=ids))

    # The noise of odometry is below the one that is assumed.
    assert fit.as_given == pytest.approx(0.92, abs=0.05)
    assert min(fit.moved, fit.delayed) > 0.95 * fit.as_given
    assert fit.mirrored > 10.0


@pytest.mark.parametrize('ids', [True, False])
@pytest.mark.parametrize('pose', [(0.0, 0.0, 0.2), (0.3, 0.0, 0.0), (0.0, 0.2, -1.6), (0.1, 0, 3)])
def test_the_pose_of_a_sensor_is_found(pose, ids):
    fit = fit_sensor(*data(pose=pose, ids=ids))

    assert fit.moved == pytest.approx(0.92, abs=0.05)
    assert min(fit.as_given, fit.delayed, fit.mirrored) > 1.8
    # 2,000 pairs of 3 cm, at turns of up to 0.6 rad between the observations.
    np.testing.assert_allclose(fit.pose, pose, atol=0.02)


def test_observations_in_map_agree_without_motion():
    odometry, scans = data()
    at = poses_at(np.array([scan.stamp for scan in scans]), *drive(60.0))

    fit = fit_sensor(
        odometry, [moved(scan, partial(transform, pose)) for scan, pose in zip(scans, at)])

    assert fit.still == pytest.approx(0.92, abs=0.05)
    assert min(fit.as_given, fit.moved, fit.mirrored) > 5.0


def test_bearings_in_degrees_disagree_while_ranges_agree():
    def in_degrees(z):
        bearing = np.degrees(np.arctan2(z[1], z[0]))
        return np.hypot(*z) * np.array([np.cos(bearing), np.sin(bearing)])

    odometry, scans = data()

    assert not fit_sensor(odometry, scans).bearings_differ
    assert fit_sensor(odometry, [moved(scan, in_degrees) for scan in scans]).bearings_differ


def moved(scan, change):
    return replace(scan, observations=tuple(
        replace(seen, z=change(seen.z)) for seen in scan.observations))


@pytest.mark.parametrize('late', [0.1, -0.15])
def test_the_delay_of_stamps_is_found(late):
    fit = fit_sensor(*data(late=late))

    assert fit.delay == pytest.approx(late, abs=0.01)
    assert fit.delayed < 0.5 * min(fit.as_given, fit.moved)


@pytest.mark.slow
@pytest.mark.parametrize('late', [0.0, 0.2, -0.2])
def test_the_gain_by_a_delay_tells_it_from_the_noise_of_coarse_odometry(late):
    # 0.07 m and 0.04 rad in a second: most of the disagreement remains.
    fit = fit_sensor(*data(late=late, seconds=600.0, noise=(1e-2, 1e-2, 6e-3)))

    assert fit.delayed > 0.6 * fit.as_given
    # Without a delay, the gain is that of the best of all delays.
    assert (fit.delay_sigmas > 4.0) == (late != 0.0)
    # Four standard deviations of six such runs.
    assert fit.delay == pytest.approx(late, abs=0.08)


@pytest.mark.slow
def test_a_robot_that_stands_still_shows_no_delay():
    _, scans = data(seconds=300.0)
    still = [Odometry('r', t * NS // 10, np.zeros(3), None) for t in range(3000)]

    with np.errstate(all='raise'):
        assert fit_sensor(still, scans).delay_sigmas == 0.0


def test_a_robot_that_repeats_one_scan_at_rest_agrees():
    scan = data()[1][0]
    still = [Odometry('r', t * NS // 10, np.zeros(3), None) for t in range(3000)]

    with np.errstate(all='raise'):
        fit = fit_sensor(still, [replace(scan, stamp=t * NS // 10) for t in range(3000)])

    assert (fit.as_given, fit.delay_sigmas) == (0.0, 0.0)


def test_a_short_run_says_nothing_about_the_gain_by_a_delay():
    fit = fit_sensor(*data(late=0.2, noise=(1e-2, 1e-2, 6e-3)))

    assert fit.delay_sigmas == 0.0


@pytest.mark.parametrize('ids', [True, False])
def test_a_left_handed_frame_is_found(ids):
    fit = fit_sensor(*data(mirrored=True, ids=ids))

    assert fit.mirrored == pytest.approx(0.92, abs=0.05)
    assert min(fit.as_given, fit.moved, fit.delayed) > 10.0


def test_a_motion_that_does_not_determine_the_pose_is_known():
    # On a circle, turns about its centre change nothing.
    assert not fit_sensor(*data(circle=True)).is_determined
    assert fit_sensor(*data()).is_determined


def test_too_few_observations_give_no_pose():
    assert fit_sensor(*data(seconds=3.5)) is None
    assert fit_sensor([], data()[1]) is None
