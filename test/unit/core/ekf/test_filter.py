# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The order inside a step, what becomes of each observation, and the update itself.

Mutations of the iterations, each tried once in a copy of the sources, that fail here: H or the
innovation of the first iterate in all, H dx left out, each iterate added to the last one; the
whitened innovation of the last iterate.
"""

from copy import deepcopy

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import block_diag

from fej_slam_ros.core.ekf.filter import Filter
from helpers.core import central_differences, SmallTeam, turn

KINDS = ['standard', 'fej', 'ideal', 'invariant']


def team_and_filter(kind='fej'):
    """Return a team whose filter knows landmarks 0 and 1 of five."""
    team = SmallTeam(seed=1, landmarks=5)
    filter_ = team.start(kind)
    filter_.step([], [team.look('r1', [0, 1])])
    return team, filter_


def covariance(state):
    return state.marginal([*state.robots.values(), *state.landmarks.values()])


@pytest.mark.parametrize('kind', KINDS)
def test_a_step_is_predict_then_start_then_update(kind):
    team, at_once = team_and_filter(kind)
    motions = [team.drive(name, 1) for name in team.names]
    scans = [team.look(name) for name in team.names]
    in_parts = deepcopy(at_once)

    at_once.step(motions, scans)
    for motion in motions:
        in_parts.predict(motion)
    in_parts.update(in_parts.start_landmarks(scans))

    assert_array_equal(at_once.state.x_hat, in_parts.state.x_hat)
    assert_array_equal(at_once.state.x_first, in_parts.state.x_first)
    assert_array_equal(covariance(at_once.state), covariance(in_parts.state))


def in_frame_of(x, robot, point):
    """Return where the robot at index `robot` of a joint vector sees the point at `point`."""
    return turn(x[robot + 2]).T @ (x[point:point + 2] - x[robot:robot + 2])


# The others are not linearised at the estimate.
@pytest.mark.parametrize('kind', ['standard', 'invariant'])
def test_sigmas_of_directions_are_those_of_samples(kind):
    team, filter_ = team_and_filter(kind)
    filter_.step([team.drive(name, 1) for name in team.names], [team.look('r1', [0, 1])])
    state, robot = filter_.state, filter_.state.robots['r1']
    observed = [*state.landmarks.values(), state.robots['r2']]
    P = state.marginal(state.variables())
    samples = np.random.default_rng(2).multivariate_normal(state.x_hat, 1e-4 * P, 4000)

    z = np.array([
        [in_frame_of(x, robot.slot.start, v.slot.start) for v in observed] for x in samples])
    turns = 1e2 * np.arctan2(z[..., 1], z[..., 0]).std(axis=0)

    # Of 4,000 samples a standard deviation has an error of 1.1 %.
    assert_allclose(filter_.direction_sigmas(robot, observed), turns, rtol=0.05)


def test_a_point_at_the_robot_has_no_direction():
    _, filter_ = team_and_filter()
    state = filter_.state
    robot, landmark = state.robots['r1'], next(iter(state.landmarks.values()))
    state.x_hat[landmark.slot.indices] = state.pose(robot)[:2]

    assert filter_.direction_sigmas(robot, [landmark]) == np.inf


def iterated_update(x_prior, P, observations, iterations):
    """Return estimate and covariance after the update of a textbook's iterated EKF."""
    x = x_prior
    z = np.concatenate([observation.z for *_, observation in observations])
    R = block_diag(*(observation.R for *_, observation in observations))

    def h(x):
        return np.concatenate([in_frame_of(x, robot, point) for robot, point, _ in observations])

    for _ in range(iterations):
        H = central_differences(h, x)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x = x_prior + K @ (z - h(x) - H @ (x_prior - x))
    return x, P - K @ H @ P


@pytest.mark.parametrize('iterations', [1, 2, 3, 10])
def test_the_standard_update_equals_the_iterated_ekf(iterations):
    team = SmallTeam(seed=2, robots=3, landmarks=4, noise=3.0)
    filter_ = team.start('standard', iterations=iterations)
    team.step(filter_, 1, team.names, team.names)
    state = filter_.state
    scans, meetings = [team.look('r1'), team.look('r3')], [team.look_for_robots('r2')]
    observations = filter_.start_landmarks(scans) + filter_.associate_robots(meetings)
    x, P = iterated_update(
        state.x_hat, state.marginal(state.variables()),
        [(a.observer.slot.start, a.observed.slot.start, a.observation) for a in observations],
        iterations)

    filter_.update(observations)

    # Jacobians by differences are right to 1e-9.
    assert_allclose(state.x_hat, x, atol=1e-8)
    assert_allclose(state.marginal(state.variables()), P, atol=1e-8)


