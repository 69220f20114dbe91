# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Generated worlds: starts, stamps, loops and landmarks."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.world import make_world, WorldSettings

SETTINGS = WorldSettings('circles', (164.45, 145.33), 63, landmarks=20, loops=2)


def world(seed=1, **changes):
    return make_world(replace(SETTINGS, **changes), np.random.default_rng(seed))


def landmark_array(a_world):
    return np.array(list(a_world.landmarks.values()))


def observation(a_world, robot, step, number):
    """Return a landmark's position as the robot sees it at a step."""
    landmark = np.append(a_world.landmarks[number], 0.0)
    return between(a_world.true_poses[robot][step], landmark)[:2]


def test_the_first_robot_starts_at_the_origin():
    np.testing.assert_array_equal(world().true_poses['r1'][0], np.zeros(3))


def test_another_start_moves_the_whole_world_rigidly():
    at_origin, elsewhere = world(), world(start=(3.0, -2.0, 2.5))
    np.testing.assert_array_equal(elsewhere.true_poses['r1'][0], [3.0, -2.0, 2.5])
    for robot, step, number in (('r1', 10, 1), ('r2', 40, 2), ('r2', 126, 20)):
        np.testing.assert_allclose(
            observation(elsewhere, robot, step, number),
            observation(at_origin, robot, step, number),
            atol=1e-12,  # rounding
        )


def test_stamps_keep_the_rate_without_drift():
    stamps = world(rate=3.0, first_stamp=1_700_000_000_000_000_000).stamps
    assert len(stamps) == 2 * 63 + 1
    assert stamps[:3] == (
        1_700_000_000_000_000_000, 1_700_000_000_333_333_333, 1_700_000_000_666_666_667
    )
    assert stamps[126] - stamps[0] == 42_000_000_000


def test_every_loop_repeats_the_first():
    poses = world(loops=5).true_poses['r2']
    assert poses.shape == (5 * 63 + 1, 3)
    for loop in range(1, 5):
        np.testing.assert_array_equal(poses[63 * loop:63 * (loop + 1)], poses[:63])
    np.testing.assert_array_equal(poses[-1], poses[0])


def test_landmarks_are_numbered_from_one():
    assert list(world(landmarks=2).landmarks) == [1, 2]
    assert list(world(landmarks=20).landmarks) == list(range(1, 21))


def test_landmarks_lie_beside_the_paths_or_near_the_start():
    a_world = world(landmarks=100)
    path = np.vstack([poses[:, :2] for poses in a_world.true_poses.values()])
    distances = [np.hypot(*(path - f).T).min() for f in landmark_array(a_world)[2:]]
    assert max(distances) <= np.hypot(5.0, 5.0)


@pytest.mark.parametrize('robots', [1, 2, 3, 4, 5])
def test_every_robot_has_its_true_poses(robots):
    names = tuple(f'robot_{i}' for i in range(robots))
    a_world = world(robots=names)
    assert a_world.robots == names
    assert list(a_world.true_poses) == list(names)
    assert all(len(poses) == len(a_world.stamps) for poses in a_world.true_poses.values())


def test_the_same_seed_gives_the_same_world():
    np.testing.assert_array_equal(landmark_array(world(seed=7)), landmark_array(world(seed=7)))


def test_another_seed_gives_other_landmarks():
    assert np.all(landmark_array(world(seed=7)) != landmark_array(world(seed=8)))


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'environment': 'ring'}, "environment: 'ring' is unknown, use one of circles, figure_ei"),
        ({'landmarks': 1}, 'landmarks: 1 are too few for a common start, use 2 or more'),
    ],
)
def test_impossible_settings_are_rejected(changes, message):
    with pytest.raises(UsageError, match=message):
        world(**changes)
