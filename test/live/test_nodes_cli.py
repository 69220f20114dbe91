# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Invalid arguments and parameters end a node with exit status 2 and one sentence."""

import json

import pytest

from helpers.optional import optional
from helpers.ros import run_verb, write_bag, write_parameters

live_helpers = optional('helpers.live')

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('domain')]


#: Otherwise an unknown parameter is a warning, and the node runs.
STRICT = {'strict_parameters': True}


def sentence(errors):
    """Return the last line, which is ours; ROS can log its own errors before."""
    *of_ros, last = errors.splitlines()
    assert all(line.startswith('[ERROR]') for line in of_ros)
    return last


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'robots': ['r1'], 'max_dely': 1.0, **STRICT}, ["'max_dely'", "'max_delay'"]),
        ({'robots': ['r1'], 'r2.id': 1, **STRICT}, ["'r2' is not in robots", "'r1.id'"]),
        ({'robots': ['r1'], 'max_delay': 'soon'}, ["'max_delay'", 'a number', "'soon'"]),
        ({'robots': ['r1'], 'gate_probability': 1.5}, ["'gate_probability'", '1.5']),
        ({'robots': 'r1'}, ["'robots'", 'a list']),
        ({'filter': 'fej'}, ["'robots'", 'list the robots']),
        ({'robots': []}, ['robots: [r1, r2]']),
        ({'robots': ['r1'], 'anchor_pose': [0, 0.5, 0]}, ['given.yaml: ', '[0.0, 0.5, 0.0]']),
    ],
)
def test_an_estimator_rejects_invalid_parameters(
    tmp_path, capfd, values, parts,
):
    path = write_parameters(tmp_path / 'given.yaml', **values)

    assert run_verb('estimator', '--ros-args', '--params-file', path) == 2

    error = sentence(capfd.readouterr().err)
    assert error.startswith('estimator: ')
    assert all(part in error for part in parts), error


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'land_marks': 5, **STRICT}, ["'land_marks'", "'landmarks'"]),
        ({'landmarks': 1}, ['landmarks: 1', '2 or more']),
        ({'environment': 'moon'}, ["'environment'", "'moon'"]),
    ],
)
def test_a_simulator_rejects_invalid_parameters(
    tmp_path, capfd, values, parts,
):
    path = write_parameters(tmp_path / 'given.yaml', **values)

    assert run_verb('simulator', '--ros-args', '--params-file', path) == 2

    error = sentence(capfd.readouterr().err)
    assert all(part in error for part in parts), error


@pytest.mark.parametrize(
    ('words', 'part'),
    [
        (['--params-file', 'nowhere.yaml'], 'nowhere.yaml does not exist'),
        (['--bogus'], '--bogus'),
        (['-p', 'robots'], 'robots'),
    ],
)
@pytest.mark.parametrize('verb', ['estimator', 'simulator', 'smoother'])
def test_a_node_rejects_unknown_ros_arguments(capfd, verb, words, part):
    assert run_verb(verb, '--ros-args', *words) == 2
    assert part in sentence(capfd.readouterr().err)


@pytest.mark.parametrize(('option', 'rule', 'form'), [
    ('-r', '__ns:=fleet', '-r __ns:=/NAME'),
    ('-r', '__ns:=/1st', '-r __ns:=/NAME'),
    ('-r', 'r1/odom', '-r OLD:=NEW'),
    ('-p', 'robots:=[r1', '-p NAME:=VALUE'),
    ('-p', 'anchor_pose:=[1, 2.5, 0]', 'no list mixes integers and floats'),
])
def test_a_rule_that_ros_refuses_is_rejected_with_its_form(capfd, option, rule, form):
    assert run_verb('estimator', '--ros-args', option, rule) == 2

    # ROS warns of a namespace before.
    error = capfd.readouterr().err.splitlines()[-1]
    assert error.startswith(f"estimator: ROS does not accept '{option} {rule}': write ")
    assert form in error


@pytest.mark.parametrize(('verb', 'kind'), [
    ('estimator', 'odom'), ('smoother', 'robots'), ('detector', 'scan')])
