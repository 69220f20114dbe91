# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A join conditions two maps on what they share, without information about the global pose."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence
from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, Invariant, RenewedFirstEstimates, Standard)
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.joining.frame_fit import fit
from fej_slam_ros.core.joining.joined_state import joined_state
from helpers.core import pose_difference, quarter_turn, turn, unknown_place
from helpers.joining import add_rendezvous_points, two_maps

ANCHOR_SIGMA = (0.1, 0.2, 0.05)


def with_uncertain_global_pose(state, kind):
    """Return a state whose global pose alone is less certain."""
    variables = state.variables()
    at = state.x_first if kind == 'fej' else state.x_hat
    P = state.marginal(variables) + unknown_place(state, at, ANCHOR_SIGMA)
    covariance = Covariance()
    slots = covariance.insert(P).split([v.slot.size for v in variables])
    return JointState(
        [replace(v, slot=slot) for v, slot in zip(variables, slots)],
        state.x_hat, state.x_first, covariance)


@pytest.mark.parametrize(('kind', 'policy'), [
    ('fej', FirstEstimates), ('fej', RenewedFirstEstimates), ('invariant', Invariant)])
@pytest.mark.parametrize('noise', [0.05, 0.3])
@pytest.mark.parametrize('points', [0, 3])
def test_a_join_is_independent_of_the_uncertainty_of_the_global_pose(
        kind, policy, noise, points):
    team, group, _ = two_maps(noise=noise)
    add_rendezvous_points(team, group, points)
    g = fit(team, group).pose

    certain = joined_state(team, group, g, policy())
    state = joined_state(with_uncertain_global_pose(team, kind), group, g, policy())

    assert np.abs(certain.x_hat[:5] - team.x_hat[:5]).max() > 0.01
    # Rounding, by the condition of the shared variables.
    assert_allclose(state.x_hat, certain.x_hat, atol=1e-10)
    variables = certain.variables()
    assert_allclose(
        state.marginal(state.variables()),
        with_uncertain_global_pose(certain, kind).marginal(variables), atol=1e-10)


def test_joining_conditions_on_shared_variables_without_a_prior_of_the_frame():
    team, group, _ = two_maps()
    g = fit(team, group).pose
    # The same by an update of [x_T, x_L, g] with exact conditions and next to no prior of g.
    n, k = len(team.x_hat), len(group.x_hat)
    P = np.zeros((n + k + 3, n + k + 3))
    P[:n, :n], P[n:-3, n:-3] = (s.marginal(s.variables()) for s in (team, group))
    P[-3:, -3:] = 100.0 * np.eye(3)
    H, r = [], []
    for key in team.landmarks.keys() & group.landmarks.keys():
        a, b = (s.landmarks[key].slot.indices for s in (team, group))
        row = np.zeros((2, n + k + 3))
        row[:, a], row[:, n + b], row[:, -3:-1] = np.eye(2), -turn(g[2]), -np.eye(2)
        row[:, -1] = -quarter_turn(team.x_hat[a] - g[:2])
        H.append(row)
        r.append(g[:2] + turn(g[2]) @ group.x_hat[b] - team.x_hat[a])
    H, r = np.vstack(H), np.concatenate(r)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T)
    x, P = K @ r, P - K @ H @ P

    state = joined_state(team, group, g, Standard())

    # A prior variance of 100 against 1e-3 of the maps, squared.
    assert_allclose(state.x_hat[:n], team.x_hat + x[:n], atol=1e-6)
    assert_allclose(state.marginal(team.variables()), P[:n, :n], atol=1e-6)
    new = state.robots['r2']
    D = np.zeros((3, n + k + 3))
    D[:2, n:n + 2], D[2, n + 2] = turn(g[2]), 1.0
    D[:2, -3:-1], D[:, -1] = np.eye(2), [*quarter_turn(turn(g[2]) @ group.x_hat[:2]), 1.0]
    assert_allclose(state.marginal([new]), D @ P @ D.T, atol=1e-6)
    cross = state.marginal([new, *team.variables()])[:new.slot.size, new.slot.size:]
    assert_allclose(cross, (D @ P)[:, :n], atol=1e-6)
    moved, pose = g + x[-3:], group.x_hat[:3] + x[n:n + 3]
    expected = [*(moved[:2] + turn(moved[2]) @ pose[:2]), moved[2] + pose[2]]
    assert_allclose(pose_difference(state.estimate(new), expected), np.zeros(3), atol=1e-6)


