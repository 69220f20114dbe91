# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings declare their parameters completely."""

from dataclasses import fields, MISSING

import pytest

from fej_slam_ros.core.data_association.wrong_landmarks import MOVED_LANDMARKS
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.joining.initialization import START_COVARIANCES
from fej_slam_ros.core.parameter_kinds import one_of, parameters_of
from fej_slam_ros.core.settings import RobotSettings, Settings


@pytest.mark.parametrize(('name', 'registry'), [
    ('filter', LINEARIZATIONS), ('start_covariance', START_COVARIANCES),
    ('moved_landmarks', MOVED_LANDMARKS)])
def test_each_choice_has_an_implementation_and_each_implementation_can_be_chosen(name, registry):
    assert parameters_of(Settings)[name].kind.expected == one_of(*registry).expected


@pytest.mark.parametrize('settings', [Settings, RobotSettings])
def test_each_default_is_a_possible_value(settings):
    parameters = parameters_of(settings)
    for field in fields(settings):
        if field.default not in (MISSING, None):
            assert parameters[field.name].kind.read(field.default) == field.default
