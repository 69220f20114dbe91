# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cameras see the tags that are in view, where they are, with the noise of their settings."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.geometry import poses_at
from fej_slam_ros.detection.records import RobotTags
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.environments import ALL_ENVIRONMENTS
from fej_slam_ros.sim.tags import (
    CAMERA_POSE, CameraSettings, make_tag_world, MAX_VIEW_ANGLE, measure, robot_tags, TAG_DEPTH)

EXACT = CameraSettings(
    range_sigma=1e-9, range_sigma_growth=0.0, bearing_sigma=1e-9, orientation_sigma=1e-9,
    missed=0.0)
WORLD = replace(ALL_ENVIRONMENTS['tags'].world, loops=1, steps_per_loop=500)


@pytest.fixture(scope='module')
def world():
    return make_tag_world(WORLD, np.random.default_rng(1))


def images(world, settings, seed=2):
    return [record for record in measure(world, settings, np.random.default_rng(seed))
            if isinstance(record, RobotTags)]


def in_base(tag):
    """Return the point of a tag in the base frame: z of the optical frame is ahead, x right."""
    right, _, ahead = tag.pose[:3, 3]
    return np.array([CAMERA_POSE[0] + ahead, CAMERA_POSE[1] - right])


def seen_from(world, image):
    """Return the true position of each tag on a post in the base frame of the robot."""
    pose, = poses_at(
        np.array([image.stamp]), np.array(world.stamps), world.true_poses[image.robot])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return {
        str(id_): np.array([[c, s], [-s, c]]) @ (point - pose[:2])
        for id_, point in world.landmarks.items()}


def test_tags_are_where_the_true_world_has_them(world):
    checked = 0
    for image in images(world, EXACT):
        truth = seen_from(world, image)
        for tag in image.tags:
            if tag.name in truth:
                # The least noise across the line of sight is 1 mm.
                np.testing.assert_allclose(in_base(tag), truth[tag.name], atol=5e-3)
                checked += 1
    assert checked > 100


def test_exactly_the_tags_in_view_are_seen(world):
    for image in images(world, EXACT)[::7]:
        pose, = poses_at(
            np.array([image.stamp]), np.array(world.stamps), world.true_poses[image.robot])
        expected = set()
        for name, point in seen_from(world, image).items():
            x, y = point - CAMERA_POSE[:2]
            up = world.heights[int(name)] - CAMERA_POSE[2]
            distance = np.sqrt(x * x + y * y + up * up)
            normal = world.normals[int(name)] - pose[2]
            towards = -(x * np.cos(normal) + y * np.sin(normal)) / distance
            if (0.4 <= distance <= EXACT.range and towards >= np.cos(MAX_VIEW_ANGLE)
                    and x > 0.0 and abs(np.arctan2(y, x)) <= EXACT.field_of_view / 2.0):
                expected.add(name)
        assert {tag.name for tag in image.tags if int(tag.name) < 1000} == expected


def test_tags_on_posts_must_not_have_the_numbers_of_those_on_robots():
    with pytest.raises(UsageError, match='fewer than 1000 tags on posts'):
        make_tag_world(replace(WORLD, landmarks=1000), np.random.default_rng(1))


def test_robots_carry_tags_on_their_sides(world):
    names = robot_tags(world.robots)
    checked = 0
    for image in images(world, EXACT):
        (other,) = {*world.robots} - {image.robot}
        at = {
            name: poses_at(np.array([image.stamp]), np.array(world.stamps), poses)[0]
            for name, poses in world.true_poses.items()}
        pose = at[image.robot]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        centre = np.array([[c, s], [-s, c]]) @ (at[other][:2] - pose[:2])
        for tag in image.tags:
            if int(tag.name) >= 1000:
                assert tag.name in names[other]
                assert np.hypot(*(in_base(tag) - centre)) == pytest.approx(TAG_DEPTH, abs=5e-3)
                checked += 1
    assert checked > 5


def test_the_noise_is_that_of_the_settings(world):
    settings = CameraSettings(missed=0.3)
    exact, noisy = images(world, EXACT), images(world, settings)
    errors, seen = [], 0
    for before, after in zip(exact, noisy):
        true = {tag.name: tag.pose[:3, 3] for tag in before.tags}
        seen += len(true)
        for tag in after.tags:
            t = true[tag.name]
            d, error = np.linalg.norm(t), tag.pose[:3, 3] - t
            along = error @ t / d
            across = np.linalg.norm(error - along * t / d)
            sigma = np.hypot(settings.range_sigma, settings.range_sigma_growth * d * d)
            errors.append([(along / sigma)**2, (across / (settings.bearing_sigma * d))**2 / 2.0])
    # Means of n squares of unit normals: three standard deviations.
    n = len(errors)
    assert np.mean(errors, axis=0) == pytest.approx([1.0, 1.0], abs=3.0 * np.sqrt(2.0 / n))
    assert n / seen == pytest.approx(0.7, abs=3.0 * np.sqrt(0.21 / seen))
