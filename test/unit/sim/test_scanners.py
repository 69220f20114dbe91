# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of landmarks and robots by range-bearing scanners."""

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.geometry import transform
from fej_slam_ros.core.records import (
    fingerprint, Odometry, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
from fej_slam_ros.sim.rendezvous_world import make_rendezvous_world
from fej_slam_ros.sim.scanners import measure, observe, ScannerSettings

every_environment = pytest.mark.parametrize('name', RENDEZVOUS_ENVIRONMENTS)
WIDE = ScannerSettings(field_of_view=2.0 * math.pi, polar_sigma=(0.01, 0.012), range=4.0)


def run(name, seed=1):
    """Return the truth of a run and its records."""
    environment = RENDEZVOUS_ENVIRONMENTS[name]
    return (
        environment.true_world(np.random.default_rng(seed)),
        [*environment.records(np.random.default_rng(seed))])


def of_kind(records, kind):
    return [record for record in records if isinstance(record, kind)]


def in_frame_of(pose, points, **changes):
    """Return the index of all that is seen, and where."""
    seen = observe(pose, points, replace(WIDE, **changes), np.random.default_rng(3))
    return {index: z for index, z, _ in seen}


@every_environment
def test_records_come_in_the_order_of_stamps_without_true_landmarks(name):
    world, records = run(name)

    assert not of_kind(records, TrueLandmarks)
    assert [record.stamp for record in records] == sorted(record.stamp for record in records)
    for kind in (Odometry, Scan, TruePose):
        for robot in world.robots:
            stamps = [r.stamp for r in of_kind(records, kind) if r.robot == robot]
            assert tuple(stamps) == world.stamps


@pytest.mark.parametrize(('name', 'observers', 'steps'), [
    ('map_joining', {'p': 'q', 'q': 'p'}, range(44, 53)),
    ('sensor_extension', {'p': 'q'}, range(101))])
def test_robots_observe_each_other_in_their_windows_only(name, observers, steps):
    world, records = run(name)

    for robot in world.robots:
        met = [record for record in of_kind(records, RobotScan) if record.robot == robot]
        assert [m.stamp for m in met] == [world.stamps[k] for k in steps if robot in observers]
        assert {s.observed for m in met for s in m.observations} == {*observers.get(robot, ())}
        assert all(len(m.observations) == 1 for m in met)


@every_environment
def test_observations_have_the_robots_own_landmark_ids_in_order(name):
    world, records = run(name)

    for scan in of_kind(records, Scan):
        pose = world.true_poses[scan.robot][world.stamps.index(scan.stamp)]
        ids = [s.id for s in scan.observations]
        assert ids == sorted(ids)
        for s in scan.observations:
            true = world.landmarks[world.landmark_of[scan.robot][s.id]]
            # Landmarks are 0.35 m apart; the bearing of a far one has a sigma of 0.05 m.
            assert math.dist(transform(pose, s.z), true) < 0.3


@every_environment
def test_observations_are_within_range_and_field_of_view(name):
    _, records = run(name)
    half = RENDEZVOUS_ENVIRONMENTS[name].sensors.field_of_view / 2.0

    for record in of_kind(records, (Scan, RobotScan)):
        for s in record.observations:
            # Seven sigmas of range and bearing beyond the limits of the true ones.
            assert math.hypot(*s.z) <= 4.0 + 0.07
            assert abs(math.atan2(*s.z[::-1])) <= half + 0.084


@pytest.mark.parametrize(
    ('degrees', 'seen'),
    [(90.0, [0, 1, 2]), (180.0, [0, 1, 2, 3, 4]), (360.0, [0, 1, 2, 3, 4, 5])])
def test_field_of_view_is_centred_ahead(degrees, seen):
    bearings = np.radians([0.0, 44.0, -44.0, 46.0, -46.0, 180.0])
    points = [1.0, 2.0] + 3.0 * np.column_stack([-np.sin(bearings), np.cos(bearings)])

    found = in_frame_of(
        np.array([1.0, 2.0, math.pi / 2.0]), points, field_of_view=math.radians(degrees))

    assert [*found] == seen


def test_range_limits_the_true_distance():
    points = np.array([[3.99, 0.0], [4.01, 0.0], [0.0, -3.99], [0.0, 4.01]])

    assert [*in_frame_of(np.zeros(3), points)] == [0, 2]


def test_no_range_is_negative():
    points, rng = np.full((1000, 2), 0.5), np.random.default_rng(3)

    seen = [*observe(np.zeros(3), points, replace(WIDE, polar_sigma=(1.0, 0.01)), rng)]

    # A range of 0.7 m and a sigma of 1 m: a quarter would be behind the sensor, and is not seen.
    assert 700 < len(seen) < 820
    assert all(z @ [1.0, 1.0] > 0.0 for _, z, _ in seen)


def test_observations_with_negligible_noise_are_the_true_positions():
    pose, points = np.array([1.0, -2.0, 0.7]), np.array([[2.0, 0.0], [3.0, -3.0]])

    found = in_frame_of(pose, points, polar_sigma=(1e-12, 1e-12))

    np.testing.assert_allclose(transform(pose, np.array([*found.values()])), points, atol=1e-10)


def test_observation_errors_match_their_covariance():
    pose, point = np.array([1.0, -2.0, 0.7]), np.array([2.0, 1.0])
    rng = np.random.default_rng(5)
    squares = [
        (transform(pose, z) - point) @ np.linalg.solve(_turned(R, 0.7), transform(pose, z) - point)
        for _ in range(2000) for _, z, R in observe(pose, point[None], WIDE, rng)]

    # The 99.99 % band of chi-square; the bend of the bearing adds sigma_beta^2, 1.4e-4 of it.
    low, high = chi2.ppf([0.5e-4, 1.0 - 0.5e-4], 2 * 2000)
    assert low < np.sum(squares) < high


def _turned(R, phi):
    C = np.array([[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]])
    return C @ R @ C.T


@every_environment
def test_observation_windows_do_not_change_other_noise(name):
    environment = RENDEZVOUS_ENVIRONMENTS[name]
    alone = replace(environment.world, windows=())
    runs = [
        [*measure(
            make_rendezvous_world(settings, np.random.default_rng(1)), settings,
            environment.sensors, np.random.default_rng(2))]
        for settings in (environment.world, alone)]

    for kind in (Odometry, Scan):
        watched, unwatched = ([fingerprint(r) for r in of_kind(records, kind)] for records in runs)
        assert watched == unwatched
    assert not of_kind(runs[1], RobotScan)


def test_the_same_seed_gives_the_same_bits_and_another_does_not():
    (_, one), (_, again), (_, other) = (run('map_joining', seed) for seed in (3, 3, 4))

    prints = [[fingerprint(r) for r in of_kind(records, Scan)] for records in (one, again, other)]
    assert prints[0] == prints[1] != prints[2]
