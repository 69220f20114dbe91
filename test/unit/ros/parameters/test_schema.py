# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names, kinds and descriptions of parameters follow from the settings."""

from dataclasses import fields
import math

import pytest

from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.parameters import (
    as_parameters, deciding, known_parameters, NodeSettings, parse, SMOOTHER)
from helpers.optional import given
from helpers.settings import valid_settings


def test_defaults_are_those_of_the_contract():
    assert as_parameters(parse({'robots': ['a', 'b']})) == {
        'robots': ['a', 'b'],
        'anchor': 'a',
        'anchor_pose': [0.0, 0.0, 0.0],
        'anchor_sigma': [0.0, 0.0, 0.0],
        'initialpose_robot': '',
        'filter': 'fej',
        'update_iterations': 0,
        'compressed': True,
        'odometry_sigma': [0.05, 0.05, 0.02],
        'landmark_sigma': [0.1, 0.1],
        'odometry_scale': [1.0, 1.0],
        'odometry_turn_bias': 0.0,
        'observation_range_scale': 1.0,
        'observation_bearing_bias': 0.0,
        'observation_noise_growth': 0.0,
        'odometry_noise_scale': 1.0,
        'landmark_noise_scale': 1.0,
        'robot_noise_scale': 1.0,
        'start_covariance': 'anchored',
        'gate_probability': 0.999,
        'match_probability': 0.99,
        'inflate_rejected_scans': False,
        'max_landmarks': 2500,
        'moved_landmarks': 'report',
        'max_delay': 0.1,
        'stale_after': 1.0,
        'future_limit': 5.0,
        'max_observations': 500,
        'keyframe_distance': 0.0,
        'clock_limit': 1.0,
        'on_time_jump': 'refuse',
        'join_min_landmarks': 3,
        'join_probability': 0.99,
        'join_heading_sigma': 0.1,
        'shared_landmark_ids': True,
        'prior_landmarks': '',
        'unused_variance': 0.0,
        'map_frame': 'map',
        'map_period': 1.0,
        'publish_tf': True,
        'publish_smoothed_tf': False,
        'tf_topics': 'shared',
        'transform_tolerance': 0.1,
        'output': '',
        'checkpoint': '',
        'autosave_period': 0.0,
        'restore': '',
        'autostart': True,
        'strict_parameters': False,
        'exchange_rate': 100_000.0,
        'exchange_period': 0.5,
        'exchange_file': '',
        'a.id': 1,
        'a.sensor_pose': [0.0, 0.0, 0.0],
        'a.sensor_delay': 0.0,
        'a.max_speed': 50.0,
        'a.use_odometry_covariance': True,
        'a.max_turn_rate': 10.0,
        'a.odometry_sigma': [0.05, 0.05, 0.02],
        'a.landmark_sigma': [0.1, 0.1],
        'a.odometry_scale': [1.0, 1.0],
        'a.odometry_turn_bias': 0.0,
        'a.observation_range_scale': 1.0,
        'a.observation_bearing_bias': 0.0,
        'a.observation_noise_growth': 0.0,
        'a.odometry_noise_scale': 1.0,
        'a.landmark_noise_scale': 1.0,
        'a.robot_noise_scale': 1.0,
        'b.id': 2,
        'b.sensor_pose': [0.0, 0.0, 0.0],
        'b.sensor_delay': 0.0,
        'b.max_speed': 50.0,
        'b.use_odometry_covariance': True,
        'b.max_turn_rate': 10.0,
        'b.odometry_sigma': [0.05, 0.05, 0.02],
        'b.landmark_sigma': [0.1, 0.1],
        'b.odometry_scale': [1.0, 1.0],
        'b.odometry_turn_bias': 0.0,
        'b.observation_range_scale': 1.0,
        'b.observation_bearing_bias': 0.0,
        'b.observation_noise_growth': 0.0,
        'b.odometry_noise_scale': 1.0,
        'b.landmark_noise_scale': 1.0,
        'b.robot_noise_scale': 1.0,
    }


@given(valid_settings())
def test_ros_parameters_give_the_settings_they_were_made_from(settings):
    assert parse(as_parameters(settings)) == settings


def test_every_setting_is_a_parameter():
    known = {name.removeprefix('<robot>.') for name in known_parameters()}
    declared = (*fields(Settings), *fields(NodeSettings), *fields(RobotSettings))
    assert known == {field.name for field in declared} - {'name'}


def test_no_parameter_is_declared_for_estimation_and_for_the_node():
    assert not {f.name for f in fields(Settings)} & {f.name for f in fields(NodeSettings)}


def test_the_smoother_ignores_parameters_of_the_filter():
    assert known_parameters().keys() - known_parameters(audience=SMOOTHER).keys() == {
        'initialpose_robot', 'filter', 'update_iterations', 'compressed', 'start_covariance',
        'match_probability', 'inflate_rejected_scans', 'max_landmarks',
        'moved_landmarks', 'join_heading_sigma', 'prior_landmarks', 'relative_poses',
        'publish_tf', '<robot>.start_pose', '<robot>.start_sigma'}


def test_the_settings_of_the_node_do_not_decide_the_result():
    settings = parse({'robots': ['a']})
    assert as_parameters(settings).keys() - deciding(settings.estimation).keys() == {
        'clock_limit', 'on_time_jump', 'unused_variance', 'map_frame', 'map_period', 'output',
        'autostart', 'strict_parameters', 'prior_landmarks', 'publish_tf',
        'publish_smoothed_tf', 'tf_topics',
        'transform_tolerance', 'checkpoint', 'autosave_period', 'restore',
        'exchange_rate', 'exchange_period', 'exchange_file'}


@pytest.mark.parametrize(
    ('name', 'line'),
    [
        ('r1.id', 'ID of the robot in <robot>/robots clouds; default: position in robots, from 1'),
        (
            'max_delay',
            'maximum delay at which data are still processed in order [s]; default: 0.1',
        ),
        (
            'r2.landmark_sigma',
            (
                'standard deviations of observations without covariance [m]; '
                'default: the global landmark_sigma'
            ),
        ),
    ],
)
def test_a_description_has_help_unit_and_default(name, line):
    assert str(known_parameters(['r1', 'r2'])[name]) == line


@pytest.mark.parametrize(
    'kind', [p.kind for p in known_parameters(['r1', 'r2']).values() if p.kind.within is not None])
def test_values_beyond_the_ends_of_a_range_are_rejected(kind):
    low, high = kind.within.low, kind.within.high
    assert kind.read(value_of(kind, high)) is not None
    assert (kind.read(value_of(kind, low)) is None) == kind.within.excludes_low
    for beyond in (
        (low - 1, high + 1) if kind.element is int
        else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    ):
        assert kind.read(value_of(kind, beyond)) is None


def value_of(kind, x):
    """Return a value of a kind with one element, or all, equal to x."""
    return [x] * kind.shape[0] if kind.shape else x
