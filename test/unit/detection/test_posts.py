# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Posts are found with the accuracy they claim; what is none is rejected for its reason."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.detection.detections import RejectedSegment
from fej_slam_ros.detection.posts import PostDetector
from helpers.lasers import scan_of

POSTS = np.array([[4.0, 0.5, 0.2], [-2.0, 1.0, 0.1], [0.5, -3.0, 0.3], [-5.0, -4.0, 0.35]])
WALL = [6.0, -8.0, 6.0, 8.0]


def certain(detections):
    return detections.points[detections.is_certain]


@pytest.mark.parametrize('fov', [2.0 * np.pi, np.radians(350.0)])
def test_exact_ranges_give_the_centres(fov):
    found = PostDetector(range_sigma=0.001)(scan_of(POSTS, WALL, beams=1440, fov=fov))

    order = np.argsort(np.arctan2(*POSTS[:, [1, 0]].T))
    # The edges are known to a beam, which is 15 mm wide at the distance of the farthest post.
    np.testing.assert_allclose(found.points, POSTS[order, :2], atol=0.01)
    np.testing.assert_allclose(found.radii, POSTS[order, 2], atol=0.01)


@pytest.mark.parametrize('sigma', [0.01, 0.03, 0.05])
@pytest.mark.parametrize('beams', [360, 720, 1440])
def test_errors_are_as_large_as_the_covariance_says(beams, sigma):
    rng, values = np.random.default_rng(beams), []
    for seed in range(300):
        angle, distance, radius = rng.uniform((-3, 1, 0.05), (3, 6, 0.4))
        post = np.array([distance * np.cos(angle), distance * np.sin(angle), radius])
        found = PostDetector(range_sigma=sigma)(scan_of(post, beams=beams, sigma=sigma, seed=seed))
        for point, R, count in zip(found.points, found.R, found.counts):
            if count >= 5:
                error = point - post[:2]
                values.append(error @ np.linalg.solve(R, error) / 2.0)
    assert len(values) > 100
    # The mean of chi-square(2)/2 over 100 values varies by 0.1; edges are uniform, not normal.
    assert 0.75 < np.mean(values) < 1.3


@pytest.mark.parametrize(
    ('discs', 'walls', 'reason'),
    [
        ([], WALL, RejectedSegment.WIDE),
        # A post close before another one hides a part of it and one of its edges.
        ([[2.0, 0.0, 0.1], [4.0, 0.35, 0.2]], [], None),
        # A wall seen between two posts has no edges of its own.
        ([[2.0, 0.35, 0.2], [2.0, -0.35, 0.2]], [4.0, -0.28, 4.0, 0.28], RejectedSegment.OCCLUDED),
        # Both edges of a panel are seen, but it is flat.
        ([], [3.0, -0.4, 3.0, 0.4], RejectedSegment.NOT_ROUND),
        ([[5.0, 0.0, 0.02]], [], RejectedSegment.FEW_BEAMS),
        ([[3.0, 0.0, 0.7]], [], RejectedSegment.WIDE),
    ],
)
def test_what_is_no_post_is_rejected_for_its_reason(discs, walls, reason):
    detector = PostDetector(range_sigma=0.01)

    found = detector(scan_of(discs, walls, beams=1440, sigma=0.01))

    if reason is None:
        assert len(certain(found)) == 2
    else:
        assert found.rejected[reason] >= 1
        walls_only = detector(scan_of([], walls, beams=1440, sigma=0.01))
        assert len(certain(found)) == len(discs) - (reason is not RejectedSegment.OCCLUDED) * len(
            discs) + len(certain(walls_only))


def test_a_radius_far_outside_of_the_limits_is_rejected():
    found = PostDetector(min_radius=0.25, max_radius=0.5, range_sigma=0.01)(
        scan_of([2.0, 0.0, 0.1], beams=1440, sigma=0.01))

    assert (len(found.points), found.rejected[RejectedSegment.RADIUS]) == (0, 1)


def test_a_post_of_known_radius_is_placed_better_than_one_of_unknown_radius():
    scan = scan_of([5.0, 0.0, 0.2], beams=360, sigma=0.03)

    known = PostDetector(0.2, 0.2, range_sigma=0.03)(scan)
    unknown = PostDetector(range_sigma=0.03)(scan)

    assert known.R[0, 0, 0] < 0.5 * unknown.R[0, 0, 0]


