# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose between two frames is the weighted least-squares fit of what they share."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.linalg import cho_factor
from scipy.optimize import least_squares

from fej_slam_ros.core.ekf.state import position_indices
from fej_slam_ros.core.joining import frame_fit
from fej_slam_ros.core.joining.frame_fit import fit
from helpers.core import turn
from helpers.joining import two_maps


def test_the_fit_is_weighted_least_squares():
    team, group, _ = two_maps()
    keys = [key for key in team.landmarks if key in group.landmarks]
    ours, theirs = ([state.landmarks[key] for key in keys] for state in (team, group))
    z, f = (np.array([state.estimate(v) for v in variables])
            for state, variables in ((team, ours), (group, theirs)))
    found = fit(team, group)
    C = np.kron(np.eye(len(keys)), turn(found.pose[2]))
    L = np.linalg.cholesky(team.marginal(ours) + C @ group.marginal(theirs) @ C.T)

    def residual(g):
        return np.linalg.solve(L, (z - g[:2] - f @ turn(g[2]).T).ravel())

    best = least_squares(residual, found.pose + 0.1, xtol=1e-15, ftol=1e-15, gtol=1e-15)

    # Least squares stops where the cost no longer falls, at the root of the rounding.
    assert_allclose(found.pose, best.x, atol=1e-7)
    assert found.chi2 == pytest.approx(2.0 * best.cost, rel=1e-9)
    assert found.dof == 2 * len(keys) - 3
    assert_allclose(found.P, np.linalg.inv(best.jac.T @ best.jac), rtol=1e-5)


def test_exact_maps_give_the_exact_pose():
    team, group, g = two_maps(noise=1e-9)

    assert_allclose(fit(team, group).pose, g, atol=1e-7)


def test_a_fit_far_from_the_origin_ends_at_rounding(monkeypatch):
    team, group, g = two_maps(noise=1e-9)
    team.x_hat[position_indices(team.variables())] += [4e6, 5e5]
    factored = []
    monkeypatch.setattr(
        frame_fit, 'cho_factor', lambda *a, **k: factored.append(a) or cho_factor(*a, **k))

    found = fit(team, group)

    # A millionth of a millimetre is the rounding of such coordinates.
    assert_allclose(found.pose, g + np.array([4e6, 5e5, 0.0]), atol=1e-6)
    # Each iteration factors S, and the covariance is factored at the end.
    assert len(factored) <= 6
