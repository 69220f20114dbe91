# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Only the requested numeric matrices of a MATLAB file are read."""

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from fej_slam_ros.datasets.matlab import matrices
from fej_slam_ros.errors import UserError


@pytest.fixture
def file(tmp_path):
    """Return a function that writes variables as a MATLAB file."""

    def write(**variables):
        savemat(tmp_path / 'file.mat', variables)
        return tmp_path / 'file.mat'

    return write


def test_only_requested_variables_are_read_and_missing_ones_omitted(file):
    found = matrices(file(A=np.eye(2), B='no matrix'), {'A': 2, 'C': 3})

    assert {name: matrix.tolist() for name, matrix in found.items()} == {'A': [[1, 0], [0, 1]]}


@pytest.mark.parametrize('kind', [np.uint8, np.int16, np.float32, float])
def test_numbers_of_any_kind_become_floats(file, kind):
    found = matrices(file(A=np.array([[1, 2], [3, 0]], kind)), {'A': 2})['A']

    assert found.dtype == float
    assert np.diff(found).tolist() == [[1], [-3]]


@pytest.mark.parametrize('other', [
    np.eye(2) * 1j, csc_array(np.eye(2)), np.zeros((2, 2, 2)), {'field': np.eye(2)},
    np.array([[1.0, 'text']], dtype=object)])
def test_a_variable_that_is_no_real_matrix_is_rejected(file, other):
    with pytest.raises(UserError, match=r'^A is not a matrix of 2 columns$'):
        matrices(file(A=other), {'A': 2})
