# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings declare their parameters completely."""

from dataclasses import fields, MISSING, replace
import math
import re

import numpy as np
import pytest

from fej_slam_ros.core import Estimator, TeamSmoother
from fej_slam_ros.core.data_association.wrong_landmarks import MOVED_LANDMARKS
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.joining.initialization import START_COVARIANCES
from fej_slam_ros.core.parameter_kinds import one_of, parameters_of
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.errors import UsageError

#: The settings of a team of two robots.
TEAM = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1')


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


@pytest.mark.parametrize(('wrong', 'sentence'), [
    ({'filter': 'FEJ'},
     "'filter' must be one of 'fej', 'invariant', 'standard', 'ideal', not 'FEJ'"),
    ({'anchor': 'r9'}, "'anchor' must be one of 'r1', 'r2', not 'r9'"),
    ({'moved_landmarks': None},
     "'moved_landmarks' must be one of 'report', 'forget', 'ignore', not None"),
    ({'gate_probability': math.nan},
     "'gate_probability' must be a number above 0 and up to 1, not nan"),
    ({'robots': (RobotSettings('r1', 1, landmark_sigma=(0.1, 0.0)),)},
     "'r1.landmark_sigma' must be two numbers [x, y] from 1e-6 to 1e6, not (0.1, 0.0)"),
])
def test_an_estimator_refuses_an_impossible_value_by_its_name(wrong, sentence):
    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
        Estimator(replace(TEAM, **wrong))


def test_an_estimator_takes_numbers_and_arrays_of_numpy():
    robots = RobotSettings('r1', 1), RobotSettings('r2', 2, np.array([1.0, 2.0, 0.5]))

    estimator = Estimator(replace(TEAM, robots=robots, max_landmarks=np.int64(7)))

    assert estimator.settings.max_landmarks == 7


def test_a_smoother_of_a_team_refuses_an_anchor_that_is_none_of_its_robots():
    with pytest.raises(UsageError, match="'anchor' must be one of 'r1', 'r2', not 'r9'"):
        TeamSmoother(replace(TEAM, anchor='r9'))
