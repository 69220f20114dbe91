# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Deserialisation of sensor_msgs/PointCloud2 in its usual encoding, in a quarter of rosbags' time.

The scans of a robot have the same fields, whose bytes are read once.
"""

from functools import lru_cache
from struct import error, Struct

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time, sensor_msgs__msg__PointCloud2 as PointCloud2,
    sensor_msgs__msg__PointField as PointField, std_msgs__msg__Header as Header)

from fej_slam_ros.ros.messages.odometry_cdr import LITTLE_ENDIAN

#: Stamp and length of the frame; height, width and number of fields; length of a field's name; its
#: offset, type and count; byte order, sizes of a point, of a row and of all.
_HEAD, _SHAPE, _LENGTH = Struct('<iII'), Struct('<III'), Struct('<I')
_FIELD, _SIZES = Struct('<IB3xI'), Struct('<B3xIII')
#: Number of layouts that are kept: robots of a team may have different detectors.
MAX_LAYOUTS = 256
#: Maximum bytes of the fields of such a layout.
MAX_LAYOUT_BYTES = 4096


def read(raw: bytes) -> PointCloud2 | None:
    """Return the message in CDR bytes, None if they must be read in the general way."""
    if raw[:4] != LITTLE_ENDIAN:
        return None
    try:
        sec, nanosec, length = _HEAD.unpack_from(raw, 4)
        frame = raw[16:16 + length]
        fields_at = 16 + _padded(length) + _SHAPE.size
        height, width, count = _SHAPE.unpack_from(raw, fields_at - _SHAPE.size)
        at = fields_at
        for _ in range(count):
            at += _LENGTH.size + _padded(*_LENGTH.unpack_from(raw, at)) + _FIELD.size
        is_bigendian, point_step, row_step, size = _SIZES.unpack_from(raw, at)
    except error:
        return None
    data_at = at + _SIZES.size
    end = data_at + size
    fields = _fields(raw[fields_at:at]) if at - fields_at <= MAX_LAYOUT_BYTES else None
    if fields is None or len(raw) != end + 1 or frame[-1:] != b'\0':
        return None
    return PointCloud2(
        Header(Time(sec, nanosec), frame[:-1].decode()), height, width, [*fields],
        bool(is_bigendian), point_step, row_step, np.frombuffer(raw, np.uint8, size, data_at),
        bool(raw[end]))


@lru_cache(MAX_LAYOUTS)
def _fields(raw: bytes) -> tuple[PointField, ...] | None:
    """Return the fields in their CDR bytes, which are whole; None if a name has no end."""
    fields, at = [], 0
    while at < len(raw):
        (length,) = _LENGTH.unpack_from(raw, at)
        at += _LENGTH.size
        name = raw[at:at + length]
        at += _padded(length)
        if name[-1:] != b'\0':
            return None
        fields.append(PointField(name[:-1].decode(), *_FIELD.unpack_from(raw, at)))
        at += _FIELD.size
    return tuple(fields)


def _padded(length: int) -> int:
    """Return the length of a string with the padding to what follows it."""
    return -(-length // 4) * 4
