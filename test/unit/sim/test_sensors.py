# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors: order, range, noise and its covariance."""

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.geometry import between, compose, transform
from fej_slam_ros.core.records import fingerprint, NO_ID, Odometry, Scan, TrueLandmarks, TruePose
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, World, WorldSettings

NOISY = SensorSettings((0.3, 0.2, 0.05), (0.5, 0.4))
EXACT = SensorSettings((0.0, 0.0, 0.0), (0.0, 0.0))


def world(robots=('r1', 'r2'), **changes):
    settings = WorldSettings('circles', (164.45, 145.33), 63, robots, **{'loops': 1, **changes})
    return make_world(settings, np.random.default_rng(5))


def records(a_world, settings, kind, robot='r2', seed=11):
    """Return what one robot gives of one kind of records."""
    found = measure(a_world, settings, np.random.default_rng(seed))
    return [record for record in found if isinstance(record, kind) and record.robot == robot]


def normalized_odometry_noise(a_world, settings, robot='r2'):
    """Return the (K, 3) errors of the increments in units of their sigmas."""
    poses = [o.pose for o in records(a_world, settings, Odometry, robot)]
    true = a_world.true_poses[robot]
    errors = [
        between(poses[k], poses[k + 1]) - between(true[k], true[k + 1])
        for k in range(len(true) - 1)
    ]
    wrapped = np.remainder(np.array(errors) + math.pi, 2.0 * math.pi) - math.pi
    return wrapped / settings.odometry_sigma


def normalized_observation_noise(a_world, settings):
    """Return the (m, 2) errors of the observations in units of their sigmas."""
    errors = [
        s.z - between(pose, np.append(a_world.landmarks[s.id], 0.0))[:2]
        for scan, pose in zip(records(a_world, settings, Scan), a_world.true_poses['r2'])
        for s in scan.observations
    ]
    return np.array(errors) / settings.landmark_sigma


def assert_standard_normal(samples):
    """Check each column's sum of squares against its chi-square band of 99.99 %."""
    low, high = chi2.ppf([0.5e-4, 1.0 - 0.5e-4], len(samples))
    squares = np.sum(samples**2, axis=0)
    assert np.all((low < squares) & (squares < high))


def test_records_come_in_the_order_of_stamps_after_the_landmarks():
    a_world = world()
    first, *rest = measure(a_world, NOISY, np.random.default_rng(1))
    assert isinstance(first, TrueLandmarks)
    assert first.positions == a_world.landmarks
    assert [r.stamp for r in rest] == [stamp for stamp in a_world.stamps for _ in range(2 * 3)]


@pytest.mark.parametrize('kind', [Odometry, Scan, TruePose])
@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_every_robot_gives_every_record_at_every_stamp(kind, robot):
    a_world = world()
    assert tuple(r.stamp for r in records(a_world, NOISY, kind, robot)) == a_world.stamps


def test_true_poses_are_those_of_the_world():
    a_world = world()
    poses = [record.pose for record in records(a_world, NOISY, TruePose)]
    np.testing.assert_array_equal(poses, a_world.true_poses['r2'])


def test_odometry_starts_at_its_own_origin():
    np.testing.assert_array_equal(records(world(), NOISY, Odometry)[0].pose, np.zeros(3))


def test_odometry_without_noise_composes_to_the_true_trajectory():
    a_world = world()
    true = a_world.true_poses['r2']
    driven = [compose(true[0], o.pose) for o in records(a_world, EXACT, Odometry)]
    errors = np.array([between(a, b) for a, b in zip(true, driven)])
    np.testing.assert_allclose(errors, 0.0, atol=1e-10)  # rounding of 63 compositions


def test_observations_without_noise_map_back_to_the_landmarks():
    a_world = world()
    for scan, pose in zip(records(a_world, EXACT, Scan), a_world.true_poses['r2']):
        for s in scan.observations:
            np.testing.assert_allclose(transform(pose, s.z), a_world.landmarks[s.id], atol=1e-12)


def test_range_limits_the_true_distance():
    a_world = world()
    scans = records(a_world, replace(NOISY, range=9.0), Scan)
    for scan, pose in zip(scans, a_world.true_poses['r2']):
        near = [number for number, f in a_world.landmarks.items() if math.dist(f, pose[:2]) <= 9.0]
        assert [s.id for s in scan.observations] == near


@pytest.mark.parametrize(
    ('degrees', 'seen'),
    [(90.0, [1, 2, 3]), (180.0, [1, 2, 3, 4, 5]), (360.0, [1, 2, 3, 4, 5, 6])]
)
def test_field_of_view_is_centred_ahead(degrees, seen):
    bearings = np.radians([0.0, 44.0, -44.0, 46.0, -46.0, 180.0])
    pose = np.array([1.0, 2.0, math.radians(90.0)])
    landmarks = pose[:2] + 5.0 * np.column_stack([-np.sin(bearings), np.cos(bearings)])
    a_world = World(('r1',), (0,), {'r1': pose[None]}, dict(enumerate(landmarks, start=1)))
    narrow = replace(EXACT, field_of_view=math.radians(degrees))
    (scan,) = records(a_world, narrow, Scan, 'r1')
    assert [s.id for s in scan.observations] == seen


