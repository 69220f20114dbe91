# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laser worlds are as described, and their scans are those of the moving robots."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.records import NS, Odometry, TruePose
from fej_slam_ros.detection.records import RobotLaserScan
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.laser_world import (
    LaserWorldSettings, make_laser_world, measure, PATH_DISTANCE, POST_DISTANCE, WALKING_SPEED)
from fej_slam_ros.sim.lidar import LidarSettings

SMALL = LaserWorldSettings(loops=1, steps_per_loop=300, people=1)


def world_of(seed=0, **changes):
    return make_laser_world(replace(SMALL, **changes), np.random.default_rng(seed))


@pytest.mark.parametrize('seed', range(5))
def test_random_posts_leave_room_for_the_robots(seed):
    world = world_of(seed)

    paths = np.vstack([poses[:, :2] for poses in world.true_poses.values()])
    for x, y, radius in world.posts:
        assert np.hypot(*(paths - [x, y]).T).min() > PATH_DISTANCE + radius
        others = world.posts[:, :2][(world.posts[:, :2] != [x, y]).any(axis=1)]
        assert np.hypot(*(others - [x, y]).T).min() > POST_DISTANCE


def test_given_posts_and_walls_replace_the_random_ones():
    world = world_of(posts=(1.0, 2.0, 0.1, 3.0, 4.0, 0.2), walls=(0.0, 9.0, 9.0, 9.0))

    np.testing.assert_array_equal(world.posts, [[1.0, 2.0, 0.1], [3.0, 4.0, 0.2]])
    np.testing.assert_array_equal(world.walls, [[0.0, 9.0, 9.0, 9.0]])


@pytest.mark.parametrize(('name', 'values'), [('posts', (1.0, 2.0)), ('walls', (1.0,) * 5)])
def test_incomplete_posts_and_walls_are_refused(name, values):
    with pytest.raises(UsageError, match=f'{name}: give . numbers'):
        world_of(**{name: values})


def test_too_many_posts_are_refused():
    with pytest.raises(UsageError, match='use fewer'):
        world_of(landmarks=500)


def test_people_walk_step_by_step():
    world = world_of()
    times = np.arange(0.0, 10.0, 0.01)
    legs = np.array([world.legs(t)[:, :2] for t in times])

    speeds = np.hypot(*np.diff(legs, axis=0).transpose(2, 0, 1)) / 0.01
    # A leg stands half of the time, and is twice as fast as the person otherwise.
    assert np.mean(speeds < 1e-6, axis=0) == pytest.approx([0.5, 0.5], abs=0.1)
    assert np.median(speeds[speeds > 1e-6]) == pytest.approx(2.0 * WALKING_SPEED, rel=0.01)


def test_records_come_when_they_were_measured():
    world, lidar = world_of(), LidarSettings(beams=90)

    records = [*measure(world, lidar, np.random.default_rng(0))][1:]

    times = [r.end if isinstance(r, RobotLaserScan) else r.stamp for r in records]
    assert times == sorted(times)
    scans = [r for r in records if isinstance(r, RobotLaserScan) and r.robot == 'r1']
    assert np.diff([scan.stamp for scan in scans]).tolist() == [NS // 10] * (len(scans) - 1)
    kinds = {type(r) for r in records}
    assert kinds == {Odometry, TruePose, RobotLaserScan}


def test_radii_in_the_wrong_order_or_below_zero_are_refused():
    with pytest.raises(UsageError, match='smaller radius first'):
        world_of(post_radius=(0.2, 0.1))
    with pytest.raises(UsageError, match='radii above 0'):
        world_of(posts=(1.0, 2.0, -0.1))
