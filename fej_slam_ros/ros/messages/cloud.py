# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PointCloud2 to columns of numbers and back, for any layout and byte order."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__PointCloud2 as PointCloud2, sensor_msgs__msg__PointField as PointField)

from fej_slam_ros.ros.messages.common import header
from fej_slam_ros.ros.messages.usual_cdr import MAX_LAYOUTS

#: Numpy types by PointField's type codes, and back.
DATATYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
CODES = {name: code for code, name in DATATYPES.items()}

#: Fields of the coordinates in float64, beside x and y in float32 that RViz draws.
EXACT_POINT = ('x_f64', 'y_f64')

#: Maximum bytes of a point, those of a type of numpy.
MAX_POINT_STEP = 2**31 - 1

#: Values of each field, one number per point.
Columns = dict[str, NDArray[np.generic]]


class BadCloudError(ValueError):
    """Fields or sizes of a cloud contradict each other, or a type is unknown."""


def cloud_size(raw: bytes) -> tuple[int, int]:
    """Return the numbers of points and fields in the header of a cloud, or raise BadCloudError."""
    order = '<' if raw[1:2] == b'\1' else '>'
    try:
        # After 4 bytes on the encoding: stamp, and the frame, a string padded to 4 bytes.
        (length,) = struct.unpack_from(order + 'I', raw, 12)
        height, width, fields = struct.unpack_from(order + '3I', raw, 16 + (length + 3) // 4 * 4)
    except struct.error as error:
        raise BadCloudError('too short') from error
    return height * width, fields


def read_cloud(cloud: PointCloud2, names: Sequence[str]) -> Columns:
    """Return the columns with the given names that a cloud has, one number per point."""
    shape = int(cloud.height), int(cloud.width)
    data = np.asarray(cloud.data, dtype=np.uint8)
    if len(data) != cloud.row_step * cloud.height or cloud.row_step < cloud.point_step * shape[1]:
        raise BadCloudError('sizes do not match')
    if cloud.point_step > MAX_POINT_STEP:
        raise BadCloudError('points are too large')
    point = _point(
        tuple([
            (field.name, field.datatype, field.offset) for field in cloud.fields
            if field.name in names]),
        '>' if cloud.is_bigendian else '<', cloud.point_step)
    points = np.empty(0, point) if 0 in (*shape, cloud.point_step) else np.ndarray(
        shape, point, data.data, 0, (cloud.row_step, cloud.point_step)).reshape(-1)
    return {name: points[name] for name in point.names or ()}


@lru_cache(MAX_LAYOUTS)
def _point(fields: tuple[tuple[str, int, int], ...], order: str, size: int) -> np.dtype[np.void]:
    """Return the type of a point of some bytes from name, type code and offset of its fields."""
    types: dict[str, tuple[str, int]] = {}
    for name, datatype, offset in fields:
        if datatype not in DATATYPES:
            raise BadCloudError(f'unknown type of field {name}')
        types[name] = order + DATATYPES[datatype], offset
        if offset + np.dtype(types[name][0]).itemsize > size:
            raise BadCloudError(f'field {name} reaches beyond its point')
    formats, offsets = zip(*types.values()) if types else ((), ())
    return np.dtype({
        'names': [*types], 'formats': formats, 'offsets': offsets, 'itemsize': size})


def make_cloud(
    stamp: int, frame: str, columns: Mapping[str, tuple[str, NDArray[np.generic]]]
) -> PointCloud2:
    """
    Return a cloud of the given columns.

    Parameters
    ----------
    stamp, frame : of the header
    columns : for each field its name, numpy type code without byte order, and values (n,)

    """
    layout = np.dtype([(name, '<' + code) for name, (code, _) in columns.items()])
    length = len(next(iter(columns.values()))[1])
    points = np.empty(length, dtype=layout)
    for name, (_, values) in columns.items():
        points[name] = values
    offsets: Any = layout.fields
    fields = [
        PointField(name=name, offset=offsets[name][1], datatype=CODES[code], count=1)
        for name, (code, _) in columns.items()]
    return PointCloud2(
        header=header(stamp, frame), height=1, width=length, fields=fields, is_bigendian=False,
        point_step=layout.itemsize, row_step=layout.itemsize * length,
        data=np.frombuffer(points.tobytes(), dtype=np.uint8), is_dense=True)
