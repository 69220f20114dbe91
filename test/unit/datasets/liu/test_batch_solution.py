# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The authors' solution of Victoria Park is read exactly, or rejected with the reason."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.io import savemat

from fej_slam_ros.datasets.liu.batch_solution import find, read
from fej_slam_ros.errors import UserError

#: A solution that was made up; the second heading is seven quarter turns.
X = np.array([
    [1, 1, 0.5], [1, 1, 0.1], [1, 1, 0.3],
    [1, 2, 1.0], [1, 2, 0.2], [1, 2, 3.5 * np.pi],
    [2, 7, 4.0], [2, 7, 5.0],
    [2, 12, -6.0], [2, 12, 7.0]])


def changed(row, column, value):
    X_changed = X.copy()
    X_changed[row, column] = value
    return {'X': X_changed}


@pytest.fixture
def file(tmp_path):
    """Return a function that writes variables as a MATLAB file."""

    def write(variables):
        savemat(tmp_path / 'X_GNI.mat', variables)
        return tmp_path / 'X_GNI.mat'

    return write


def test_poses_follow_the_origin_with_headings_wrapped(file):
    solution = read(file({'X': X}))

    by_hand = [[0, 0, 0], [0.5, 0.1, 0.3], [1, 0.2, -np.pi / 2]]
    assert_allclose(solution.poses, by_hand, atol=1e-14)  # rounding of the turns


def test_landmarks_go_by_their_ids(file):
    points = read(file({'X': X})).points

    assert {id_: point.tolist() for id_, point in points.items()} == {7: [4, 5], 12: [-6, 7]}


def test_find_returns_the_file_or_none(file, tmp_path):
    assert find(tmp_path) is None

    path = file({'X': X})

    assert find(tmp_path) == path


@pytest.mark.parametrize(('variables', 'reason'), [
    ({'Y': X}, 'it lacks the variables X'),
    ({'X': X[:, :2]}, 'X is not a matrix of 3 columns'),
    ({'X': X[1:]}, '5 rows are no multiple of 3 coordinates'),
    ({'X': X[:-1]}, '3 rows are no multiple of 2 coordinates'),
    ({'X': X[3:]}, 'its poses are not numbered 1, 2'),
    (changed(0, 2, np.nan), 'not finite'),
    (changed(0, 0, 3.0), 'neither of a pose nor of a landmark'),
    (changed(1, 1, 2.0), 'rows that belong together name different'),
    (changed(6, 1, 8.0), 'rows that belong together name different'),
])
def test_a_foreign_or_damaged_file_is_rejected_with_the_reason(file, variables, reason):
    with pytest.raises(UserError, match=rf'X_GNI.mat: .*{reason}.*; fetch the file again$'):
        read(file(variables))


@pytest.mark.parametrize('length', [0, 1, 60, 130, 200])
def test_a_truncated_file_is_rejected(file, length):
    path = file({'X': X})
    path.write_bytes(path.read_bytes()[:length])

    with pytest.raises(UserError, match='cannot be read as a MATLAB file'):
        read(path)
