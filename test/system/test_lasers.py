# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From scans of lasers to poses: detection, and joining by posts, starts unknown and no IDs."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.sim.laser_world import LaserWorldSettings, make_laser_world
from fej_slam_ros.sim.lidar import LidarSettings
from helpers.lasers import detect_in_world, estimate_in_world
from helpers.slow import slow

ROOM = LaserWorldSettings(landmarks=20, post_radius=(0.05, 0.4), people=3, inner_walls=3, loops=1)
LINE = LaserWorldSettings(loops=1)
#: Two landmarks are no closer than this, nor a landmark and a path [m].
CLEAR = 1.0


def lidar_of(seed):
    rng = np.random.default_rng(1000 + seed)
    return LidarSettings(
        beams=int(rng.choice([360, 720, 1440])), range_sigma=float(rng.choice([0.01, 0.03, 0.05])))


def test_posts_are_found_and_people_and_walls_are_not():
    scores = detect_in_world(ROOM, LidarSettings(), seed=1, scans=300)

    # The bounds of the run of many rooms below, less for a run of 15 s.
    assert scores.precision > 0.98
    assert scores.recall > 0.88
    assert 0.8 < np.mean(scores.nees) < 1.3


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_detection_over_twenty_rooms_is_as_good_as_documented():
    runs = [detect_in_world(ROOM, lidar_of(seed), seed, scans=1200) for seed in range(20)]

    assert np.mean([scores.precision for scores in runs]) >= 0.99
    assert np.mean([scores.recall for scores in runs]) >= 0.95
    # In a room, people who pass beside a post add a few errors of many sigmas.
    assert 0.85 < np.mean([np.mean(scores.nees) for scores in runs]) < 1.25


@pytest.mark.parametrize('seed', [slow(0), 4])
def test_robots_with_unknown_starts_join_by_posts(seed):
    rng = np.random.default_rng(seed)
    world = make_laser_world(replace(LINE, steps_per_loop=400, loop_lengths=(12.0, 10.0)), rng)

    result = estimate_in_world(world, LidarSettings(), rng)

    assert result.joined
    # A wrong join is off by metres.
    assert max(result.rmse.values()) < 0.1


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_without_ids_the_estimate_is_as_good_as_with_ids():
    results = {False: [], True: []}
    for seed in range(20):
        for with_ids in (False, True):
            rng = np.random.default_rng(seed)
            world = make_laser_world(LINE, rng)
            results[with_ids].append(estimate_in_world(world, LidarSettings(), rng, with_ids))

    assert all(result.joined for result in results[False])
    rmse = {
        with_ids: np.sqrt(np.mean(np.square([[*r.rmse.values()] for r in runs])))
        for with_ids, runs in results.items()}
    assert rmse[False] < 1.3 * rmse[True]
    # The mean of 40 correlated runs varies by 0.1.
    assert 0.85 < np.mean([[*r.nees.values()] for r in results[False]]) < 1.3


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_with_few_beams_posts_far_away_do_not_bias_the_estimate():
    results = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        world = make_laser_world(LINE, rng)
        results.append(estimate_in_world(world, LidarSettings(beams=360), rng))

    # In one room the robots see too few posts in common.
    assert sum(result.joined for result in results) >= 11
    assert 0.85 < np.mean([nees for result in results for nees in result.nees.values()]) < 1.3


def layout(kind, rng, paths):
    """Return posts (n, 2) in a symmetric or repeated layout around the paths."""
    low, high = paths.min(axis=0), paths.max(axis=0)
    centre, spacing = (low + high) / 2.0, rng.uniform(1.5, 2.5)
    x, y = (np.arange(low[k] - 1.5, high[k] + 1.6, spacing) for k in (0, 1))
    if kind == 'rows':
        points = [(px, py) for py in (low[1] - 1.5, high[1] + 1.5) for px in x]
    elif kind == 'grid':
        points = [(px, py) for px in x for py in y]
    elif kind == 'ring':
        angles = 2.0 * np.pi * np.arange(n := rng.integers(5, 12)) / n
        radius = max(high - low) / 2.0 + 1.0
        points = centre + radius * np.stack([np.cos(angles), np.sin(angles)], 1)
    else:
        half = rng.uniform(low - 1.5, centre, (12, 2))
        points = [p for post in half for p in (post, 2.0 * centre - post)]
    clear: list = []
    for p in np.array(points):
        if np.hypot(*(paths - p).T).min() > CLEAR and all(
                np.hypot(*(p - q)) > CLEAR for q in clear):
            clear.append(p)
    return clear


@pytest.mark.slow
@pytest.mark.timeout(2400)
@pytest.mark.parametrize('kind', ['rows', 'grid', 'ring', 'point_symmetric'])
def test_symmetric_and_repeated_posts_never_join_wrongly(kind):
    for seed in range(30):
        rng = np.random.default_rng(seed)
        room = replace(LINE, people=0, inner_walls=0)
        world = make_laser_world(room, rng)
        paths = np.vstack([poses[::5, :2] for poses in world.true_poses.values()])
        posts = dict(enumerate(layout(kind, rng, paths), start=1))
        world = replace(world, landmarks=posts, radii=dict.fromkeys(posts, 0.12))

        result = estimate_in_world(world, LidarSettings(), rng)

        assert not result.joined or result.rmse['r2'] < 0.5
