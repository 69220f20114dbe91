# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""First estimates that are far from a map corrected by metres are renewed, and reveal nothing."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.first_estimates import MAX_MOVED, renew
from fej_slam_ros.core.ekf.gating import Association, Gate
from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, RenewedFirstEstimates, Standard)
from fej_slam_ros.core.ekf.observability import (
    linearized_rigid_motions, record_observability)
from fej_slam_ros.core.ekf.state import JointState, observation_columns
from fej_slam_ros.core.records import Observation

#: Offset of a landmark from a robot at the origin, and of its first estimate from its estimate.
OFFSET, MOVED = np.array([1.0, -1.4]), np.array([2.0, 2.8])
SIGMA, HEADING_SIGMA = 0.03, 0.1


def team(moved, policy=FirstEstimates, iterations=1):
    """
    Return a filter of two robots, and two landmarks that r2 has mapped.

    The estimate of the first landmark has moved since, with no more information.

    """
    state = JointState()
    for name, pose, sigma in (
            ('r1', np.zeros(3), HEADING_SIGMA), ('r2', np.array([4.0, 3.0, 2.0]), 0.05)):
        state.insert_robot(name, 0, pose, np.diag([0.05, 0.05, sigma]) ** 2)
    robot = state.robots['r2']
    for id_, first in (1, OFFSET + moved), (2, np.array([2.0, 4.0])):
        x, y = first - state.pose(robot)[:2]
        state.augment(
            ('', id_), robot, first, np.array([[1.0, 0.0, -y], [0.0, 1.0, x]]),
            0.05 ** 2 * np.eye(2))
    state.x_hat[state.landmarks['', 1].slot.indices] -= moved
    return Filter(state, policy(), Gate(0.999), iterations=iterations)


def observed(filter_, heading_error, id_=1):
    """Return the observation of a landmark by r1, whose true heading is off."""
    state = filter_.state
    robot, landmark = state.robots['r1'], state.landmarks['', id_]
    c, s = np.cos(heading_error), np.sin(heading_error)
    z = np.array([[c, s], [-s, c]]) @ state.estimate(landmark)
    return [Association(robot, landmark, Observation(id_, z, SIGMA ** 2 * np.eye(2)))]


def columns(filter_):
    state = filter_.state
    return observation_columns([state.robots['r1']] * 2, [*state.landmarks.values()])


def rotation(x):
    """Return the derivative (n,) of a joint estimate x (n,) by a turn about the origin."""
    poses, points = x[:6].reshape(2, 3), x[6:].reshape(-1, 2)
    return np.concatenate([
        np.column_stack([-poses[:, 1], poses[:, 0], np.ones(2)]).ravel(),
        np.column_stack([-points[:, 1], points[:, 0]]).ravel()])


def test_renewal_does_not_change_the_information_about_a_rotation_of_everything():
    filter_ = team(MOVED)
    state = filter_.state
    u, P = rotation(state.x_first), state.marginal(state.variables())
    before = u @ np.linalg.solve(P, u)

    assert filter_.linearization.renew_points(state, columns(filter_))

    u, P = rotation(state.x_first), state.marginal(state.variables())
    # The conditions of P, 1e4, lose four of 16 digits.
    assert_allclose(u @ np.linalg.solve(P, u), before, rtol=1e-10)
    assert_array_equal(state.x_first, state.x_hat)


def test_renewal_does_not_change_the_information_about_a_rotation_of_a_part():
    state = team(MOVED).state
    # r2 and what it has mapped, as after a way of which r1 saw nothing.
    part = rotation(state.x_first)
    part[:3] = 0.0
    covariance = Covariance()
    variables = state.variables()
    slots = covariance.insert(
        state.marginal(variables) + 0.3 ** 2 * np.outer(part, part)).split(
        [variable.slot.size for variable in variables])
    turned = JointState(
        [replace(variable, slot=slot) for variable, slot in zip(variables, slots)],
        state.x_hat, state.x_first, covariance)
    before = part @ np.linalg.solve(turned.marginal(turned.variables()), part)

    renew(turned, turned.landmarks['', 1].slot.indices[None])

    part = rotation(turned.x_first)
    part[:3] = 0.0
    assert_allclose(
        part @ np.linalg.solve(turned.marginal(turned.variables()), part), before, rtol=1e-10)


