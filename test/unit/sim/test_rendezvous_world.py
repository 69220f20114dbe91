# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rendezvous worlds: ground truth of two robots that observe each other."""

from dataclasses import replace
from itertools import combinations
import math

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
from fej_slam_ros.sim.rendezvous_world import make_rendezvous_world

every_environment = pytest.mark.parametrize('name', RENDEZVOUS_ENVIRONMENTS)


def rendezvous(name, seed=1, **changes):
    settings = replace(RENDEZVOUS_ENVIRONMENTS[name].world, **changes)
    return make_rendezvous_world(settings, np.random.default_rng(seed))


def landmarks(world):
    return np.array([*world.landmarks.values()])


@pytest.mark.parametrize(
    ('name', 'steps', 'count'), [('map_joining', 84, 83), ('sensor_extension', 100, 90)])
def test_numbers_of_steps_and_landmarks_are_those_of_the_experiment(name, steps, count):
    world = rendezvous(name, first_stamp=1_000_000_000)

    assert [len(poses) for poses in world.true_poses.values()] == [steps + 1] * 2
    assert world.stamps == tuple(1_000_000_000 + 500_000_000 * k for k in range(steps + 1))
    assert [*world.landmarks] == [*range(1, count + 1)]


@every_environment
def test_the_first_robot_starts_at_the_origin(name):
    np.testing.assert_array_equal(rendezvous(name).true_poses['p'][0], np.zeros(3))


@every_environment
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_landmarks_keep_a_minimum_distance_from_each_other_and_from_the_robots(name, seed):
    world = rendezvous(name, seed)
    paths = np.vstack([*world.true_poses.values()])[:, :2]

    assert min(math.dist(a, b) for a, b in combinations(landmarks(world), 2)) >= 0.35
    assert min(math.dist(a, b) for a in landmarks(world) for b in paths) >= 0.35


@every_environment
def test_each_robot_has_its_own_ids_for_the_same_landmarks(name):
    world = rendezvous(name)
    p, q = world.landmark_of['p'], world.landmark_of['q']

    assert sorted(p) == sorted(q) == [*world.landmarks]
    assert sorted(p.values()) == sorted(q.values()) == [*world.landmarks]
    # Of two random permutations one number in the mean is the same.
    assert sum(p[number] == q[number] for number in p) <= 8


@pytest.mark.parametrize('seed', range(20))
def test_robots_of_map_joining_are_in_view_of_each_other_in_their_window(seed):
    p, q = rendezvous('map_joining', seed).true_poses.values()

    for observer, seen in ((p, q), (q, p)):
        for k in range(44, 53):
            x, y, _ = between(observer[k], seen[k])
            assert math.hypot(x, y) <= 4.0
            assert abs(math.atan2(y, x)) <= math.radians(120.0)


@pytest.mark.parametrize('seed', range(20))
def test_the_second_robot_of_sensor_extension_is_always_ahead_and_in_range(seed):
    p, q = rendezvous('sensor_extension', seed).true_poses.values()

    for observer, seen in zip(p, q):
        x, y, _ = between(observer, seen)
        assert x >= 0.0
        assert math.hypot(x, y) <= 4.0


def test_each_robot_ends_in_the_area_of_the_other():
    world = rendezvous('map_joining')
    of_p, of_q = landmarks(world)[:40], landmarks(world)[40:80]

    for robot, other in (('p', of_q), ('q', of_p)):
        x, y = world.true_poses[robot][-1, :2]
        assert other[:, 0].min() < x < other[:, 0].max()
        assert other[:, 1].min() < y < other[:, 1].max()
    # The gap is 7.4 m wide.
    assert of_p[:, 0].min() - of_q[:, 0].max() >= 7.4


def test_the_second_robot_is_on_rougher_ground():
    p, q = RENDEZVOUS_ENVIRONMENTS['sensor_extension'].world.sigmas

    np.testing.assert_allclose(p, [0.02, 0.01, 0.01])
    np.testing.assert_allclose(q, 5.0 * p)


@every_environment
def test_the_seed_determines_the_layout(name):
    one = landmarks(rendezvous(name, 7))

    np.testing.assert_array_equal(one, landmarks(rendezvous(name, 7)))
    assert np.all(one != landmarks(rendezvous(name, 8)))


@pytest.mark.parametrize('robots', [('p',), ('p', 'q', 'r')])
def test_any_number_of_robots_but_two_is_rejected(robots):
    with pytest.raises(UsageError, match=f'robots: {len(robots)} names given, .* exactly two'):
        rendezvous('map_joining', robots=robots)
