# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of a robot that drove on with a wrong heading are accepted."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import binom, chi2

from fej_slam_ros.core.ekf.curved_errors import curved_distances
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.records import Motion, Observation, Scan
from helpers.core import central_differences, make_policy, turn

#: Standard deviations of a turn [rad] and of observations [m], and the distance driven after it.
TURN_SIGMA, NOISE, DISTANCE = 0.1, 0.05, 10.0


def after_a_turn(error):
    """Return where a robot is that was to turn by 0 and to drive on, and turned by an error."""
    return np.array([DISTANCE * np.cos(error), DISTANCE * np.sin(error), error])


def observed(pose, point):
    return turn(pose[2]).T @ (point - pose[:2])


def test_distances_of_errors_on_arcs_are_chi_square():
    rng, m, point = np.random.default_rng(1), 20_000, np.array([12.0, 3.0])
    errors = rng.normal(0.0, TURN_SIGMA, m)
    z = np.array([observed(after_a_turn(error), point) for error in errors])
    z += rng.normal(0.0, NOISE, (m, 2))
    # By first order, the pose moves by DISTANCE to the left for a turn of 1.
    moves = np.array([0.0, DISTANCE, 1.0])
    P = np.zeros((5, 5))
    P[:3, :3] = TURN_SIGMA ** 2 * np.outer(moves, moves)
    straight = after_a_turn(0.0)
    H = central_differences(
        lambda x: observed(x[:3], x[3:]), np.concatenate([straight, point]))
    r, R = z - observed(straight, point), NOISE ** 2 * np.eye(2)

    on_arcs = curved_distances(r, *(np.broadcast_to(a, (m, *a.shape)) for a in (R, H, P)))

    S = H @ P @ H.T + R
    linear = np.einsum('ki,ij,kj->k', r, np.linalg.inv(S), r)
    limit = chi2.ppf(0.999, 2)
    assert np.mean(linear > limit) > 0.1
    assert binom.ppf(1e-3, m, 1e-3) <= np.sum(on_arcs > limit) <= binom.ppf(1 - 1e-3, m, 1e-3)


@pytest.mark.parametrize('kind', ['standard', 'fej', 'invariant'])
def test_a_robot_that_drove_on_with_a_wrong_heading_finds_its_landmark_again(kind):
    point, true = np.array([12.0, 3.0]), after_a_turn(3.0 * TURN_SIGMA)
    state = JointState()
    robot = state.insert_robot('r1', 0, np.zeros(3), 1e-6 * np.eye(3))
    filter_ = Filter(state, make_policy(kind, None), Gate(0.999))
    noise = NOISE ** 2 * np.eye(2)
    filter_.step([], [Scan('r1', 0, (Observation(1, point, noise),))])
    filter_.predict(Motion('r1', 1, np.zeros(3), np.diag([1e-6, 1e-6, TURN_SIGMA ** 2])))
    filter_.predict(Motion('r1', 2, np.array([DISTANCE, 0.0, 0.0]), np.diag([0.02, 0.02, 1e-6])))
    again = Scan('r1', 2, (Observation(1, observed(true, point), noise),))

    innovation = filter_.step([], [again])

    assert not innovation.rejected
    # The position is known to 0.14 m on either side of a line of 10 m.
    assert_allclose(state.pose(robot)[2], true[2], atol=3 * 0.14 / DISTANCE)
    assert_allclose(
        observed(state.pose(robot), state.estimate(state.landmarks['', 1])),
        observed(true, point), atol=2 * NOISE)