@pytest.mark.parametrize('kind', KINDS)
def test_iterations_report_the_innovation_of_the_prior(kind):
    team, once = team_and_filter(kind)
    thrice = Filter(deepcopy(once.state), once.linearization, once.gate, iterations=3)
    meetings = [team.look_for_robots('r1')]

    y = [filter_.step([], [], meetings).y for filter_ in (once, thrice)]

    assert_array_equal(y[1], y[0])
    assert np.abs(thrice.state.x_hat - once.state.x_hat).max() > 1e-6


def test_only_robots_of_the_same_frame_are_associated():
    team = SmallTeam(seed=1, robots=3)
    filter_ = team.start('fej')
    filter_.state.remove(filter_.state.robots['r3'])

    observations = filter_.associate_robots([team.look_for_robots(name) for name in team.names])

    pairs = [(a.observer.name, a.observed.name) for a in observations]
    assert pairs == [('r1', 'r2'), ('r2', 'r1')]


def test_only_the_observation_that_starts_a_landmark_is_used_up():
    team, filter_ = team_and_filter()

    associations = filter_.start_landmarks([team.look('r1', [0, 2]), team.look('r2', [1, 2, 3])])

    pairs = [(a.observer.name, a.observed.key[1]) for a in associations]
    assert pairs == [('r1', 0), ('r2', 1), ('r2', 2)]
    owners = {number: mark.owner for (_, number), mark in filter_.state.landmarks.items()}
    assert owners == {0: 'r1', 1: 'r1', 2: 'r1', 3: 'r2'}


def test_the_first_scan_starts_a_landmark():
    team, filter_ = team_and_filter()

    filter_.start_landmarks([team.look('r2', [2]), team.look('r1', [2])])

    assert filter_.state.landmarks['', 2].owner == 'r2'


@pytest.mark.parametrize('scans', [[], ['r1', 'r2']])
def test_a_step_without_observations_is_a_prediction(scans):
    team, filter_ = team_and_filter()
    motion, predicted = team.drive('r2', 1), deepcopy(filter_)

    innovation = filter_.step([motion], [team.look(name, numbers=[]) for name in scans])
    predicted.predict(motion)

    assert innovation.nis() == {}
    assert_array_equal(filter_.state.x_hat, predicted.state.x_hat)
    assert_array_equal(covariance(filter_.state), covariance(predicted.state))


def driven(x, u):
    return np.array([*x[:2] + turn(x[2]) @ u[:2], x[2] + u[2]])


def test_a_prediction_propagates_uncertainty_to_first_order():
    team, filter_ = team_and_filter('standard')
    robot, motion = filter_.state.robots['r2'], team.drive('r2', 1)
    x, P = filter_.state.estimate(robot), filter_.state.marginal([robot])

    filter_.predict(motion)

    A = central_differences(lambda x: driven(x, motion.u), x)
    B = central_differences(lambda u: driven(x, u), motion.u)
    expected = A @ P @ A.T + B @ motion.Q @ B.T
    assert_allclose(filter_.state.marginal([robot]), expected, atol=1e-9)


def test_a_new_landmark_has_the_uncertainty_of_its_robot_and_its_observation():
    team, filter_ = team_and_filter()
    state = filter_.state
    robot, scan = state.robots['r2'], team.look('r2', [4])
    z, x = scan.observations[0].z, state.estimate(robot)

    filter_.start_landmarks([scan])

    B = central_differences(lambda v: v[:2] + turn(v[2]) @ v[3:], np.array([*x, *z]))
    A = np.vstack([np.eye(3, 5), B])
    expected = A @ block_diag(state.marginal([robot]), team.R) @ A.T
    assert_allclose(state.marginal([robot, state.landmarks['', 4]]), expected, atol=1e-9)


@pytest.mark.parametrize('kind', KINDS)
def test_without_noise_estimates_equal_the_truth(kind):
    team = SmallTeam(seed=2, robots=3, landmarks=4, noise=0.0, meeting=True)
    filter_ = team.start(kind)

    for k in range(1, 30):
        team.step(filter_, k, team.names[k % 2:], team.names[:k % 3 + 1])

    state = filter_.state
    truth = [team.truth.pose(name, robot.stamp) for name, robot in state.robots.items()]
    truth += [team.truth.landmark(key) for key in state.landmarks]
    assert_allclose(state.x_hat, np.concatenate(truth), atol=1e-12)  # rounding


def test_landmarks_of_the_first_scan_are_trusted_and_later_ones_are_not():
    team, filter_ = team_and_filter()
    stamp = filter_.state.robots['r1'].stamp
    filter_.start_landmarks([team.look('r1', [2])])
    filter_.state.robots['r1'].stamp = stamp + 1

    filter_.start_landmarks([team.look('r1', [2, 3, 4])])

    landmarks = filter_.state.landmarks.values()
    assert [(landmark.key[1], landmark.is_trusted) for landmark in landmarks] == [
        (0, True), (1, True), (2, True), (3, False), (4, False)]
