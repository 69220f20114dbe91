# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The iteration reaches the minimum of Rosenbrock's valley, at (1, 1) and zero cost."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.gauss_newton import gauss_newton, NielsenDamping, SingularError

#: A point on the floor of the valley.
START = np.array([-1.2, 1.44])


class Linearized:
    """A and b of residuals k (y - x^2) and 1 - x."""

    def __init__(self, x, k):
        self.A = np.array([[2.0 * k * x[0], -k], [1.0, 0.0]])
        self.b = np.array([k * (x[1] - x[0] ** 2), 1.0 - x[0]])
        self.cost = float(self.b @ self.b)


class Valley:
    """
    Minimisation of k^2 (y - x^2)^2 + (1 - x)^2.

    Parameters
    ----------
    k : steepness of its sides
    singular_above : cost above which no undamped step is found

    """

    def __init__(self, k, singular_above=np.inf):
        self._k, self._singular_above = k, singular_above

    def linearize(self, x):
        return Linearized(x, self._k)

    def step(self, at, damping):
        if damping == 0.0 and at.cost > self._singular_above:
            raise SingularError('too far away')
        N, g = at.A.T @ at.A, at.A.T @ at.b
        D = damping * np.diag(N)
        dx = np.linalg.solve(N + np.diag(D), g)
        return dx, float(dx @ (g + D * dx))

    def retract(self, x, dx):
        return x + dx

    def has_converged(self, x, dx, decrease):
        return np.abs(dx).max() < 1e-9


@pytest.mark.parametrize('k', [10.0, 1e3, 1e5])
def test_a_step_out_of_a_narrow_valley_is_taken_with_the_one_back(k):
    # x becomes 1 by the first step, and y becomes 1 by the second.
    x, _, iterations = gauss_newton(Valley(k), START, 100, NielsenDamping())

    assert_allclose(x, [1.0, 1.0], atol=1e-9)
    assert iterations <= 4


def test_where_there_is_no_step_back_the_step_is_damped():
    damping = NielsenDamping()

    x, *_ = gauss_newton(Valley(10.0, singular_above=10.0), START, 100, damping)

    assert_allclose(x, [1.0, 1.0], atol=1e-9)
    assert damping.rejected > 1
