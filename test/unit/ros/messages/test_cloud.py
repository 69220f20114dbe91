# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of any layout are read exactly; contradicting layouts are rejected."""

from itertools import permutations, product

import numpy as np
import pytest

from fej_slam_ros.ros.messages.cloud import BadCloudError, cloud_size, make_cloud, read_cloud
from helpers.optional import given, settings, strategies as st
from helpers.ros import cdr, cloud, DATATYPES, empty_cloud, through_cdr

#: Exact in float32, too.
COLUMNS = {
    'x': ('f8', [1.5, -2.25, 3.0, 0.125]), 'y': ('f4', [0.5, 4.0, -8.0, 2.0]),
    'id': ('i4', [7, -1, 2**31 - 1, 0])}


def assert_columns(columns, expected):
    assert columns.keys() == expected.keys()
    for name, (_, values) in expected.items():
        np.testing.assert_array_equal(columns[name], values)


@pytest.mark.parametrize(
    ('order', 'pad', 'rows', 'row_pad'), [*product('<>', (0, 3), (1, 2, 4), (0, 5))])
def test_byte_order_and_padding_do_not_matter(order, pad, rows, row_pad):
    message = cloud(COLUMNS, order=order, pad=pad, rows=rows, row_pad=row_pad)

    assert_columns(read_cloud(through_cdr(message), tuple(COLUMNS)), COLUMNS)


@pytest.mark.parametrize('names', [*permutations(COLUMNS)])
def test_the_order_of_the_fields_does_not_matter(names):
    message = cloud({name: COLUMNS[name] for name in names})

    assert_columns(read_cloud(message, tuple(COLUMNS)), COLUMNS)


@pytest.mark.parametrize('code', DATATYPES)
def test_every_number_type_is_read(code):
    numbers = {'x': (code, [0, 1, 100])}

    assert_columns(read_cloud(cloud(numbers, order='>'), ['x']), numbers)


def test_other_columns_may_be_of_any_type():
    message = cloud(COLUMNS | {'rgb': ('u4', [0, 1, 2, 3])})
    message.fields[-1].datatype = 99

    assert_columns(read_cloud(message, tuple(COLUMNS)), COLUMNS)


@pytest.mark.parametrize('rows', [1, 0])
def test_a_cloud_without_points_has_empty_columns(rows):
    message = cloud({name: (code, []) for name, (code, _) in COLUMNS.items()})
    message.height = rows
    message.row_step = 0

    assert_columns(read_cloud(message, tuple(COLUMNS)), {name: ('', []) for name in COLUMNS})


def test_a_cloud_as_constructed_has_no_columns():
    assert read_cloud(through_cdr(empty_cloud()), ['x', 'y']) == {}


@pytest.mark.parametrize(
    ('attribute', 'value'),
    [
        ('row_step', 63), ('row_step', 65), ('row_step', 0), ('row_step', 2**32 - 1),
        ('point_step', 17), ('point_step', 15), ('point_step', 0), ('point_step', 2**32 - 1),
        ('height', 0), ('height', 2), ('height', 2**32 - 1), ('width', 5), ('width', 2**32 - 1),
        ('data', np.zeros(63, np.uint8)), ('data', np.zeros(65, np.uint8)),
        ('data', np.zeros(0, np.uint8))])
def test_contradicting_sizes_are_rejected(attribute, value):
    message = cloud(COLUMNS)
    setattr(message, attribute, value)

    with pytest.raises(BadCloudError):
        read_cloud(message, tuple(COLUMNS))


@pytest.mark.parametrize('rows', [0, 1])
def test_points_that_are_too_large_are_rejected_even_if_there_are_none(rows):
    message = cloud({name: (code, []) for name, (code, _) in COLUMNS.items()})
    message.height, message.row_step, message.point_step = rows, 0, 2**31

    with pytest.raises(BadCloudError):
        read_cloud(message, tuple(COLUMNS))


def test_points_without_bytes_have_no_columns_however_many_they_are():
    message = empty_cloud()
    message.height = message.width = 2**32 - 1

    assert read_cloud(message, ['x']) == {}


@pytest.mark.parametrize(
    ('attribute', 'value'),
    [('offset', 9), ('offset', 2**32 - 1), ('datatype', 0), ('datatype', 9), ('datatype', 255)])
def test_a_field_beyond_its_point_or_of_unknown_type_is_rejected(attribute, value):
    message = cloud(COLUMNS)
    setattr(message.fields[0], attribute, value)

    with pytest.raises(BadCloudError):
        read_cloud(message, tuple(COLUMNS))


@given(st.lists(st.tuples(st.floats(), st.integers(-2**31, 2**31 - 1)), max_size=5))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_written_cloud_is_packed_and_keeps_every_bit(points):
    x = np.array([number for number, _ in points], dtype=float)
    ids = np.array([number for _, number in points], dtype=int)

    message = through_cdr(make_cloud(5, 'map', {'x': ('f8', x), 'id': ('i4', ids)}))

    layout = np.dtype([('x', '<f8'), ('id', '<i4')])
    points_read = np.frombuffer(message.data.tobytes(), dtype=layout)
    assert points_read['x'].tobytes() == x.tobytes()
    np.testing.assert_array_equal(points_read['id'], ids)
    assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
        ('x', 0, 8, 1), ('id', 8, 5, 1)]
    assert (message.point_step, message.row_step, message.height, message.width) == (
        12, 12 * len(points), 1, len(points))


@pytest.mark.parametrize('frame', ['', 'a', 'r1/base_link', 'map_'])
@pytest.mark.parametrize('rows', [1, 2])
def test_the_size_of_a_serialised_cloud_is_read_from_its_header(frame, rows):
    message = cloud({name: (code, [1] * 6) for name, (code, _) in COLUMNS.items()}, 5, frame,
                    rows=rows)
    raw = cdr(message)

    assert cloud_size(raw) == cloud_size(raw[:60 + len(frame)]) == (6, len(COLUMNS))


@pytest.mark.parametrize('length', [0, 3, 15, 20, 25])
def test_a_message_shorter_than_its_header_has_no_size(length):
    with pytest.raises(BadCloudError):
        cloud_size(cdr(cloud(COLUMNS, frame='r1/base_link'))[:length])
