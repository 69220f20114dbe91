# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All that an estimator holds, as plain data and back: restored is continued, bit for bit.

Objects of the core are taken apart into their attributes, whatever these are, so that nothing is
forgotten; anything else that has no plain form is an error. Settings are not kept but given anew.

What is plain is itself: None, numbers, texts, lists and arrays. All else is an object of one
entry, whose key tells what it is.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Iterable
from enum import Enum
from importlib import import_module
from types import NoneType
from typing import Any

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.settings import Settings

Plain = Any

CORE = 'fej_slam_ros.core.'
PLAIN = {NoneType, bool, int, float, str, np.ndarray}
SEQUENCES: dict[str, Any] = {'tuple': tuple, 'set': set}
MAPPINGS: dict[str, Any] = {'dict': dict, 'Counter': Counter}
#: What a defaultdict may be filled up with.
FACTORIES: dict[str, Any] = {'list': list, 'Counter': Counter}


def snapshot(estimator: Estimator) -> Plain:
    """Return all that an estimator holds but its settings; arrays are not copied."""
    return _Taker(estimator.settings).plain(estimator)


def restore(kept: Plain, settings: Settings) -> Estimator:
    """Return an estimator that goes on where a snapshot was taken, under the same settings."""
    estimator: Estimator = _Giver(settings).value(kept)
    estimator.resume()
    return estimator


class _Taker:
    """Values to plain data; an object that is met again is named by its number."""

    def __init__(self, settings: Settings) -> None:
        self._numbers = {id(known): k for k, known in enumerate((settings, *settings.robots))}

    def plain(self, value: Any) -> Plain:
        if type(value) in PLAIN:
            return value
        if isinstance(value, list):
            return self._each(value)
        if isinstance(value, Enum):
            return {'enum': [_name(type(value)), value.value]}
        if isinstance(value, deque):
            return {'deque': [value.maxlen, self._each(value)]}
        if isinstance(value, defaultdict):
            factory = next(n for n, f in FACTORIES.items() if f is value.default_factory)
            return {'defaultdict': [factory, self._pairs(value)]}
        if isinstance(value, Covariance):
            return {'covariance': [*value.packed()]}
        name = type(value).__name__
        if name in SEQUENCES:
            return {name: self._each(value)}
        return {name: self._pairs(value)} if name in MAPPINGS else self._object(value)

    def _object(self, value: object) -> Plain:
        if id(value) in self._numbers:
            return {'same': self._numbers[id(value)]}
        self._numbers[id(value)] = len(self._numbers)
        name = _name(type(value))
        attributes = getattr(type(value), '__slots__', None) or vars(value)
        return {'object': [name, {a: self.plain(getattr(value, a)) for a in attributes}]}

    def _each(self, values: Iterable[object]) -> list[Plain]:
        return [self.plain(value) for value in values]

    def _pairs(self, values: dict[Any, Any]) -> list[Plain]:
        return [[self.plain(key), self.plain(value)] for key, value in values.items()]


class _Giver:
    """The way back, which meets the objects in the same order."""

    def __init__(self, settings: Settings) -> None:
        self._objects: list[Any] = [settings, *settings.robots]

    def value(self, plain: Plain) -> Any:
        if isinstance(plain, list):
            return self._each(plain)
        if not isinstance(plain, dict):
            return plain
        (kind, content), = plain.items()
        if kind in SEQUENCES:
            return SEQUENCES[kind](self._each(content))
        if kind in MAPPINGS:
            return MAPPINGS[kind](dict(self._each(content)))
        match kind, content:
            case 'enum', [name, value]:
                return _class(name)(value)
            case 'deque', [maxlen, values]:
                return deque(self._each(values), maxlen)
            case 'defaultdict', [factory, pairs]:
                return defaultdict(FACTORIES[factory], self._each(pairs))
            case 'covariance', [capacity, triangle]:
                covariance = Covariance()
                covariance.unpack(capacity, triangle)
                return covariance
            case 'same', number:
                return self._objects[number]
        return self._object(*content)

    def _object(self, name: str, attributes: dict[str, Plain]) -> Any:
        cls = _class(name)
        value = cls.__new__(cls)
        self._objects.append(value)
        for attribute, plain in attributes.items():
            # Records are frozen for everybody else.
            object.__setattr__(value, attribute, self.value(plain))
        return value

    def _each(self, plains: list[Plain]) -> list[Any]:
        return [self.value(plain) for plain in plains]


def _name(cls: type) -> str:
    if not cls.__module__.startswith(CORE):
        raise TypeError(f'an estimator holds a {cls.__qualname__}, which has no plain form')
    return f'{cls.__module__.removeprefix(CORE)}.{cls.__qualname__}'


def _class(name: str) -> Any:
    module, _, qualname = name.rpartition('.')
    return getattr(import_module(f'{CORE}{module}'), qualname)
