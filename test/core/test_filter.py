# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order inside a step, and what becomes of each sighting."""

from copy import deepcopy

from core_helpers import SmallTeam
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

KINDS = ['standard', 'fej', 'ideal']


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


def test_only_the_sighting_that_starts_a_landmark_is_used_up():
    team, filter_ = team_and_filter()

    left = filter_.start_landmarks([team.look('r1', [0, 2]), team.look('r2', [1, 2, 3])])

    assert [(a.robot.name, a.landmark.key[1]) for a in left] == [('r1', 0), ('r2', 1), ('r2', 2)]
    owners = {number: mark.owner for (_, number), mark in filter_.state.landmarks.items()}
    assert owners == {0: 'r1', 1: 'r1', 2: 'r1', 3: 'r2'}


def test_the_order_of_the_scans_decides_who_starts_a_landmark():
    team, filter_ = team_and_filter()

    filter_.start_landmarks([team.look('r2', [2]), team.look('r1', [2])])

    assert filter_.state.landmarks['', 2].owner == 'r2'


@pytest.mark.parametrize('scans', [[], ['r1', 'r2']])
def test_a_step_in_which_nobody_sees_anything_is_a_prediction(scans):
    team, filter_ = team_and_filter()
    motion, predicted = team.drive('r2', 1), deepcopy(filter_)

    innovation = filter_.step([motion], [team.look(name, numbers=[]) for name in scans])
    predicted.predict(motion)

    assert innovation.nis() == {}
    assert_array_equal(filter_.state.x_hat, predicted.state.x_hat)
    assert_array_equal(covariance(filter_.state), covariance(predicted.state))


@pytest.mark.parametrize('kind', KINDS)
def test_without_noise_estimates_stay_the_truth(kind):
    team = SmallTeam(seed=2, robots=3, landmarks=4, noise=0.0)
    filter_ = team.start(kind)

    for k in range(1, 30):
        team.step(filter_, k, team.names[k % 2:], team.names[:k % 3 + 1])

    state = filter_.state
    truth = [team.truth.pose(name, robot.stamp) for name, robot in state.robots.items()]
    truth += [team.truth.landmark(key) for key in state.landmarks]
    assert_allclose(state.x_hat, np.concatenate(truth), atol=1e-12)  # rounding
