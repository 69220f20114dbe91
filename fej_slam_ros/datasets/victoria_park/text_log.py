# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park as the text files of RFS-SLAM.

``inputs.dat``, ``measurements.dat`` and ``gps.dat`` have the rows of the original log with times
in seconds after its first fix; east and north are turned and shifted. Scans without trees have no
row.
"""

from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.datasets.file_checks import errors_name, require_finite
from fej_slam_ros.datasets.victoria_park.raw_log import (
    fixes, increasing_stamps, RawLog, require_possible, TreeScans, wheels)
from fej_slam_ros.errors import UserError

WHEELS, TREES, FIXES = 'inputs.dat', 'measurements.dat', 'gps.dat'
#: Time of the first fix of the original log [ms].
FIRST_FIX = 20_967.0


def is_in(folder: Path) -> bool:
    """Return whether a folder has one of the files."""
    return any((folder / name).is_file() for name in (WHEELS, TREES, FIXES))


def read(folder: Path) -> RawLog:
    """Return the log in a folder, with the stamps of the original log and without tree IDs."""
    with errors_name(folder / WHEELS):
        of_wheels = wheels(*_columns(folder / WHEELS, 3))
    with errors_name(folder / TREES):
        time, ranges, bearings, _ = _columns(folder / TREES, 4)
        require_possible(ranges, bearings)
        starts = np.flatnonzero(np.diff(time, prepend=-np.inf))
        trees = TreeScans(
            increasing_stamps(time[starts]), np.append(starts, len(time)), ranges, bearings,
            np.full(len(time), NO_ID))
    with errors_name(folder / FIXES):
        of_antenna = fixes(*_columns(folder / FIXES, 3))
    return RawLog(of_wheels, trees, of_antenna)


def _columns(path: Path, count: int) -> list[Array]:
    """Return the columns of a table of numbers; the first is the time [ms]."""
    try:
        rows = np.array([line.split() for line in path.read_text('ascii').splitlines()], float)
        rows = rows.reshape(len(rows), count)
    except ValueError as error:
        raise UserError(f'cannot be read as a table ({error})') from error
    require_finite(rows)
    time, *others = rows.T
    return [np.rint(1000.0 * time) + FIRST_FIX, *others]
