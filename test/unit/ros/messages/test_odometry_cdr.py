# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry in its usual encoding is read as rosbags reads it; any other is left to rosbags."""

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3

from fej_slam_ros.ros.messages import decoded, odometry_cdr, serialize
from helpers.ros import odometry_message

TYPES = get_typestore(Stores.ROS2_JAZZY)
TYPE = 'nav_msgs/msg/Odometry'


def message(frame='r1/odom', child='r1/base_link', seed=1):
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
def test_every_field_is_read_whatever_the_length_of_the_frames(frame, child):
    raw = serialize(message(frame, child))

    read = odometry_cdr.read(raw)

    # Serialised by rosbags, it has the same bytes again.
    assert bytes(TYPES.serialize_cdr(read, TYPE)) == raw
    assert (read.header.frame_id, read.child_frame_id) == (frame, child)


def test_a_message_in_the_other_byte_order_is_read_in_the_general_way():
    raw = bytes(TYPES.serialize_cdr(message(), TYPE, little_endian=False))

    assert odometry_cdr.read(raw) is None
    assert decoded(raw, TYPE).twist.twist.angular.z == message().twist.twist.angular.z


def test_no_truncated_or_damaged_message_is_taken_for_a_whole_one():
    raw = serialize(message())

    assert all(odometry_cdr.read(raw[:size]) is None for size in range(len(raw)))
    assert all(decoded(raw[:size], TYPE) is None for size in range(len(raw)))
    # Lengths of the two frames that reach beyond the message, and frames without an end.
    for at, damage in ((12, b'\xff' * 4), (24, b'\xff' * 4), (23, b'x'), (40, b'x')):
        assert odometry_cdr.read(raw[:at] + damage + raw[at + len(damage):]) is None
