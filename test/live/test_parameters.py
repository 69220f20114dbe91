# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a running node: what may change, what may not and why, and what it leaves."""

import pytest

from fej_slam_ros.ros.parameters import parse
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.optional import optional
from helpers.ros import meeting, raw_record, save, summary_of, write_parameters

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')
Parameter = optional('rclpy.parameter').Parameter

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2']}


def set_parameter(domain, name, value, node='estimator'):
    """Set a parameter as ``ros2 param set`` does; return the result."""
    message = Parameter(name, value=value).to_parameter_msg()
    result, = domain.ask(
        f'/{node}/set_parameters', services.SetParameters, parameters=[message]).results
    return result


def get(node, name):
    """Return the value of a parameter of a node."""
    value = node.get_parameter(name).value
    return value.tolist() if hasattr(value, 'tolist') else value


@pytest.mark.parametrize(('name', 'value', 'read'), [
    ('gate_probability', 0.99, 0.99),
    ('map_period', 2, 2.0),
    ('r2.odometry_sigma', [1, 1, 1], [1.0, 1.0, 1.0]),
    ('moved_landmarks', 'forget', 'forget'),
])
def test_a_changeable_parameter_is_set_and_an_integer_is_a_number(domain, name, value, read):
    node = domain.estimate(**TEAM)

    assert set_parameter(domain, name, value).successful

    assert get(node, name) == read


def test_only_a_value_that_differs_is_logged_as_a_change(domain, capfd):
    domain.estimate(**TEAM)

    assert set_parameter(domain, 'gate_probability', 0.999).successful
    assert set_parameter(domain, 'gate_probability', 0.99).successful

    changes = [line for line in capfd.readouterr().err.splitlines() if ' changed from ' in line]
    assert [line.partition(']: ')[2] for line in changes] == [
        "parameter 'gate_probability' changed from 0.999 to 0.99"]


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('filter', 'standard', "'filter' is read when the node starts: set it in the parameter file"),
    ('r2.id', 7, "'r2.id' is read when the node starts"),
    ('gate_probabilty', 0.9, "unknown parameter 'gate_probabilty': did you mean 'gate_prob"),
    ('gate_probability', 0.0, "'gate_probability' must be a number above 0 and up to 1, not 0.0"),
    ('landmark_sigma', [0.1], "'landmark_sigma' must be two numbers [x, y] from 1e-6"),
    ('autosave_period', 5.0, "'autosave_period' needs a file: give 'checkpoint' too"),
])
def test_a_rejected_change_says_why_and_changes_nothing(domain, name, value, reason):
    node = domain.estimate(**TEAM)
    before = node.has_parameter(name) and get(node, name)

    result = set_parameter(domain, name, value)

    assert not result.successful
    assert reason in result.reason
    assert (node.has_parameter(name) and get(node, name)) == before


def test_noise_of_the_team_is_that_of_robots_without_noise_of_their_own(domain):
    node = domain.estimate(**TEAM, **{'r2.landmark_noise_scale': 3.0})

    assert set_parameter(domain, 'landmark_noise_scale', 2.0).successful

    assert get(node, 'r1.landmark_noise_scale') == 2.0
    assert get(node, 'r2.landmark_noise_scale') == 3.0


def test_a_change_decides_the_steps_after_it_and_is_in_the_summary(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'out'))
    messages = [*map(raw_record, meeting())]
    domain.send(*messages)
    domain.until(lambda: node.received == len(messages))

    assert set_parameter(domain, 'gate_probability', 0.9).successful
    assert set_parameter(domain, 'robots', ['r1']).successful

    domain.end_estimate()
    summary = summary_of(tmp_path / 'out')
    changes = [(c['parameter'], c['before'], c['after']) for c in summary['parameter_changes']]
    assert changes == [('gate_probability', 0.999, 0.9), ('robots', ['r1', 'r2'], ['r1'])]
    assert summary['config']['gate_probability'] == 0.999


def test_a_new_run_keeps_changed_parameters(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'out'))
    assert set_parameter(domain, 'gate_probability', 0.9).successful

    assert domain.call('/estimator/reset')

    domain.end_estimate()
    config = summary_of(tmp_path / 'out_2')['config']
    assert config['gate_probability'] == get(node, 'gate_probability') == 0.9


def test_a_restored_run_has_the_changed_parameters(domain, tmp_path):
    path = str(tmp_path / 'run.checkpoint')
    run = EstimatorSession(parse(TEAM | {'checkpoint': path}), None)
    run.change_parameters({'r2.landmark_noise_scale': 2.0, 'max_delay': 0.5})
    save(run)

    node = domain.estimate(**TEAM, restore=path)

    assert (get(node, 'r2.landmark_noise_scale'), get(node, 'max_delay')) == (2.0, 0.5)


@pytest.mark.slow
def test_an_unknown_parameter_is_a_warning_with_the_nearest_name(domain, tmp_path):
    path = write_parameters(tmp_path / 'shared.yaml', **TEAM, gate_probabilty=0.9, use_gui=True)
    estimator = domain.start('estimator', '--ros-args', '--params-file', path)
    domain.wait_for_reports()

    names = domain.ask('/estimator/list_parameters', services.ListParameters).result.names
    _, errors = domain.finish(estimator, 2)

    assert (
        "unknown parameter 'gate_probabilty' is ignored: did you mean 'gate_probability'?"
        in errors)
    assert {'gate_probabilty', 'use_gui'}.isdisjoint(names)


def test_a_file_without_a_section_for_the_node_is_named(domain, tmp_path):
    path = tmp_path / 'other.yaml'
    path.write_text('estimatr: {ros__parameters: {max_delay: 0.7}}\n')
    estimator = domain.start(
        'estimator', '--ros-args', '--params-file', str(path), '-p', 'robots:=[r1]')
    domain.wait_for_reports()

    _, errors = domain.finish(estimator, 2)

    assert f"{path}: no parameters for the node 'estimator', only for /estimatr" in errors


def test_strict_parameters_refuse_an_unknown_one(domain, tmp_path):
    path = write_parameters(
        tmp_path / 'own.yaml', **TEAM, gate_probabilty=0.9, strict_parameters=True)

    status, errors = domain.finish(domain.start('estimator', '--ros-args', '--params-file', path))

    assert status == 2
    assert "unknown parameter 'gate_probabilty': did you mean 'gate_probability'?" in errors


@pytest.mark.slow
def test_the_smoother_changes_what_its_node_reads_and_lists_what_it_does_not(domain, tmp_path):
    path = write_parameters(tmp_path / 'team.yaml', **TEAM, publish_tf=False, filter='standard')
    smoother = domain.start('smoother', '--ros-args', '--params-file', path)

    assert set_parameter(domain, 'map_period', 2.0, 'smoother').successful
    result = set_parameter(domain, 'gate_probability', 0.9, 'smoother')

    assert not result.successful
    assert 'is read when the node starts' in result.reason
    status, log = domain.finish(smoother, 2)
    assert status == 0
    assert 'parameters that this node does not read: ' in log
    assert 'publish_tf' in log


def test_limits_of_lists_are_in_their_descriptors(domain):
    domain.estimate(**TEAM)

    described, read_only = domain.ask(
        '/estimator/describe_parameters', services.DescribeParameters,
        names=['r1.landmark_sigma', 'filter']).descriptors

    limits, = described.floating_point_range
    assert (limits.from_value, limits.to_value) == (1e-6, 1e6)
    assert described.additional_constraints == 'two numbers [x, y] from 1e-6 to 1e6'
    assert read_only.read_only
    assert not described.read_only