def test_a_clockwise_scan_has_the_same_posts():
    scan = scan_of(POSTS, WALL, sigma=0.02)
    last = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    reverse = replace(
        scan, ranges=scan.ranges[::-1], angle_min=last, angle_increment=-scan.angle_increment)

    one, other = (PostDetector()(s) for s in (scan, reverse))

    # The angles are summed from the other end.
    np.testing.assert_allclose(one.points, other.points, atol=1e-12)
    assert (719 - other.beams).tolist() == pytest.approx(one.beams.tolist(), abs=1)


def test_a_post_at_the_seam_of_a_full_turn_is_one_post():
    found = PostDetector(range_sigma=0.01)(scan_of([-3.0, 0.0, 0.2], sigma=0.01))

    np.testing.assert_allclose(found.points, [[-3.0, 0.0]], atol=0.05)


def test_half_a_post_at_the_edge_of_the_view_is_placed_as_well_as_its_covariance_says():
    values = []
    for seed in range(200):
        found = PostDetector(range_sigma=0.01)(
            scan_of([0.0, 3.0, 0.2], sigma=0.01, fov=np.pi, seed=seed))
        for point, R in zip(certain(found), found.R[found.is_certain]):
            error = point - [0.0, 3.0]
            values.append(error @ np.linalg.solve(R, error) / 2.0)
    assert len(values) > 150
    # All scans see the same beams, whose edge is at one place of its interval.
    assert np.mean(values) < 1.5


@pytest.mark.parametrize('missing', [np.nan, np.inf, 0.0])
def test_single_beams_without_return_do_not_divide_a_post(missing):
    scan = scan_of([3.0, 0.0, 0.3], WALL, sigma=0.01)
    hit = np.flatnonzero(scan.ranges < 3.5)
    scan.ranges[hit[[5, 12, 13]]] = missing

    found = PostDetector(range_sigma=0.01)(scan)

    np.testing.assert_allclose(certain(found), [[3.0, 0.0]], atol=0.03)


def test_a_post_that_reaches_beyond_the_range_of_the_laser_is_rejected():
    found = PostDetector(range_sigma=0.01)(
        scan_of([5.0, 0.0, 0.3], sigma=0.01, beams=1440, max_range=4.75))

    assert not len(certain(found))


@pytest.mark.parametrize('value', [np.nan, np.inf, -1.0])
def test_a_scan_without_returns_has_no_posts(value):
    scan = replace(scan_of([], beams=360), ranges=np.full(360, value))

    assert not len(PostDetector()(scan).points)


@pytest.mark.parametrize(('beams', 'settings'), [
    (720, {}), (720, {'max_radius': 2.0, 'range_sigma': 0.01}),
    (24, {'max_radius': 10.0}), (720, {'max_radius': 10.0, 'range_sigma': 1e-4})])
def test_clutter_without_any_object_is_no_error(beams, settings):
    rng, detector = np.random.default_rng(0), PostDetector(**settings)
    for _ in range(100):
        ranges = np.full(beams, 8.0)
        at = rng.integers(beams)
        ranges[at:at + 8] = rng.uniform(0.02, 0.4, len(ranges[at:at + 8]))
        for values in (ranges, rng.uniform(0.0, 10.0, beams)):
            found = detector(replace(scan_of([], beams=beams), ranges=values))
            assert np.isfinite(found.points).all()
            assert np.isfinite(found.R).all()


def test_a_scan_whose_last_beam_looks_where_the_first_does_has_the_same_posts():
    increment = 2.0 * np.pi / 360
    errors = []
    for seed in range(50):
        # The 361 beams of simulators and many drivers, from -pi to pi.
        scan = scan_of([-3.0, 0.0, 0.15], beams=360, sigma=0.01, seed=seed)
        both = replace(scan, ranges=np.append(scan.ranges, scan.ranges[0]))
        assert both.angle_increment == pytest.approx(increment)
        found = PostDetector(range_sigma=0.01)(both)
        error = found.points[0] - [-3.0, 0.0]
        errors.append(error @ np.linalg.solve(found.R[0], error) / 2.0)
    # Chi-square(2)/2; all scans see the same beams, whose edges are where they are.
    assert np.mean(errors) < 2.0
