# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names have IDs that depend on nothing else, and never two the same one."""

from zlib import crc32

import pytest

from fej_slam_ros.ros.session.landmark_ids import LandmarkIds, MAX_NAMES, number_of


@pytest.mark.parametrize(
    ('name', 'number'),
    [('4', 4), ('tag36h11:4', 4), ('a:b:04', 4), ('tag4', None), ('tag:', None), ('-4', None),
     ('4 ', None), ('12345678901', None), ('', None)])
def test_the_number_of_a_name_is_what_it_is_or_ends_with(name, number):
    assert number_of(name) == number


def test_a_name_without_number_has_its_checksum_beyond_the_numbers_of_tags():
    ids = LandmarkIds({})

    assert ids.assign(['dock']) == [2**30 + crc32(b'dock') % 2**30]
    assert ids.assign(['dock', '']) == [*ids.assign(['dock']), -1]


def test_of_names_with_one_id_none_has_one():
    ids = LandmarkIds({})

    assert ids.assign(['a:7']) == [7]
    assert ids.assign(['b:7', 'a:7', 'c:7']) == [None, None, None]
    assert ids.conflicts == {'a:7', 'b:7', 'c:7'}


def test_a_given_id_stays_with_its_name():
    ids = LandmarkIds({'b:7': 7, 'dock': 1})

    assert ids.assign(['a:7', 'b:7', 'dock', 'a:1']) == [None, 7, 1, None]


def test_an_id_beyond_those_of_messages_is_none():
    assert LandmarkIds({}).assign(['2147483647', '2147483648']) == [2147483647, None]


def test_the_number_of_names_is_bounded():
    ids = LandmarkIds({})

    ids.assign([str(k) for k in range(3 * MAX_NAMES)])

    assert len(ids.by_name) == len(ids.conflicts) == MAX_NAMES
    assert ids.assign([str(MAX_NAMES + 1), '5']) == [None, 5]
