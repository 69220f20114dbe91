# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Choice of the kernel: the compiled one where it was built, else numpy.

Both compute the same within rounding, so results are repeatable bit for bit within each. The
environment variable FEJ_SLAM_KERNEL, ``numpy`` or ``compiled``, overrides the choice.
"""

from importlib import import_module
from importlib.util import find_spec
import os
from types import ModuleType
from typing import TYPE_CHECKING

from fej_slam_ros.errors import UsageError

VARIABLE = 'FEJ_SLAM_KERNEL'
PACKAGE = __name__.rpartition('.')[0]


def load(name: str) -> ModuleType:
    """Return a kernel by its name, by default the fastest that is installed."""
    built = ['compiled', 'numpy'] if find_spec(f'{PACKAGE}._kernel') else ['numpy']
    if name and name not in built:
        raise UsageError(f'{VARIABLE} is {name}; installed here: {", ".join(built)}')
    return import_module(f'{PACKAGE}.{name or built[0]}_kernel')


if not TYPE_CHECKING:
    KERNEL = load(os.environ.get(VARIABLE, ''))
else:
    # Each kernel has the functions and constants of this one, which describes them.
    from fej_slam_ros.core.ekf import numpy_kernel
    KERNEL = numpy_kernel
