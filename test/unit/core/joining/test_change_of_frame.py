# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A state in the frame of a robot does not depend on the global pose of the state."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates, Invariant, Standard
from fej_slam_ros.core.ekf.state import JointState, Landmark, RendezvousPoint, Robot
from fej_slam_ros.core.joining.change_of_frame import in_frame_of
from fej_slam_ros.core.joining.frame_fit import fit
from fej_slam_ros.core.joining.map_joining import MapJoiner
from fej_slam_ros.core.records import Motion, Observation, RendezvousKey, Scan
from fej_slam_ros.core.settings import Settings
from helpers.core import central_differences, pose_difference, quarter_turn, turn, wrapped

#: States of positions and headings in the vector of `a_team`.
POSITIONS = [slice(0, 2), slice(3, 5), slice(6, 8), slice(8, 10)]
HEADINGS = [2, 5]
POINTS = np.array([[20.0, 3.0], [22.0, -4.0], [26.0, 2.0], [25.0, -2.0]])


def a_team(x, P, x_first=None):
    """Return two robots, a landmark and a rendezvous point, which are correlated."""
    covariance = Covariance()
    slots = covariance.insert(P).split([3, 3, 2, 2])
    return JointState([
        Robot('r1', slots[0], 5), Robot('r2', slots[1], 5), Landmark(('', 7), slots[2], 'r1', 1),
        RendezvousPoint(RendezvousKey('r9', 'r1', 3), slots[3], 'r1'),
    ], x.copy(), (x if x_first is None else x_first).copy(), covariance)


def numbers(seed=1):
    """Return an estimate whose first heading is near pi, and a covariance."""
    rng = np.random.default_rng(seed)
    A = rng.normal(0.0, 0.1, (10, 10))
    x = rng.uniform(-5.0, 5.0, 10)
    x[HEADINGS] = 3.1, -2.9
    return x, A @ A.T


def relative(x, name):
    """Return the vector x in the frame of a robot, computed independently."""
    k = {'r1': 0, 'r2': 3}[name]
    seen = x.copy()
    for position in POSITIONS:
        seen[position] = turn(x[k + 2]).T @ (x[position] - x[k:k + 2])
    seen[HEADINGS] = wrapped(x[HEADINGS] - x[k + 2])
    return seen


def headings_wrapped(a, b):
    """Return a - b of the vector of `a_team`."""
    difference = a - b
    difference[HEADINGS] = wrapped(difference[HEADINGS])
    return difference


def rigid_motions(x):
    """Return the derivative (10, 3) of x by a translation and a rotation of the whole state."""
    N = np.zeros((10, 3))
    for position in POSITIONS:
        N[position] = np.column_stack([np.eye(2), quarter_turn(x[position])])
    N[HEADINGS, 2] = 1.0
    return N


def seen(state, name='r2', linearization=None):
    """Return estimate and covariance in the frame of a robot."""
    found = in_frame_of(state, state.robots[name], linearization or Standard())
    return found.x_hat, found.marginal(found.variables())


@pytest.mark.parametrize('name', ['r1', 'r2'])
def test_estimate_and_covariance_are_relative_to_the_robot(name):
    x, P = numbers()

    x_seen, P_seen = seen(a_team(x, P), name)

    J = central_differences(lambda at: relative(at, name), x, headings_wrapped)
    assert_allclose(x_seen, relative(x, name), atol=1e-14)
    # Differences over 5 m are right to 1e-8, the covariance is of order 0.1.
    assert_allclose(P_seen, J @ P @ J.T, atol=1e-8)


@pytest.mark.parametrize('name', ['r1', 'r2'])
def test_the_robot_is_exactly_at_the_origin(name):
    team = a_team(*numbers())

    found = in_frame_of(team, team.robots[name], Standard())

    robot = found.robots[name]
    assert_array_equal(found.estimate(robot), np.zeros(3))
    assert_array_equal(found.marginal([robot]), np.zeros((3, 3)))
    assert_array_equal(found.first_estimate(robot), np.zeros(3))


def test_a_rigid_motion_of_the_whole_state_changes_nothing():
    x, P = numbers()
    g = np.array([30.0, -20.0, 2.0])
    moved, T = x.copy(), np.eye(10)
    for position in POSITIONS:
        moved[position], T[position, position] = turn(g[2]) @ x[position] + g[:2], turn(g[2])
    moved[HEADINGS] = wrapped(x[HEADINGS] + g[2])

    x_moved, P_moved = seen(a_team(moved, T @ P @ T.T))

    # Rounding of 30 m.
    x_seen, P_seen = seen(a_team(x, P))
    assert_allclose(x_moved, x_seen, atol=1e-13)
    assert_allclose(P_moved, P_seen, atol=1e-13)


@pytest.mark.parametrize(('linearization', 'is_first'), [
    (Standard(), False), (Invariant(), False), (FirstEstimates(), True)])
def test_an_uncertain_global_pose_changes_nothing(linearization, is_first):
    x, P = numbers()
    x_first = x + np.random.default_rng(2).normal(0.0, 0.3, 10)
    N = rigid_motions(x_first if is_first else x)
    unknown = N @ np.diag([100.0, 100.0, 1.0]) @ N.T

    _, P_unknown = seen(a_team(x, P + unknown, x_first), linearization=linearization)

    # Rounding of 100 m^2.
    _, P_seen = seen(a_team(x, P, x_first), linearization=linearization)
    assert_allclose(P_unknown, P_seen, atol=1e-11)


def observing(state, linearization, name, pose):
    """Return a filter that has started the points by a scan from a true pose."""
    z = (POINTS - pose[:2]) @ turn(pose[2])
    R = 0.01 * np.eye(2)
    found = Filter(state, linearization, Gate(1.0))
    found.start_landmarks([Scan(
        name, state.robots[name].stamp, tuple(Observation(k, p, R) for k, p in enumerate(z)))])
    return found


@pytest.mark.parametrize('policy', [Standard, FirstEstimates, Invariant])
def test_a_robot_joins_whose_heading_drifted_before_its_first_observation(policy):
    pose_1, pose_2 = np.array([18.0, 0.0, 0.0]), np.array([18.0, 1.0, 0.2])
    known, drifting = JointState(), JointState()
    known.insert_robot('r1', 40, pose_1, 1e-4 * np.eye(3))
    drifting.insert_robot('r2', 0, np.zeros(3), np.zeros((3, 3)))
    # Its odometry is straight over 20 m, with 0.3 rad at the end.
    Q = np.diag([1e-4, 1e-4, 0.3**2 / 40])
    for stamp in range(1, 41):
        Filter(drifting, policy(), Gate(1.0)).predict(
            Motion('r2', stamp, np.array([0.5, 0.0, 0.0]), Q))
    team, group = (
        observing(known, policy(), 'r1', pose_1), observing(drifting, policy(), 'r2', pose_2))
    assert np.sqrt(fit(team.state, group.state).P[2, 2]) > Settings.join_heading_sigma

    assert MapJoiner(3, 0.999).join(team, group) is None

    # Observations without an error give the true pose; the fit ends at 1e-10.
    pose = team.state.estimate(team.state.robots['r2'])
    assert_allclose(pose_difference(pose, pose_2), 0.0, atol=1e-9)
