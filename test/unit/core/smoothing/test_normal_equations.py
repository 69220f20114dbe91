# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The normal equations are factored with every supported scipy, or the error names the cause."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.smoothing import normal_equations
from fej_slam_ros.core.smoothing.normal_equations import Cholesky, NormalEquations


def test_superlu_gets_indices_of_the_only_type_that_scipy_1_11_takes(monkeypatch):
    types = []

    def splu_of_scipy_1_11(matrix, **options):
        types.append((matrix.indices.dtype, matrix.indptr.dtype))
        return splu(matrix, **options)

    monkeypatch.setattr(normal_equations, 'splu', splu_of_scipy_1_11)
    # Three poses in a row, the first of them fixed.
    links = [(np.array([0, 1]), np.array([1, 2]))]
    equations = NormalEquations(np.full(3, 3), np.array([1, 2]), links)
    A = np.tile(np.hstack([-np.eye(3), np.eye(3)]), (2, 1, 1))
    factor = Cholesky(equations.matrix([A]))

    assert set(types) == {(np.dtype(np.intc), np.dtype(np.intc))}
    # After one and two steps of unit noise the variance is 1 and 2.
    variances = factor.solve(np.eye(6)).diagonal()
    np.testing.assert_allclose(np.sort(variances), np.repeat([1.0, 2.0], 3), rtol=1e-12)


def test_measurements_that_nearly_exact_ones_hide_are_an_error_that_names_the_cause():
    # Three poses in a row, the first of them fixed; sigma of the second step is 1e-8.
    links = [(np.array([0, 1]), np.array([1, 2]))]
    equations = NormalEquations(np.full(3, 3), np.array([1, 2]), links)
    A = np.multiply.outer([1.0, 1e8], np.hstack([-np.eye(3), np.eye(3)]))

    with pytest.raises(SingularError, match='odometry is nearly exact'):
        Cholesky(equations.matrix([A]))
