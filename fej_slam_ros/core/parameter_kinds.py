# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Type, shape and range of parameter values, declared as metadata of dataclass fields."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
import json
import re
from typing import Any


#: Maximum length of the name of a robot: two of them fit into the name of a topic, which has at
#: most 247 characters in ROS, and one into that of a file.
MAX_NAME = 64
#: Maximum length of the name of a frame.
MAX_FRAME = 255


@dataclass(frozen=True)
class Range:
    """Numbers from low to high, both included unless `excludes_low`."""

    low: float
    high: float
    excludes_low: bool = False

    def __contains__(self, x: Any) -> bool:
        # The comparisons also reject nan, inf and integers beyond the floats.
        return bool(self.low <= x <= self.high) and not (self.excludes_low and x == self.low)

    def __str__(self) -> str:
        form = 'above {} and up to {}' if self.excludes_low else 'from {} to {}'
        return form.format(*map(_short, (self.low, self.high)))


def _short(x: float) -> str:
    return str(x) if isinstance(x, int) else re.sub(r'e\+?(-?)0*', r'e\1', f'{x:g}')


@dataclass(frozen=True)
class Kind:
    """Type, shape and constraint of a parameter value."""

    expected: str  #: end of the sentence "parameter ... must be ..."
    element: type  #: type of the value or, in a list, of its elements
    #: () for a single value, (n,) for a list of n, (None,) for a list of any length
    shape: tuple[int | None, ...] = ()
    allowed: Callable[[Any], object] = lambda _: True  #: predicate of each element
    within: Range | None = None  #: range of a number, None for other types
    angles: int = 0  #: number of elements at the end of a list that are angles [rad]

    def read(self, value: object) -> Any:
        """Return the value as the settings store it, None if it is not of this kind."""
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


def one_of(*names: str) -> Kind:
    """Return the kind of a value that is one of several names."""
    return Kind('one of ' + ', '.join(map(repr, names)), str, allowed=names.__contains__)


def numbers(noun: str, within: Range, shape: tuple[int, ...] = (), element: type = float) -> Kind:
    """Return the kind of numbers in a range."""
    return Kind(f'{noun} {within}', element, shape, within.__contains__, within)


SIGMA = Range(0, 1e6)
NOT_NEGATIVE = numbers('a number', Range(0, 1e9))
POSITIVE = numbers('a number', Range(0, 1e9, excludes_low=True))
PERIOD = numbers('a number', Range(0.01, 1e6))
PROBABILITY = numbers('a number', Range(0, 1, excludes_low=True))
POSE = replace(numbers('three numbers [x, y, yaw]', Range(-1e9, 1e9), (3,)), angles=1)
POSE_SIGMA = numbers('three numbers [x, y, yaw]', SIGMA, (3,))
# Zero would make the covariance of an observation singular.
POINT_SIGMA = numbers('two numbers [x, y]', replace(SIGMA, low=1e-6), (2,))
#: Largest noise scale, and inverse of the smallest.
MAX_NOISE_SCALE = 1e3
NOISE_SCALE = numbers('a number', Range(1.0 / MAX_NOISE_SCALE, MAX_NOISE_SCALE))
#: Largest growth of noise [1/m]; noise proportional to the range has no finite one.
MAX_NOISE_GROWTH = 10.0
NOISE_GROWTH = numbers('a number', Range(0, MAX_NOISE_GROWTH))
ODOMETRY_SCALE = numbers('two numbers [distance, turn]', Range(0.1, 10), (2,))
TURN_BIAS = numbers('a number', Range(-10, 10))
RANGE_SCALE = numbers('a number', Range(0.1, 10))
SENSOR_DELAY = numbers('a number', Range(-10, 10))
BEARING_BIAS = numbers('a number', Range(-3.2, 3.2))
# Clouds carry IDs as int32, in which -1 means unknown.
ROBOT_ID = numbers('an integer', Range(0, 2**31 - 1), element=int)
FLAG = Kind('true or false', bool)
# Text that YAML writes without escapes.
TEXT_PATTERN = r'[^\x00-\x1f\x7f-\x9f\u2028\u2029]*'
TEXT = Kind('one line of text', str, allowed=re.compile(TEXT_PATTERN).fullmatch)
# Only shells replace ~.
PATH = replace(
    TEXT, expected="a path that does not begin with '~', in one line",
    allowed=re.compile(f'(?!~){TEXT_PATTERN}').fullmatch)
FRAME = Kind(
    "a frame name without spaces and leading '/'", str,
    allowed=re.compile(rf'(?!/)[^\s\x00-\x1f\x7f-\x9f]{{1,{MAX_FRAME}}}').fullmatch)
TEXTS = Kind('a list of texts, numbers in quotes', str, (None,))
ROBOT_NAMES = Kind(
    'a list of names that begin with a letter and go on with letters, digits and _', str, (None,),
    re.compile(f'[A-Za-z][A-Za-z0-9_]{{,{MAX_NAME - 1}}}').fullmatch)


@dataclass(frozen=True)
class Parameter:
    """Description of one parameter."""

    kind: Kind  #: type, shape and constraint of its value
    help: str  #: description for the user
    unit: str = ''
    default: str = ''  #: default in words, where it is not the default of the field
    changeable: bool = False  #: whether it can change during a run of the estimator

    @property
    def metadata(self) -> Mapping[str, 'Parameter']:
        """Return metadata for the dataclass field that holds the value."""
        return {'parameter': self}

    def __str__(self) -> str:
        """Return one line of help, unit and default."""
        unit = f' [{self.unit}]' if self.unit else ''
        return f'{self.help}{unit}; default: {self.default}'


def parameter(
    value: Any, kind: Kind, help: str, unit: str = '', default: str = '',  # noqa: A002
    *, changeable: bool = False,
) -> Any:
    """Return a dataclass field with a default value that is also a parameter."""
    return field(default=value, metadata=Parameter(kind, help, unit, default, changeable).metadata)


def parameters_of(settings: type) -> dict[str, Parameter]:
    """Return the parameters that a dataclass declares, by the names of its fields."""
    declared = {f.name: f for f in fields(settings) if 'parameter' in f.metadata}
    return {
        name: replace(p, default=p.default or json.dumps(f.default, ensure_ascii=False))
        for name, f in declared.items() for p in [f.metadata['parameter']]}
