# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the value of a parameter may be: its type, its shape and its range."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
import re
from typing import Any


@dataclass(frozen=True)
class Range:
    """
    Numbers from a low one to a high one.

    Attributes
    ----------
    low, high : both belong to it
    open : except for low, where this holds

    """

    low: float
    high: float
    open: bool = False

    def __contains__(self, x: Any) -> bool:
        # The comparisons also refuse nan, inf and integers beyond the floats.
        return bool(self.low <= x <= self.high) and not (self.open and x == self.low)

    def __str__(self) -> str:
        form = 'above {} and up to {}' if self.open else 'from {} to {}'
        return form.format(*map(_short, (self.low, self.high)))


def _short(x: float) -> str:
    return str(x) if isinstance(x, int) else re.sub(r'e\+?(-?)0*', r'e\1', f'{x:g}')


@dataclass(frozen=True)
class Kind:
    """
    What a value must be.

    Attributes
    ----------
    expected : ends the sentence "parameter ... must be ..."
    element : type of the value or, in a list, of its elements
    shape : () for one value, (n,) for a list of n, (None,) for a list of any length
    allowed : what must hold of each element
    within : the range of numbers, None of anything else

    """

    expected: str
    element: type
    shape: tuple[int | None, ...] = ()
    allowed: Callable[[Any], object] = lambda _: True
    within: Range | None = None

    def read(self, value: object) -> Any:
        """Return the value as settings hold it, None where it is not of this kind."""
        if not self.shape:
            return self._read_element(value)
        if not isinstance(value, (list, tuple)) or self.shape[0] not in (None, len(value)):
            return None
        elements = tuple(map(self._read_element, value))
        return None if None in elements else elements

    def write(self, value: Any) -> Any:
        """Return the value as ROS takes it; no list mixes integers and floats."""
        return [self.element(v) for v in value] if self.shape else self.element(value)

    def _read_element(self, value: object) -> Any:
        types = (int, float) if self.element is float else (self.element,)
        is_of_type = isinstance(value, types) and isinstance(value, bool) == (self.element is bool)
        return self.element(value) if is_of_type and self.allowed(value) else None


def one_of(names: Collection[str]) -> Kind:
    """Return the kind of a value that is one of some names."""
    return Kind('one of ' + ', '.join(map(repr, names)), str, allowed=names.__contains__)


def numbers(
    noun: str, within: Range, shape: tuple[int, ...] = (), element: type = float
) -> Kind:
    """Return the kind of numbers in a range."""
    return Kind(f'{noun} {within}', element, shape, within.__contains__, within)


SIGMA = Range(0, 1e6)
NOT_NEGATIVE = numbers('a number', Range(0, 1e9))
PERIOD = numbers('a number', Range(0.01, 1e6))
PROBABILITY = numbers('a number', Range(0, 1, open=True))
POSE = numbers('three numbers [x, y, yaw]', Range(-1e9, 1e9), (3,))
POSE_SIGMA = numbers('three numbers [x, y, yaw]', SIGMA, (3,))
# Zero would make the covariance of an observation singular.
POINT_SIGMA = numbers('two numbers [x, y]', replace(SIGMA, low=1e-6), (2,))
NOISE_SCALE = numbers('a number', Range(1e-3, 1e3))
# One landmark that both know does not tell a heading.
AT_LEAST_TWO = numbers('an integer', Range(2, 1000), element=int)
# Zero leaves it to the filter.
ITERATIONS = numbers('an integer', Range(0, 100), element=int)
# Clouds carry it as an int32 in which -1 means unknown.
IDENTITY = numbers('an integer', Range(0, 2**31 - 1), element=int)
FLAG = Kind('true or false', bool)
# What YAML writes as it stands.
TEXT = Kind(
    'one line of text', str, allowed=re.compile(r'[^\x00-\x1f\x7f-\x9f\u2028\u2029]*').fullmatch
)
TEXTS = Kind('a list of texts', str, (None,))
NAMES = Kind(
    'a list of names that begin with a letter and go on with letters, digits and _',
    str,
    (None,),
    re.compile('[A-Za-z][A-Za-z0-9_]*').fullmatch,
)
