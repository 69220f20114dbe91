# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Valid messages become records; invalid data is rejected with its reason."""

from contextlib import suppress
from math import inf, nan, pi

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages import incoming
from helpers.optional import given, settings, strategies as st
from helpers.records import MS
from helpers.ros import header, odometry_message, refusal_of

#: The entries of x, y, yaw among the 36 of a message.
USED = [0, 1, 5, 6, 7, 11, 30, 31, 35]


def full(block):
    """Return a 6x6 covariance with a planar block, and rubbish in all other entries."""
    covariance = np.full(36, nan)
    covariance[USED] = np.ravel(block)
    return covariance


def test_odometry_is_the_planar_part_of_its_message():
    block = [[4.0, 1.0, 0.5], [1.0, 9.0, -0.5], [0.5, -0.5, 1.0]]
    turn = (0.0, 0.0, 0.6, 0.8)  # a 3-4-5 triangle: sin and cos of half the yaw

    record = incoming.odometry(odometry_message(1500, (1.0, 2.0, 9.0), turn, full(block)), 'r1')

    assert (record.robot, record.stamp) == ('r1', 1500 * MS)
    np.testing.assert_allclose(record.pose, [1.0, 2.0, 2.0 * np.arctan2(3, 4)], rtol=1e-15)
    np.testing.assert_array_equal(record.twist_covariance, block)


def test_a_zero_twist_covariance_is_unknown():
    assert incoming.odometry(odometry_message(twist_covariance=full([0] * 9)), 'r1') \
        .twist_covariance is None


def test_a_singular_covariance_is_accepted():
    only_yaw = np.diag([0.0, 0.0, 1e-3])

    record = incoming.odometry(odometry_message(twist_covariance=full(only_yaw)), 'r1')

    np.testing.assert_array_equal(record.twist_covariance, only_yaw)


@pytest.mark.parametrize('yaw', [-3.1, -pi / 2, 0.0, 1.0, pi])
@pytest.mark.parametrize(('roll', 'pitch'), [(0.0, 0.0), (0.1, -0.1), (-0.14, 0.14), (0.0, 0.19)])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_yaw_is_taken_from_the_quaternion_and_small_tilt_is_ignored(yaw, roll, pitch, sign):
    quaternion = sign * Rotation.from_euler('ZYX', [yaw, pitch, roll]).as_quat()

    pose = incoming.odometry(odometry_message(quaternion=quaternion), 'r1').pose

    # Modulo a turn; the rounding of a handful of products.
    assert abs(np.angle(np.exp(1j * (pose[2] - yaw)))) < 1e-14


@pytest.mark.parametrize('direction', [0.0, 1.0, 2.0, 4.0])
@pytest.mark.parametrize('yaw', [0.0, 2.5])
def test_a_tilt_above_a_fifth_of_a_radian_is_rejected(direction, yaw):
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    at, beyond = (
        (Rotation.from_euler('z', yaw) * Rotation.from_rotvec(tilt * axis)).as_quat()
        for tilt in (0.1999, 0.2001))

    incoming.odometry(odometry_message(quaternion=at), 'r1')

    assert refusal_of(
        incoming.odometry, odometry_message(quaternion=beyond), 'r1') is RejectionReason.TILTED


@pytest.mark.parametrize('convert', [incoming.odometry, incoming.true_pose])
@pytest.mark.parametrize(
    ('wrong', 'reason'),
    [
        *(({'xyz': np.roll([x, 0.0, 0.0], k)}, RejectionReason.NOT_FINITE)
          for x in (nan, inf, -inf) for k in range(3)),
        *(({'quaternion': np.roll([x, 0.0, 0.0, 1.0], k)}, RejectionReason.NOT_FINITE)
          for x in (nan, inf) for k in range(4)),
        *(({'xyz': np.roll([x, 0.0, 0.0], k)}, RejectionReason.OUT_OF_RANGE)
          for x in (1e10, -1e300) for k in range(3)),
        *(({'quaternion': q}, RejectionReason.BAD_QUATERNION)
          for q in ([0, 0, 0, 0], [0, 0, 0, 2], [0, 0, 0, 0.99], [0, 0, 1, 1], [1e150, 0, 0, 0])),
        ({'quaternion': [1.0, 0.0, 0.0, 0.0]}, RejectionReason.TILTED),
        ({'quaternion': [0.0, 0.7, 0.7, 0.14142]}, RejectionReason.TILTED),
    ])
def test_an_invalid_pose_is_rejected(convert, wrong, reason):
    assert refusal_of(convert, odometry_message(**wrong), 'r1') is reason


@pytest.mark.parametrize('scale', [0.9951, 1.001, 1.0049])
def test_a_quaternion_whose_norm_tf2_accepts_is_normalised(scale):
    quaternion = Rotation.from_euler('ZYX', [2.0, 0.1, -0.1]).as_quat()
    exact, scaled = (
        odometry_message(quaternion=q).pose.pose for q in (quaternion, scale * quaternion))

    np.testing.assert_allclose(
        incoming.planar_pose(scaled), incoming.planar_pose(exact), rtol=1e-14)
    np.testing.assert_allclose(
        incoming.spatial_pose(scaled.position, scaled.orientation),
        incoming.spatial_pose(exact.position, exact.orientation), rtol=0.0, atol=1e-14)