def test_first_estimates_of_the_team_stay_and_new_ones_are_transformed():
    team, group, _ = two_maps()
    g = fit(team, group).pose

    state = joined_state(team, group, g, FirstEstimates())

    assert_array_equal(state.x_first[:len(team.x_first)], team.x_first)
    lone = state.landmarks['', 5]
    expected = g[:2] + turn(g[2]) @ group.first_estimate(group.landmarks['', 5])
    assert_allclose(state.first_estimate(lone), expected, atol=1e-12)
    assert lone.owner == 'r2'
    assert state.robots['r2'].stamp == 5


@pytest.mark.parametrize(('noise', 'turns_far'), [(0.05, False), (0.3, True)])
def test_where_a_join_turns_a_robot_far_first_estimates_are_renewed(noise, turns_far):
    team, group, _ = two_maps(noise=noise)
    g = fit(team, group).pose

    kept = joined_state(team, group, g, FirstEstimates())
    state = joined_state(team, group, g, RenewedFirstEstimates())

    # By more than 0.1 rad.
    correction = state.estimate(state.robots['r1']) - team.estimate(team.robots['r1'])
    assert (abs(correction[2]) > 0.1) == turns_far
    robots = [state.estimate(robot)[:2] for robot in state.robots.values()]
    are_far = []
    for landmark in state.landmarks.values():
        point, first = state.estimate(landmark), kept.first_estimate(landmark)
        # By a fifth of the distance of the nearest robot.
        distance = min(np.linalg.norm(point - robot) for robot in robots)
        are_far.append(turns_far and np.linalg.norm(point - first) > 0.2 * distance)
        assert_array_equal(state.first_estimate(landmark), point if are_far[-1] else first)
    assert any(are_far) == turns_far
    assert not all(are_far)


def test_maps_without_robots_keep_their_first_estimates():
    team, group, _ = two_maps(noise=0.3)
    for state, robot in ((team, 'r1'), (group, 'r2')):
        state.remove(state.robots[robot])

    state = joined_state(team, group, fit(team, group).pose, RenewedFirstEstimates())

    assert_array_equal(state.x_first[:len(team.x_first)], team.x_first)


def test_evidence_on_the_landmarks_of_the_team_is_kept():
    team, group, _ = two_maps()
    landmark = team.landmarks['', 0]
    landmark.last_accepted, landmark.moved_evidence = 77, MovedLandmarkEvidence()

    state = joined_state(team, group, fit(team, group).pose, FirstEstimates())

    kept = state.landmarks['', 0]
    assert (kept.last_accepted, kept.moved_evidence) == (77, landmark.moved_evidence)


def test_landmarks_of_the_other_frame_keep_when_they_were_accepted_and_lose_evidence_of_a_move():
    team, group, _ = two_maps()
    key = next(key for key in group.landmarks if key not in team.landmarks)
    brought = group.landmarks[key]
    brought.last_accepted, brought.moved_evidence = 77, MovedLandmarkEvidence()

    state = joined_state(team, group, fit(team, group).pose, FirstEstimates())

    kept = state.landmarks[key]
    assert (kept.last_accepted, kept.moved_evidence) == (77, None)
    assert brought.moved_evidence is not None


def test_a_shared_landmark_is_as_old_as_in_either_frame_and_has_been_observed_again():
    """The age decides which landmarks confirm a pose where another one was moved."""
    team, group, _ = two_maps()
    for (of_team, of_group), number in zip([(9, 4), (4, 9)], range(2)):
        team.landmarks['', number].created = of_team
        group.landmarks['', number].created = of_group

    state = joined_state(team, group, fit(team, group).pose, FirstEstimates())

    assert [state.landmarks['', number].created for number in range(2)] == [4, 4]
    shared = team.landmarks.keys() & group.landmarks.keys()
    assert all(state.landmarks[key].is_reobserved for key in shared)
    assert team.landmarks['', 0].created == 9
