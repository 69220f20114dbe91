# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which parameters may change during a run, and what else changes with them."""

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import (
    changeable_parameters, checked_changes, ESTIMATOR, parse, rejection, SMOOTHER, with_values)

TEAM = ['r1', 'r2']
SETTINGS = parse({'robots': TEAM, 'r2.landmark_noise_scale': 3.0})


def noise_scales(settings):
    """Return the noise scale of the team and those of its robots."""
    return settings.landmark_noise_scale, *(r.landmark_noise_scale for r in settings.robots)


@pytest.mark.parametrize(('name', 'scales'), [
    ('landmark_noise_scale', (2.0, 2.0, 3.0)), ('r1.landmark_noise_scale', (1.0, 2.0, 3.0))])
def test_noise_of_the_team_is_that_of_the_robots_that_had_it_and_that_of_a_robot_its_own(
        name, scales):
    assert noise_scales(with_values(SETTINGS.estimation, [(name, 2.0)])) == scales


def test_what_the_estimate_is_built_on_does_not_change():
    fixed = {'filter', 'anchor', 'anchor_pose', 'start_covariance', 'shared_landmark_ids',
             'compressed', 'r1.id', 'r1.start_pose', 'r1.sensor_pose', 'prior_landmarks', 'output'}

    assert not fixed & changeable_parameters(TEAM, ESTIMATOR)


def test_of_estimation_the_smoother_changes_the_team_only():
    assert changeable_parameters(TEAM, SMOOTHER) == {
        'robots', 'peers', 'clock_limit', 'map_period', 'unused_variance', 'autosave_period',
        'transform_tolerance'}


def test_an_old_name_is_answered_with_the_new_one():
    assert rejection('second_look', {}, ()) == (
        "parameter 'second_look' is the old name of 'inflate_rejected_scans': set that")


def test_values_are_checked_together_before_any_is_used():
    with pytest.raises(UsageError, match="'gate_probability' must be a number above 0"):
        checked_changes(SETTINGS, {'map_period': 2.0, 'gate_probability': -1.0}, ESTIMATOR)


def test_a_smoother_with_peers_takes_no_period_of_checkpoints_with_which_it_could_not_start():
    settings = parse({'robots': ['r1'], 'peers': ['r2']})

    with pytest.raises(UsageError, match="'autosave_period' is not for a smoother with 'peers'"):
        checked_changes(settings, {'autosave_period': 1.0}, SMOOTHER)

    assert checked_changes(settings, {'autosave_period': 0.0}, SMOOTHER)
