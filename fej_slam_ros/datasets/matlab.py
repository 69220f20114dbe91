# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numeric matrices in MATLAB files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.datasets.file_checks import require_finite
from fej_slam_ros.errors import UserError


def matrices(path: Path, columns: Mapping[str, int]) -> dict[str, Array]:
    """Return the matrices in a file, as far as it has them, by names and numbers of columns."""
    try:
        variables = loadmat(path, variable_names=list(columns))
    # scipy has no common exception for damaged files; five types have been observed.
    except Exception as error:
        raise UserError(f'cannot be read as a MATLAB file ({error})') from error
    return {
        name: _matrix(name, variables[name], count)
        for name, count in columns.items() if name in variables}


def required_matrices(path: Path, columns: Mapping[str, int]) -> dict[str, Array]:
    """Return the named matrices, as `matrices` does; raise a `UserError` if one is missing."""
    result = matrices(path, columns)
    if missing := [name for name in columns if name not in result]:
        raise UserError(f'it lacks the variables {", ".join(missing)}')
    return result


def joined_rows(names: Array, values: Array, count: int) -> tuple[Array, Array]:
    """
    Join each ``count`` consecutive rows, the coordinates of one pose or landmark, into one.

    Names (count n, k) and values (count n,) become names (n, k) and coordinates (n, count). If
    rows are missing, or those of one pose or landmark differ in name, a `UserError` is raised.
    """
    if len(values) % count:
        raise UserError(f'{len(values)} rows are no multiple of {count} coordinates')
    groups = names.reshape(-1, count, names.shape[1])
    if (groups != groups[:, :1]).any():
        raise UserError('rows that belong together name different poses or landmarks')
    return groups[:, 0], values.reshape(-1, count)


def _matrix(name: str, value: Any, columns: int) -> Array:
    is_numeric = isinstance(value, np.ndarray) and value.dtype.kind in 'fiu'
    if not is_numeric or value.shape[1:] != (columns,) or not len(value):
        raise UserError(f'{name} is not a matrix of {columns} columns')
    matrix = np.array(value, dtype=float)
    require_finite(matrix)
    return matrix