def test_one_topic_for_two_robots_is_rejected(capfd, verb, kind):
    rules = '-r', f'r1/{kind}:=/{kind}', '-r', f'r2/{kind}:=/{kind}'

    assert run_verb(verb, '--ros-args', '-p', 'robots:=[r1, r2]', *rules) == 2

    error = capfd.readouterr().err.splitlines()[-1]
    assert error == (
        f"{verb}: the topics 'r1/{kind}' and 'r2/{kind}' are both remapped to /{kind}: give each"
        ' robot its own')


@pytest.mark.parametrize(('name', 'fault'), [('.', 'is a folder'), ('none', 'does not exist')])
def test_a_parameter_file_that_is_none_is_rejected_with_the_reason(tmp_path, capfd, name, fault):
    path = tmp_path / name

    assert run_verb('estimator', '--ros-args', '--params-file', path) == 2

    assert sentence(capfd.readouterr().err).startswith(f'estimator: {path} {fault}: give the path')


@pytest.mark.parametrize(('text', 'cure'), [
    ('a: [', 'correct line 1, which is not YAML'),
    ('/**:\n\tros__parameters:\n', 'correct line 2, which is not YAML'),
    ('robots: [r1]\n', 'put them under /**: and ros__parameters:'),
    ('/**:\n  ros_parameters:\n    robots: [r1]\n', 'put them under /**: and ros__parameters:'),
    ('/**: {ros__parameters: 3}', 'put them under /**: and ros__parameters:'),
    ('/**:\n  ros__parameters:\n    robots:\n', "'robots' has no value: give it one")])
def test_a_file_that_ros_refuses_is_rejected_with_the_cure(tmp_path, capfd, text, cure):
    path = tmp_path / 'given.yaml'
    path.write_text(text)

    assert run_verb('estimator', '--ros-args', '--params-file', path) == 2
    error = sentence(capfd.readouterr().err)
    assert error.startswith(f'estimator: {path}: ')
    assert cure in error


def test_an_estimator_does_not_overwrite_results(tmp_path, capfd):
    (tmp_path / 'summary.json').write_text(json.dumps({}))

    words = '-p', 'robots:=[r1]', '-p', f'output:={tmp_path}'
    assert run_verb('estimator', '--ros-args', *words) == 2

    # A node has no option --force.
    assert sentence(capfd.readouterr().err).endswith(
        'summary.json exists: choose another path, or remove it')


@pytest.mark.parametrize('rate', ['0', '-1', 'nan', 'inf', 'fast'])
def test_play_rejects_an_invalid_rate(tmp_path, capfd, rate):
    assert run_verb('play', tmp_path, f'--rate={rate}') == 2
    assert '--rate' in capfd.readouterr().err


def test_play_names_a_bag_without_topics(tmp_path, capfd):
    write_bag(tmp_path / 'bag', [])

    assert run_verb('play', tmp_path / 'bag') == 1
    assert sentence(capfd.readouterr().err) == (
        f'play: {tmp_path / "bag"} has no topics: give another bag')


def test_play_names_a_missing_bag(tmp_path, capfd):
    assert run_verb('play', tmp_path / 'nothing') == 1
    assert str(tmp_path / 'nothing') in sentence(capfd.readouterr().err)


@pytest.mark.slow
def test_an_invalid_parameter_ends_the_process_without_a_traceback(domain):
    words = '-p', 'max_dely:=1.0', '-p', 'robots:=[r1]', '-p', 'strict_parameters:=true'
    process = domain.start('estimator', '--ros-args', *words)

    status, errors = domain.finish(process)

    assert status == 2
    assert errors.count('\n') == 1


def test_a_smoother_rejects_odometry_without_noise(tmp_path, capfd):
    values = {'robots': ['r1'], 'odometry_sigma': [0.1, 0.1, 0.0]}
    path = write_parameters(tmp_path / 'given.yaml', **values)

    assert run_verb('smoother', '--ros-args', '--params-file', path) == 2
    assert sentence(capfd.readouterr().err).startswith(
        "smoother: parameter 'odometry_sigma' contains 0")