@pytest.mark.parametrize(('policy', 'moved', 'offset'), [
    # The second policy renews after the first update, which has moved the landmark, too.
    (FirstEstimates, MOVED, 1e-9), (RenewedFirstEstimates, 0.3 * MOVED, 0.2)])
def test_a_rotation_of_everything_stays_unobservable_across_a_renewal(policy, moved, offset):
    filter_ = team(moved, policy)
    recorder, motions = record_observability(filter_), linearized_rigid_motions(filter_)

    for id_ in 1, 2, 1, 2:
        filter_.update(observed(filter_, 3.0 * HEADING_SIGMA, id_))

    assert_allclose(filter_.state.x_first[6:8], OFFSET, atol=offset)
    M = np.vstack(recorder.rows)
    assert len(M) == 8
    # Products of numbers up to 5.
    assert_allclose(M @ motions, 0.0, atol=1e-13)


@pytest.mark.parametrize('moved', [[2.0, 2.8], [-1.5, 1.8], [0.5, 2.5]])
def test_the_update_is_that_at_the_estimate_whatever_the_first_estimate_was(moved):
    filter_, standard = team(np.array(moved)), team(np.zeros(2), Standard)

    for each in filter_, standard:
        each.update(observed(each, 3.5 * HEADING_SIGMA))

    state, expected = filter_.state, standard.state
    assert expected.pose(expected.robots['r1'])[2] > 2.0 * HEADING_SIGMA
    assert_allclose(state.x_hat, expected.x_hat, rtol=1e-12)
    assert_allclose(
        state.marginal(state.variables()), expected.marginal(expected.variables()),
        rtol=1e-10, atol=1e-15)


def test_first_estimates_nearby_or_that_explain_what_is_observed_stay():
    near, explained = team(0.9 * MAX_MOVED * OFFSET), team(MOVED)

    assert not near.linearization.renew_points(near.state, columns(near))
    explained.update(observed(explained, 0.0))

    assert_allclose(explained.state.x_first[6:8], OFFSET + MOVED)


@pytest.mark.parametrize(('policy', 'heading_error', 'iterations'), [
    (FirstEstimates, 0.16, 1), (RenewedFirstEstimates, 0.14, 1), (RenewedFirstEstimates, 0.16, 2)])
def test_a_correction_by_a_tenth_of_a_radian_is_iterated_and_renews_where_maps_join(
        policy, heading_error, iterations):
    moved = 0.3 * MOVED
    once, filter_, reference = team(moved), team(moved, policy), team(moved, iterations=iterations)
    for each in once, filter_, reference:
        each.update(observed(each, heading_error))

    # One iteration corrects the heading by 0.099 and 0.113 rad.
    assert (once.state.x_hat[2] > 0.1) == (heading_error > 0.15)
    state = filter_.state
    assert_array_equal(state.x_hat, reference.state.x_hat)
    expected = OFFSET + moved if iterations == 1 else state.x_hat[6:8]
    assert_allclose(state.x_first[6:8], expected, rtol=1e-15)


def test_only_landmarks_whose_first_estimates_are_far_off_are_renewed():
    filter_ = team(0.3 * MOVED, RenewedFirstEstimates)
    before = filter_.state.x_first[8:].copy()

    filter_.update(observed(filter_, 3.0 * HEADING_SIGMA))

    assert np.abs(filter_.state.x_hat[8:] - before).max() > 0.0
    assert_array_equal(filter_.state.x_first[8:], before)
