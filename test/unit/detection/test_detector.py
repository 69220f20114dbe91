# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A detector corrects scans for motion and processes each when its odometry is complete."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.geometry import inverse, poses_at, transform
from fej_slam_ros.core.records import NS, Odometry
from fej_slam_ros.detection.detector import Detector, StampedScan
from fej_slam_ros.detection.posts import PostDetector
from fej_slam_ros.sim.lidar import true_ranges
from helpers.lasers import NO_WALLS, scan_of

POSTS = np.array([[3.0, 1.0, 0.2], [-2.0, 2.0, 0.15], [0.0, -3.0, 0.25]])
BEAMS = 1440
#: Speed [m/s], turn rate [rad/s] and duration of a scan [s].
SPEED, RATE, DURATION = 1.0, 1.5, 0.1


def detector(**changes):
    return Detector(
        PostDetector(range_sigma=0.005), **{'min_beams': 5, 'static_time': 0.0, **changes})


def driven(stamp):
    """Return the pose of a robot that drives on a circle."""
    phi = RATE * stamp / NS
    return np.array([np.sin(phi), 1.0 - np.cos(phi), phi]) * [SPEED / RATE, SPEED / RATE, 1.0]


def test_landmarks_are_those_seen_from_the_pose_at_the_end_of_the_scan():
    stamps = np.arange(0, NS, NS // 50)
    poses = np.array([driven(stamp) for stamp in stamps])
    step = DURATION / (BEAMS - 1)
    begin = NS // 2
    times = begin + np.round(np.arange(BEAMS) * step * NS).astype(np.int64)
    still = scan_of([], beams=BEAMS)
    angles = still.angle_min + still.angle_increment * np.arange(BEAMS)
    ranges = true_ranges(poses_at(times, stamps, poses), angles, POSTS, NO_WALLS)
    scan = StampedScan(begin, replace(still, ranges=ranges, time_increment=step), np.zeros(3))
    stream = detector()
    for stamp, pose in zip(stamps, poses):
        stream.add_odometry(Odometry('r1', int(stamp), pose, None))

    stream.add_scan(scan)
    (_, found), = stream.take()

    expected = transform(inverse(driven(scan.end)), POSTS[:, :2])
    distances = np.hypot(*(found.points[:, None] - expected).transpose(2, 0, 1))
    # During the scan the robot moves by 0.1 m and turns by 0.15 rad, 0.5 m at the posts.
    assert sorted(distances.min(axis=1)) == pytest.approx([0.0, 0.0, 0.0], abs=0.015)


def test_a_scan_waits_until_odometry_has_passed_its_end():
    stream = detector()
    stream.add_odometry(Odometry('r1', 0, np.zeros(3), None))
    stream.add_scan(StampedScan(NS // 10, scan_of(POSTS, sigma=0.005), np.zeros(3)))

    assert not [*stream.take()]
    stream.add_odometry(Odometry('r1', NS // 5, np.zeros(3), None))
    (_, found), = stream.take()
    assert (len(found.points), stream.without_odometry) == (3, 0)


def test_a_scan_that_gets_no_odometry_is_used_after_a_second():
    stream = detector(static_time=0.8)
    scan = scan_of(POSTS, sigma=0.005)
    for k in range(12):
        stream.add_scan(StampedScan(k * NS // 10, scan, np.zeros(3)))

    assert [(scan.stamp, len(found.points)) for scan, found in stream.take()] == [(0, 3)]
    assert (stream.scans, stream.without_odometry) == (1, 1)
    assert len([*stream.close()]) == 11


def test_a_scan_that_is_not_newer_is_refused():
    stream, scan = detector(), StampedScan(5, scan_of(POSTS), np.zeros(3))

    assert (stream.add_scan(scan), stream.add_scan(scan)) == (True, False)


def test_odometry_that_is_not_newer_is_counted():
    stream = detector()
    for stamp in (0, NS, NS // 2, NS):
        stream.add_odometry(Odometry('r1', stamp, np.zeros(3), None))

    assert stream.late_odometry == 2


def test_uncertain_odometry_during_the_scan_makes_its_first_landmarks_uncertain():
    scan = replace(scan_of(POSTS, beams=BEAMS), time_increment=DURATION / BEAMS)
    found = []
    for variance in (0.0, 1.0):
        stream = detector()
        for k in range(4):
            stream.add_odometry(Odometry('r1', k * NS // 20, np.zeros(3), variance * np.eye(3)))
        stream.add_scan(StampedScan(0, scan, np.zeros(3)))
        found.append(next(stream.take())[1])

    sure, unsure = found
    # A variance of 1 m^2/s^2 of two increments of 0.05 s, of which the last beam has none.
    added = (unsure.R - sure.R)[:, 0, 0] - (
        (1.0 - sure.beams / (BEAMS - 1)) * 2 * 0.05**2 * (1.0 + sure.points[:, 1] ** 2))
    np.testing.assert_allclose(added, 0.0, atol=2e-4)


@pytest.mark.parametrize('mount', [
    (0.0, 0.0, np.pi / 2.0), (0.0, 0.0, -0.7), (1.5, 0.3, 0.0), (1.0, -0.5, np.pi)])
def test_uncertain_odometry_is_that_of_the_base_also_where_the_laser_is_turned(mount):
    mount, Q = np.array(mount), np.diag([0.4, 0.02, 0.1])
    scan = replace(scan_of(POSTS, beams=BEAMS), time_increment=DURATION / BEAMS)
    found = []
    for twist_covariance in (np.zeros((3, 3)), Q):
        stream = detector()
        for k in range(4):
            stream.add_odometry(Odometry('r1', k * NS // 20, np.zeros(3), twist_covariance))
        stream.add_scan(StampedScan(0, scan, mount))
        found.append(next(stream.take())[1])

    sure, unsure = found
    share = 1.0 - sure.beams / (BEAMS - 1)
    for k, point in enumerate(sure.points):
        # Where a motion of the base that is not in its odometry moves the point, numerically.
        J = np.transpose([
            (transform(inverse(mount), transform(step, transform(mount, point[None])))[0] - point)
            / 1e-6 for step in 1e-6 * np.eye(3)])
        np.testing.assert_allclose(
            unsure.R[k] - sure.R[k], share[k] * J @ (2 * 0.05**2 * Q) @ J.T, atol=1e-4)


def test_odometry_from_before_the_clock_was_set_changes_no_covariance_after_it():
    def covariances(*before):
        stream, begin, Q = detector(), 1_700_000_000 * NS, np.diag([0.01, 0.01, 0.04])
        for stamp in (*before, *range(begin, begin + NS, NS // 25)):
            stream.add_odometry(Odometry('r1', stamp, np.zeros(3), Q))
        scan = replace(scan_of(POSTS, beams=BEAMS), time_increment=DURATION / (BEAMS - 1))
        stream.add_scan(StampedScan(begin + NS // 2, scan, np.zeros(3)))
        (_, found), = stream.take()
        return found.R

    assert len(covariances()) == 3
    assert covariances(0) == pytest.approx(covariances(), rel=1e-12)


@pytest.mark.parametrize('ahead', [0, 10**6])
def test_a_stamp_far_ahead_and_time_that_jumps_back_cost_no_later_scan(ahead):
    stream, scan, found = detector(), scan_of(POSTS, sigma=0.005), []
    for k in range(60):
        # Twice the same three seconds.
        stamp = 100 * NS + (k % 30) * NS // 10
        stream.add_odometry(Odometry('r1', stamp, np.zeros(3), None))
        if k == 10 and ahead:
            stream.add_odometry(Odometry('r1', ahead * NS, np.zeros(3), None))
        stream.add_scan(StampedScan(stamp, scan, np.zeros(3)))
        found += stream.take()

    # The one at the stamp far ahead waits for odometry that never comes.
    assert (stream.scans, len(found)) == (60, 60)
    assert stream.restarts == (2 if ahead else 1)
    assert stream.without_odometry <= 1


@pytest.mark.parametrize(('back', 'restarts'), [(0.9, 0), (1.1, 1)])
def test_odometry_begins_again_if_it_goes_back_by_more_than_a_second(back, restarts):
    stream = detector()
    for seconds in (9.8, 10.0, 10.0 - back):
        stream.add_odometry(Odometry('r1', round(seconds * NS), np.zeros(3), None))

    assert (stream.restarts, stream.late_odometry) == (restarts, 1 - restarts)


def test_scans_that_wait_when_time_jumps_back_count_as_lost():
    stream, scan = detector(), scan_of(POSTS)
    for k in range(3):
        stream.add_scan(StampedScan(10 * NS + k * NS // 10, scan, np.zeros(3)))

    stream.add_scan(StampedScan(0, scan, np.zeros(3)))

    assert (stream.restarts, stream.lost, stream.waiting) == (1, 3, 1)