def test_a_quaternion_in_single_precision_is_accepted():
    quaternion = np.float32([0.0, 0.0, 0.6, 0.8]).astype(float)

    incoming.true_pose(odometry_message(quaternion=quaternion), 'r1')


@pytest.mark.parametrize(
    ('block', 'reason'),
    [
        *((np.diag(np.roll([x, 1.0, 1.0], k)), reason) for k in range(3) for x, reason in (
            (nan, RejectionReason.NOT_FINITE), (inf, RejectionReason.NOT_FINITE),
            (-1.0, RejectionReason.BAD_COVARIANCE),
            (-1e-6, RejectionReason.BAD_COVARIANCE), (1e300, RejectionReason.OUT_OF_RANGE))),
        ([[1.0, nan, 0.0], [nan, 1.0, 0.0], [0.0, 0.0, 1.0]], RejectionReason.NOT_FINITE),
        ([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]], RejectionReason.BAD_COVARIANCE),
        ([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 0.0]], RejectionReason.BAD_COVARIANCE),
        ([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]], RejectionReason.BAD_COVARIANCE),
        ([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]], RejectionReason.BAD_COVARIANCE),
        # Negative beside what is large in another unit.
        (np.diag([1e12, 1e12, -9e4]), RejectionReason.BAD_COVARIANCE),
        ([[1e12, 0.0, 0.0], [0.0, 1e-4, 2e-4], [0.0, 2e-4, 1e-4]], RejectionReason.BAD_COVARIANCE),
        # Correlations that are no finite numbers, with one finite eigenvalue and with none.
        ([[5e-324, -1e5, 0.0], [-1e5, 1e-320, 0.0], [0.0, 0.0, 1.0]],
         RejectionReason.BAD_COVARIANCE),
        ([[5e-324, 1e5, 1.0], [1e5, 1e-160, 0.0], [1.0, 0.0, 1e-300]],
         RejectionReason.BAD_COVARIANCE),
    ])
def test_a_matrix_that_is_no_covariance_is_rejected(block, reason):
    message = odometry_message(twist_covariance=full(block))

    assert refusal_of(incoming.odometry, message, 'r1') is reason


def test_rounding_errors_of_a_covariance_are_accepted():
    singular = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    rounded = singular.copy()
    rounded[0, 1] += 2e-12

    block = incoming.odometry(odometry_message(twist_covariance=full(rounded)), 'r1') \
        .twist_covariance

    np.testing.assert_array_equal(block, block.T)
    np.testing.assert_allclose(block, singular, rtol=0.0, atol=2e-12)


def set_pose(block, frame='map'):
    """Return what is said of where a robot is, with the covariance (3, 3) of x, y, yaw."""
    at = odometry_message(xyz=(1.0, 2.0, 9.0), quaternion=(0.0, 0.0, 0.6, 0.8)).pose.pose
    return ros.geometry_msgs__msg__PoseWithCovarianceStamped(
        header=header(1500, frame),
        pose=ros.geometry_msgs__msg__PoseWithCovariance(pose=at, covariance=full(block)))


@pytest.mark.parametrize('frame', ['map', '/map', ''])
def test_an_initial_pose_is_the_planar_part_of_its_message(frame):
    block = [[4.0, 1.0, 0.5], [1.0, 9.0, -0.5], [0.5, -0.5, 1.0]]

    record = incoming.pose_prior(set_pose(block, frame), 'r1', 'map')

    assert (record.robot, record.stamp) == ('r1', 1500 * MS)
    np.testing.assert_allclose(record.pose, [1.0, 2.0, 2.0 * np.arctan2(3, 4)], rtol=1e-15)
    np.testing.assert_array_equal(record.P, block)


@pytest.mark.parametrize(('block', 'frame', 'reason'), [
    (np.eye(3), 'r1/odom', RejectionReason.WRONG_FRAME),
    (np.zeros((3, 3)), 'map', RejectionReason.BAD_COVARIANCE),
    (np.diag([1.0, 1.0, 0.0]), 'map', RejectionReason.BAD_COVARIANCE),
    (np.diag([1.0, nan, 1.0]), 'map', RejectionReason.NOT_FINITE)])
def test_an_initial_pose_must_be_in_map_and_uncertain(block, frame, reason):
    assert refusal_of(incoming.pose_prior, set_pose(block, frame), 'r1', 'map') is reason


NUMBERS = st.floats() | st.floats(-1.0, 1.0)


@given(
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS) | st.just((0.0, 0.0, 0.6, 0.8)),
    st.lists(NUMBERS, min_size=9, max_size=9))
@settings(max_examples=100, deadline=None, derandomize=True)
@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # squares of large numbers
def test_any_odometry_is_valid_or_rejected(xyz, quaternion, block):
    message = odometry_message(0, xyz, quaternion, full(block))
    with suppress(incoming.RejectedError):
        record = incoming.odometry(message, 'r1')

        assert np.isfinite(record.pose).all()
        assert abs(record.pose[2]) < 3.15
        # An eigenvalue may be negative by 1e-9 of the largest.
        eigenvalues = np.linalg.eigvalsh(np.zeros((3, 3)) if record.twist_covariance is None
                                         else record.twist_covariance)
        assert eigenvalues[0] >= -1e-9 * np.abs(eigenvalues).max()
