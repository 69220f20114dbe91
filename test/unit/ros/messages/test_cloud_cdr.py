# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A cloud in its usual encoding is read as rosbags reads it; any other is left to rosbags."""

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from fej_slam_ros.ros.messages import cloud_cdr, decoded, serialize
from helpers.ros import cloud

TYPES = get_typestore(Stores.ROS2_JAZZY)
TYPE = 'sensor_msgs/msg/PointCloud2'


def message(frame='r1/camera', names=('x', 'y', 'id'), order='<', is_dense=True):
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
def test_every_field_is_read_whatever_the_length_of_the_names(frame, names):
    for order, is_dense in (('<', True), ('>', False)):
        raw = serialize(message(frame, names, order, is_dense))

        read = cloud_cdr.read(raw)

        # Serialised by rosbags, it has the same bytes again.
        assert bytes(TYPES.serialize_cdr(read, TYPE)) == raw
        assert read.header.frame_id == frame
        assert [field.name for field in read.fields] == [*names]


def test_a_message_in_the_other_byte_order_is_read_in_the_general_way():
    raw = bytes(TYPES.serialize_cdr(message(), TYPE, little_endian=False))

    assert cloud_cdr.read(raw) is None
    assert decoded(raw, TYPE).width == 3


def test_no_truncated_or_damaged_message_is_taken_for_a_whole_one():
    raw = serialize(message())

    assert all(cloud_cdr.read(raw[:size]) is None for size in range(len(raw)))
    assert all(decoded(raw[:size], TYPE) is None for size in range(len(raw)))
    # Lengths of the frame, of the first name and of the data that reach beyond the message, more
    # fields than there are, and a frame and a name without an end.
    first_name, data = raw.index(b'x\0'), len(raw) - 1 - 3 * 24 - 4
    for at, damage in (
            (12, b'\xff' * 4), (first_name - 4, b'\xff' * 4), (data, b'\xff' * 4),
            (first_name - 8, b'\xff' * 4), (25, b'x'), (first_name + 1, b'x')):
        assert raw[at:at + len(damage)] != damage
        assert cloud_cdr.read(raw[:at] + damage + raw[at + len(damage):]) is None


def test_messages_share_no_list_of_fields():
    raw = serialize(message())

    cloud_cdr.read(raw).fields.clear()

    assert len(cloud_cdr.read(raw).fields) == 3
