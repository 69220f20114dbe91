# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generated environments resemble the published ones."""

from dataclasses import replace
from itertools import pairwise
import math

import numpy as np
import pytest

from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.world import make_world

#: Mean number of landmarks in view of robots 1 and 2 in the worlds of [Liu].
MEAN_IN_VIEW = {
    ('circles', 20): (2.85, 3.00),
    ('circles', 60): (9.00, 8.78),
    ('circles', 100): (14.45, 14.69),
    ('figure_eight', 20): (2.01, 2.28),
    ('figure_eight', 60): (5.59, 6.01),
    ('figure_eight', 100): (9.45, 9.95),
}


def distances(world, robot):
    """Return the true distance of each pose (rows) to each landmark (columns)."""
    landmarks = np.array(list(world.landmarks.values()))
    return np.linalg.norm(world.true_poses[robot][:, None, :2] - landmarks, axis=2)


@pytest.mark.parametrize(
    ('name', 'steps', 'lengths'),
    [('circles', 315, (164.45, 145.33)), ('figure_eight', 200, (247.20, 211.41))],
)
def test_five_loops_have_the_published_steps_and_lengths(name, steps, lengths):
    world = make_world(ENVIRONMENTS[name].world, np.random.default_rng(0))
    for robot, length in zip(world.robots, lengths):
        positions = world.true_poses[robot][:, :2]
        driven = sum(math.dist(a, b) for a, b in pairwise(positions))
        assert len(positions) == steps + 1
        assert driven == pytest.approx(5 * length, abs=1e-9)  # rounding of a sum of 315 terms


@pytest.mark.parametrize(('name', 'landmarks'), MEAN_IN_VIEW)
def test_mean_number_of_landmarks_in_view_is_as_published(name, landmarks):
    settings = replace(ENVIRONMENTS[name].world, landmarks=landmarks, loops=1)
    worlds = [make_world(settings, np.random.default_rng(seed)) for seed in range(8)]
    for robot, published in zip(settings.robots, MEAN_IN_VIEW[name, landmarks]):
        in_view = [np.sum(distances(world, robot)[1:] <= 15.0, axis=1) for world in worlds]
        # A quarter: the published landmarks were set by hand along less regular paths.
        assert np.mean(in_view) == pytest.approx(published, rel=0.25)


@pytest.mark.parametrize('name', ENVIRONMENTS)
@pytest.mark.parametrize('robots', [1, 2, 3, 4, 5])
def test_all_robots_share_two_landmarks_at_the_start(name, robots):
    settings = replace(
        ENVIRONMENTS[name].world, robots=tuple(f'r{i}' for i in range(robots)), landmarks=20
    )
    for seed in range(10):
        world = make_world(settings, np.random.default_rng(seed))
        seen = np.array([distances(world, robot)[0] <= 15.0 for robot in world.robots])
        assert np.sum(np.all(seen, axis=0)) >= 2
