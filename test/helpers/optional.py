# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Optional dependencies of the tests.

A test module imports them with `optional` and marks what uses them with ``needs`` or ``ros``.
``pytest.importorskip`` at module level is no alternative: ROS's launch_testing imports each test
module in a hook of its own, where the exception skips the whole session.
"""

from importlib import import_module
from importlib.util import find_spec

import pytest


def is_installed(name):
    """Return whether a top-level module is installed."""
    return find_spec(name) is not None


def optional(name):
    """Return a module, or where it needs one that is not installed, a stand-in for collection."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        return Absent


class _Absent(type):
    """All attributes, results and items of the stand-in are itself; as a mapping it is empty."""

    def __getattr__(cls, name):
        if name.startswith('__') or name == 'pytestmark':
            raise AttributeError(name)
        return cls

    def __call__(cls, *_, **__):
        return cls

    def __getitem__(cls, _):
        return cls

    def keys(cls):
        return ()


class Absent(metaclass=_Absent):
    """Stands for a module that is not installed, and for everything in it."""


def _skipped(*_, **__):
    return pytest.mark.skip(reason='hypothesis is not installed')


if is_installed('hypothesis'):
    from hypothesis import given, Phase, settings, stateful, strategies
else:
    given = settings = _skipped
    Phase = stateful = strategies = Absent
