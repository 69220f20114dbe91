# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MATLAB files: named matrices of numbers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.errors import UserError


def matrices(path: Path, columns: Mapping[str, int]) -> dict[str, Array]:
    """
    Return those of the named matrices that a file holds.

    Parameters
    ----------
    path : the file
    columns : by its name, how many columns each matrix has

    Raises
    ------
    UserError
        The file cannot be read, or a matrix is something else.

    """
    try:
        variables = loadmat(path, variable_names=list(columns))
    # scipy has no class of errors for a damaged file: five kinds have been seen.
    except Exception as error:
        raise UserError(f'cannot be read as a MATLAB file ({error})') from error
    return {
        name: _matrix(name, variables[name], count)
        for name, count in columns.items() if name in variables}


def _matrix(name: str, value: Any, columns: int) -> Array:
    is_numeric = isinstance(value, np.ndarray) and value.dtype.kind in 'fiu'
    if not is_numeric or value.shape[1:] != (columns,):
        raise UserError(f'{name} is not a matrix of {columns} columns')
    return np.array(value, dtype=float)