def test_a_scan_without_landmarks_in_view_is_empty():
    scans = records(world(), replace(NOISY, range=0.01), Scan)
    assert [scan.observations for scan in scans] == [()] * 64


def test_odometry_noise_has_its_sigma():
    assert_standard_normal(normalized_odometry_noise(world(loops=20), NOISY))


def test_observation_noise_has_its_sigma():
    assert_standard_normal(normalized_observation_noise(world(loops=5), NOISY))


def test_messages_carry_the_covariance_of_the_noise():
    a_world = world(rate=4.0)
    first, *later = records(a_world, NOISY, Odometry)
    assert first.twist_covariance is None
    for odometry in later:
        Q = 0.25**2 * odometry.twist_covariance
        np.testing.assert_allclose(Q, np.diag([0.09, 0.04, 0.0025]), rtol=1e-12)  # rounding
    for scan in records(a_world, NOISY, Scan):
        for s in scan.observations:
            np.testing.assert_allclose(s.R, np.diag([0.25, 0.16]), rtol=1e-12)  # rounding


def test_the_same_seed_gives_the_same_bits():
    a_world = world()
    for kind in (Odometry, Scan):
        once, again = (records(a_world, NOISY, kind, seed=3) for _ in range(2))
        assert [fingerprint(r) for r in once] == [fingerprint(r) for r in again]


def test_another_seed_gives_other_noise():
    a_world = world()
    once, other = (records(a_world, NOISY, Odometry, seed=seed) for seed in (3, 4))
    assert all(np.all(a.pose != b.pose) for a, b in zip(once[1:], other[1:]))


def test_robots_and_sensors_have_independent_noise():
    a_world = world(loops=20)
    own = normalized_odometry_noise(a_world, NOISY)[:, 0]
    others = normalized_odometry_noise(a_world, NOISY, 'r1')[:, 0]
    observations = normalized_observation_noise(a_world, NOISY)[:len(own), 0]
    # The correlation of n independent pairs has a standard deviation of 1 / sqrt(n).
    correlations = np.corrcoef([own, others, observations])[np.triu_indices(3, 1)]
    np.testing.assert_allclose(correlations, 0.0, atol=4.0 / math.sqrt(len(own)))


def test_another_robot_does_not_change_the_noise_of_the_others():
    two = world()
    three = World((*two.robots, 'r3'), two.stamps, {**two.true_poses, 'r3': two.true_poses['r1']},
                  two.landmarks)
    for kind in (Odometry, Scan):
        before, after = records(two, NOISY, kind), records(three, NOISY, kind)
        assert [fingerprint(r) for r in before] == [fingerprint(r) for r in after]


def test_the_sensor_range_does_not_change_the_noise_of_odometry():
    a_world = world()
    far, near = (records(a_world, replace(NOISY, range=r), Odometry) for r in (15.0, 5.0))
    assert [fingerprint(r) for r in far] == [fingerprint(r) for r in near]


DETECTOR = replace(NOISY, clutter=0.3, missed=0.1, identities=False)


def test_missed_detections_and_clutter_have_the_stated_rates():
    a_world = world(loops=20)
    whole = sum(len(scan.observations) for scan in records(a_world, NOISY, Scan))
    detected = [
        s.id for scan in records(a_world, replace(DETECTOR, identities=True), Scan)
        for s in scan.observations]
    clutter = detected.count(NO_ID)
    # Within four standard deviations of a binomial, and of a Poisson number, of so many.
    spread = 4.0 / math.sqrt(whole)
    assert (len(detected) - clutter) / whole == pytest.approx(0.9, abs=0.3 * spread)
    assert clutter / len(detected) == pytest.approx(0.3, abs=spread)


def test_without_identities_no_observation_has_an_id():
    found = [s for scan in records(world(), DETECTOR, Scan) for s in scan.observations]
    assert {s.id for s in found} == {NO_ID}


def test_clutter_is_uniform_over_the_area_in_view():
    settings = replace(DETECTOR, identities=True, range=10.0, field_of_view=2.0)
    clutter = np.array([
        s.z for scan in records(world(loops=20), settings, Scan)
        for s in scan.observations if s.id == NO_ID])
    assert (np.hypot(*clutter.T) <= 10.0).all()
    assert (np.abs(np.arctan2(*clutter.T[::-1])) <= 1.0).all()
    # Half of the ground in view is nearer than this; 4 standard deviations.
    assert np.mean(np.hypot(*clutter.T) < 10.0 / math.sqrt(2.0)) == pytest.approx(
        0.5, abs=2.0 / math.sqrt(len(clutter)))


def test_the_detector_does_not_change_the_noise_of_detected_landmarks():
    a_world = world()
    whole = {s.z.tobytes() for scan in records(a_world, NOISY, Scan) for s in scan.observations}
    detected = {
        s.z.tobytes() for scan in records(a_world, replace(DETECTOR, clutter=0.0), Scan)
        for s in scan.observations}
    assert detected < whole
    before, after = (records(a_world, settings, Odometry) for settings in (NOISY, DETECTOR))
    assert [fingerprint(r) for r in before] == [fingerprint(r) for r in after]
