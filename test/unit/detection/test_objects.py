# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Positions of objects in space and their noise, on the plane of the robot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fej_slam_ros.detection.objects import (
    carrier_position, DetectedObject, ObjectNoise, planar_observation, with_axis_negated)

NOISE = ObjectNoise(
    range_sigma=0.05, range_sigma_growth=0.01, bearing_sigma=0.02, orientation_sigma=0.1)


def at(position, turn=(0.0, 0.0, 0.0), P=None):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler('xyz', turn).as_matrix(), position
    return DetectedObject('4', pose, P)


@pytest.mark.parametrize('seed', range(5))
def test_the_covariance_is_that_of_samples_of_distance_and_direction(seed):
    rng = np.random.default_rng(seed)
    camera = at(rng.uniform(-1.0, 1.0, 3), rng.uniform(-3.0, 3.0, 3)).pose
    position = rng.uniform(-4.0, 4.0, 3)
    d = np.linalg.norm(position)

    z, R = planar_observation(at(position), camera, NOISE)

    # Turns by small angles about any axis, and lengths.
    n = 20_000
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.02, (n, 3)))
    lengths = 1.0 + rng.normal(0.0, np.hypot(0.05, 0.01 * d * d), n) / d
    samples = (turns.apply(position) * lengths[:, None]) @ camera[:3, :3].T + camera[:3, 3]
    np.testing.assert_allclose(z, (camera @ [*position, 1.0])[:2], atol=1e-12)
    # Variances of 20,000 samples are known to one per cent.
    np.testing.assert_allclose(
        R, np.cov(samples[:, :2].T), atol=0.05 * np.sqrt(np.linalg.det(R)) + 0.03 * np.trace(R))


def test_a_near_object_has_at_least_a_millimetre():
    _, R = planar_observation(at((0.0, 0.02, 0.0)), np.eye(4), NOISE)

    np.testing.assert_allclose(R, np.diag([1e-6, 0.05**2]), atol=1e-8)


def test_a_given_covariance_is_used():
    _, R = planar_observation(
        at((1.0, 0.0, 0.0), P=np.diag([1.0, 2.0, 3.0])), at((0, 0, 0), (0, 0, np.pi / 2)).pose,
        NOISE)

    np.testing.assert_allclose(R, np.diag([2.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize('flip', [0.0, np.pi])
def test_the_carrier_is_behind_the_tag_whichever_way_its_normal_points(flip):
    # The tag is 2 m ahead, turned by 0.3 rad about the vertical y axis of the camera.
    tag = at((0.0, 0.0, 2.0), (0.0, 0.3 + flip, 0.0), P=np.zeros((3, 3)))

    centre = carrier_position(tag, 0.5, NOISE)

    inward = np.array([np.sin(0.3), 0.0, np.cos(0.3)])
    np.testing.assert_allclose(centre.pose[:3, 3], np.array([0.0, 0.0, 2.0]) + 0.5 * inward)
    # The turn of the tag moves its centre on the plane of the tag.
    expected = 0.05**2 * (np.eye(3) - np.outer(inward, inward))
    np.testing.assert_allclose(centre.P, expected, atol=1e-12)
    np.testing.assert_allclose(tag.pose[:3, 3], [0.0, 0.0, 2.0])


@pytest.mark.parametrize('axis', range(3))
def test_a_left_handed_frame_is_that_of_a_mirror(axis):
    sign = np.ones(3)
    sign[axis] = -1.0
    P = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])
    tag = at((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), P)

    mirrored = with_axis_negated(tag, axis)

    np.testing.assert_allclose(mirrored.pose[:3, 3], sign * [1.0, 2.0, 3.0])
    np.testing.assert_allclose(mirrored.P, np.outer(sign, sign) * P)
    # A point on the tag is at its mirror image, also in the frame of the tag.
    point = np.array([0.3, -0.2, 0.1])
    seen = tag.pose @ [*point, 1.0]
    np.testing.assert_allclose((mirrored.pose @ [*(sign * point), 1.0])[:3], sign * seen[:3])
    assert np.linalg.det(mirrored.pose[:3, :3]) == pytest.approx(1.0)
