# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A message in its usual encoding is read as rosbags reads it; any other is left to rosbags."""

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3

from fej_slam_ros.ros.messages import decoded, serialize, usual_cdr
from helpers.ros import cloud, odometry_message

TYPES = get_typestore(Stores.ROS2_JAZZY)
ODOMETRY_TYPE = 'nav_msgs/msg/Odometry'
CLOUD_TYPE = 'sensor_msgs/msg/PointCloud2'


def odometry_sample(frame='r1/odom', child='r1/base_link', seed=1):
    """Return a message in which every number differs."""
    numbers = np.random.default_rng(seed).normal(size=(2, 36))
    sample = odometry_message(1_234, (1.5, -2.5, 0.25), (0.1, 0.2, 0.3, 0.9))
    sample.header.frame_id, sample.child_frame_id = frame, child
    sample.pose.covariance, sample.twist.covariance = numbers
    linear, angular = np.split(numbers[0, :6], 2)
    sample.twist.twist.linear = Vector3(*linear)
    sample.twist.twist.angular = Vector3(*angular)
    return sample


# CDR pads what follows a frame to 4 bytes, or to 8: every length of both is another case.
@pytest.mark.parametrize('child', ['b' * k for k in range(9)])
@pytest.mark.parametrize('frame', ['f' * k for k in range(5)] + ['Küche'])
def test_every_field_of_odometry_is_read_whatever_the_length_of_the_frames(frame, child):
    raw = serialize(odometry_sample(frame, child))

    read = usual_cdr.decode_odometry(raw)

    # Serialised by rosbags, it has the same bytes again.
    assert bytes(TYPES.serialize_cdr(read, ODOMETRY_TYPE)) == raw
    assert (read.header.frame_id, read.child_frame_id) == (frame, child)


def test_odometry_in_the_other_byte_order_is_read_in_the_general_way():
    sample = odometry_sample()

    raw = bytes(TYPES.serialize_cdr(sample, ODOMETRY_TYPE, little_endian=False))

    assert usual_cdr.decode_odometry(raw) is None
    assert decoded(raw, ODOMETRY_TYPE).twist.twist.angular.z == sample.twist.twist.angular.z


def test_no_truncated_or_damaged_odometry_is_taken_for_a_whole_one():
    raw = serialize(odometry_sample())

    assert all(usual_cdr.decode_odometry(raw[:size]) is None for size in range(len(raw)))
    assert all(decoded(raw[:size], ODOMETRY_TYPE) is None for size in range(len(raw)))
    # Lengths of the two frames that reach beyond the message, and frames without an end.
    for at, damage in ((12, b'\xff' * 4), (24, b'\xff' * 4), (23, b'x'), (40, b'x')):
        assert usual_cdr.decode_odometry(raw[:at] + damage + raw[at + len(damage):]) is None


def cloud_sample(frame='r1/camera', names=('x', 'y', 'id'), order='<', is_dense=True):
    """Return a cloud of three points in which the numbers differ."""
    numbers = np.random.default_rng(len(names)).normal(size=(max(len(names), 1), 3))
    sample = cloud({name: ('f8', row) for name, row in zip(names or ['x'], numbers)}, order=order)
    sample.header.frame_id, sample.is_dense = frame, is_dense
    if not names:
        sample.fields = []
    return sample


# CDR pads what follows a string to 4 bytes: every length is another case.
@pytest.mark.parametrize('names', [(), *(['f' * k, 'y', 'id'] for k in range(5)), ['Höhe']])
@pytest.mark.parametrize('frame', ['f' * k for k in range(5)] + ['Küche'])
def test_every_field_of_a_cloud_is_read_whatever_the_length_of_the_names(frame, names):
    for order, is_dense in (('<', True), ('>', False)):
        raw = serialize(cloud_sample(frame, names, order, is_dense))

        read = usual_cdr.decode_cloud(raw)

        # Serialised by rosbags, it has the same bytes again.
        assert bytes(TYPES.serialize_cdr(read, CLOUD_TYPE)) == raw
        assert read.header.frame_id == frame
        assert [field.name for field in read.fields] == [*names]


def test_a_cloud_in_the_other_byte_order_is_read_in_the_general_way():
    raw = bytes(TYPES.serialize_cdr(cloud_sample(), CLOUD_TYPE, little_endian=False))

    assert usual_cdr.decode_cloud(raw) is None
    assert decoded(raw, CLOUD_TYPE).width == 3


def test_no_truncated_or_damaged_cloud_is_taken_for_a_whole_one():
    raw = serialize(cloud_sample())

    assert all(usual_cdr.decode_cloud(raw[:size]) is None for size in range(len(raw)))
    assert all(decoded(raw[:size], CLOUD_TYPE) is None for size in range(len(raw)))
    # Lengths of the frame, of the first name and of the data that reach beyond the message, more
    # fields than there are, and a frame and a name without an end.
    first_name, data = raw.index(b'x\0'), len(raw) - 1 - 3 * 24 - 4
    for at, damage in (
            (12, b'\xff' * 4), (first_name - 4, b'\xff' * 4), (data, b'\xff' * 4),
            (first_name - 8, b'\xff' * 4), (25, b'x'), (first_name + 1, b'x')):
        assert raw[at:at + len(damage)] != damage
        assert usual_cdr.decode_cloud(raw[:at] + damage + raw[at + len(damage):]) is None


def test_clouds_share_no_list_of_fields():
    raw = serialize(cloud_sample())

    usual_cdr.decode_cloud(raw).fields.clear()

    assert len(usual_cdr.decode_cloud(raw).fields) == 3
