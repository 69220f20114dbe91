# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kinds accept values of one type, shape and range, and describe them."""

from dataclasses import dataclass
import math

import pytest

from fej_slam_ros.core.parameter_kinds import (
    FLAG, numbers, one_of, parameter, parameters_of, POSE, PROBABILITY, Range)


@pytest.mark.parametrize(('limits', 'text'), [
    (Range(0, 1e9), 'from 0 to 1e9'), (Range(1e-6, 2.5), 'from 1e-6 to 2.5'),
    (Range(0, 1, excludes_low=True), 'above 0 and up to 1')])
def test_a_range_is_described_in_words(limits, text):
    assert str(limits) == text


@pytest.mark.parametrize('x', [math.nan, math.inf, -1, 10**400])
def test_a_range_does_not_contain_numbers_outside_or_without_value(x):
    assert x not in Range(0, 1e9)


def test_integers_are_read_as_floats_but_booleans_are_not():
    assert type(PROBABILITY.read(1)) is float
    assert PROBABILITY.read(True) is None
    assert FLAG.read(1) is None


def test_lists_have_the_length_of_the_kind():
    assert POSE.read([1, 2.5, 3]) == (1.0, 2.5, 3.0)
    assert POSE.read([1.0, 2.0]) is None
    assert POSE.write((1, 2, 3)) == [1.0, 2.0, 3.0]


def test_a_choice_accepts_only_its_names():
    kind = one_of('a', 'b')

    assert (kind.read('b'), kind.read('c'), kind.expected) == ('b', None, "one of 'a', 'b'")


def test_a_field_declares_kind_help_unit_and_default():
    @dataclass(frozen=True)
    class Example:
        delay: float = parameter(0.5, numbers('a number', Range(0, 1)), 'maximum delay', 's')
        other: int = 3

    declared = parameters_of(Example)

    assert Example().delay == 0.5
    assert {name: str(p) for name, p in declared.items()} == {
        'delay': 'maximum delay [s]; default: 0.5'}
