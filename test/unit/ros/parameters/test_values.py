# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values of parameters are those that are declared, or an error or warning of one sentence."""

from array import array
from itertools import permutations
import math
import re

import numpy as np
import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import (
    adapter_settings, detector_settings, known_parameters, parse)
from fej_slam_ros.ros.parameters.adapter_settings import parse_adapter
from fej_slam_ros.ros.parameters.detector_settings import parse_detector
from fej_slam_ros.ros.parameters.values import RENAMED_PARAMETERS, warn_once


@pytest.mark.parametrize(
    'pose', [[1, 2.5, 3], (1, 2.5, 3), array('d', [1.0, 2.5, 3.0]), np.array([1.0, 2.5, 3.0])]
)
def test_integers_and_arrays_are_accepted_as_floats(pose):
    settings = parse({'robots': ['r1'], 'anchor_pose': pose, 'max_delay': 2}).estimation
    expected = parse({'robots': ['r1'], 'anchor_pose': [1.0, 2.5, 3.0], 'max_delay': 2.0})
    assert settings == expected.estimation
    assert {type(x) for x in (*settings.anchor_pose, settings.max_delay)} == {float}


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('use_sim_time', True),
        ('start_type_description_service', False),
        ('qos_overrides./tf.publisher.depth', 7),
        ('qos_overrides./r1/odom.subscription.reliability', 'reliable'),
        ('qos_overrides./r1/pose.publisher.deadline', 100_000_000),
    ],
)
def test_parameters_of_every_node_are_accepted(name, value):
    assert parse({'robots': ['r1'], name: value}) == parse({'robots': ['r1']})


@pytest.mark.parametrize(
    ('policy', 'value', 'expected'),
    [
        ('reliability', 'realiable', "one of 'reliable', 'best_effort', "),
        ('durability', True, "one of 'volatile', 'transient_local', "),
        ('history', 'none', "one of 'keep_last', 'keep_all', "),
        ('depth', -1, 'an integer from 0 to 2147483647, not -1'),
        ('depth', 'deep', "an integer from 0 to 2147483647, not 'deep'"),
    ],
)
def test_an_impossible_quality_of_service_is_rejected(policy, value, expected):
    name = f'qos_overrides./r1/odom.subscription.{policy}'
    with pytest.raises(UsageError, match=re.escape(f'parameter {name!r} must be {expected}')):
        parse({'robots': ['r1'], name: value})


@pytest.mark.parametrize(
    ('unknown', 'value', 'nearest'),
    [
        ('gate_probabilty', 0.9, "did you mean 'gate_probability'?"),
        ('stale', 5, "did you mean 'stale_after'?"),
        ('r1.start', [0, 0, 0], "did you mean 'r1.start_pose'?"),
        ('r1/start_pose', [0, 0, 0], "did you mean 'r1.start_pose'?"),
        ('r7.start_pose', [0, 0, 0], "'r7' is not in robots, did you mean 'r2.start_pose'?"),
    ])
def test_an_unknown_parameter_is_a_warning_or_if_strict_an_error(unknown, value, nearest):
    warnings = []
    values = {'robots': ['r1', 'r2'], unknown: value}

    assert parse(values, warnings.append) == parse({'robots': ['r1', 'r2']})
    assert warnings == [f'unknown parameter {unknown!r} is ignored: {nearest}']
    with pytest.raises(UsageError) as caught:
        parse({**values, 'strict_parameters': True})
    assert str(caught.value) == f'unknown parameter {unknown!r}: {nearest}'


def test_no_name_is_proposed_for_an_unknown_parameter_that_is_like_none():
    warnings = []

    parse(
        {'robots': ['r1'], 'camera_topic': '/image', 'pid.p': 3.0, 'r7.usb_port': 3},
        warnings.append)

    assert warnings == [
        "unknown parameter 'camera_topic' is ignored",
        "unknown parameter 'pid.p' is ignored: 'pid' is not in robots",
        "unknown parameter 'r7.usb_port' is ignored: 'r7' is not in robots"]


#: With long names, of which those of two parameters have much in common.
TEAM = ['turtlebot_1', 'turtlebot_2']
PARSERS = {
    'estimator': (parse, known_parameters),
    'detector': (parse_detector, detector_settings.known_parameters),
    'adapter': (parse_adapter, adapter_settings.known_parameters)}


@pytest.mark.parametrize('node', ['detector', 'adapter'])
def test_a_front_end_ignores_the_parameters_of_the_estimator_in_a_shared_file(node):
    parser, names = PARSERS[node]
    warnings, own = [], {'robots': TEAM, 'strict_parameters': True}
    # One of its robots has neither laser nor camera.
    of_all = [*TEAM, 'turtlebot_3']
    of_estimator = dict.fromkeys(known_parameters(of_all).keys() - names(of_all).keys(), 0)

    assert parser(of_estimator | own, warnings.append) == parser(own)
    assert warnings == []


@pytest.mark.parametrize(('node', 'other'), [
    pair for pair in permutations(PARSERS, 2) if pair[1] != 'estimator'])
def test_no_name_is_proposed_for_a_parameter_of_another_node_in_a_shared_file(node, other):
    parser, names = PARSERS[node]
    unknown = PARSERS[other][1](TEAM).keys() - {*names(TEAM), *known_parameters(TEAM)}
    warnings = []

    for name in unknown:
        parser({'robots': TEAM, name: 0}, warnings.append)

    assert set(warnings) == {f'unknown parameter {name!r} is ignored' for name in unknown}


def test_numbers_of_tags_are_rejected_with_the_way_to_write_them():
    with pytest.raises(UsageError, match=r"'r1\.tags' must be .* in quotes, not \[7, 8\]$"):
        parse_adapter({'robots': ['r1'], 'r1.tags': [7, 8]})
    assert parse_adapter({'robots': ['r1'], 'r1.tags': ['7', '8']})


@pytest.mark.parametrize('words', ['r1,r2', 'r1, r2', 'r1 r2'])
def test_robots_that_are_no_list_are_rejected_with_the_list_to_write(words):
    """Those of launch files are separated by commas."""
    with pytest.raises(UsageError, match=r"'robots' must be a list, .* write \[r1, r2\]$"):
        parse({'robots': words})


def test_a_team_must_be_given():
    with pytest.raises(UsageError, match="'robots' is missing"):
        parse({'anchor': 'r1'})


@pytest.mark.parametrize(('name', 'valid'), [
    ('r-1', 'r_1'), ('1r', 'robot_1r'), ('r1/a', 'r1_a'), ('/r1', 'r1'), ('_r', 'r'),
    ('r1\n', 'r1'), ('/r-1/', 'r_1'), ('a - b', 'a_b'), ('é', 'robot'), ('', 'robot')])
def test_a_name_that_no_namespace_may_have_is_explained_with_a_valid_one(name, valid):
    sentence = (
        f"parameter 'robots' contains {name!r}: a robot is a namespace of topics, and ROS names"
        f' begin with a letter and go on with letters, digits and _; list {valid!r}, and remap')

    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}'):
        parse({'robots': ['r1', name]})
    assert parse({'robots': [valid]})


def test_the_name_of_a_robot_has_at_most_64_characters():
    assert parse({'robots': ['r' * 64]})

    with pytest.raises(UsageError, match=r'a name of 1,000 characters: .* at most 64$') as error:
        parse({'robots': ['r1', 'r' * 1000]})
    assert len(str(error.value)) < 1000


def test_a_team_has_at_most_100_robots():
    names = [f'r{k}' for k in range(101)]

    assert parse({'robots': names[:100]})
    with pytest.raises(UsageError, match=r"'robots' lists 101 robots: list at most 100$"):
        parse({'robots': names})


@pytest.mark.parametrize(
    'value', ['x' * 10**6, [1.0] * 10**6, 16**5000, {'a': 'x' * 10**6}],
    ids=['text', 'list', 'integer', 'map'])
def test_a_value_is_shown_by_its_beginning(value):
    with pytest.raises(UsageError, match="'max_delay' must be a number from 0 to 1e9") as error:
        parse({'robots': ['r1'], 'max_delay': value})

    assert len(str(error.value)) < 1000


@pytest.mark.parametrize(('name', 'pose'), [
    ('anchor_pose', [90.0, 90.0, -90.0]), ('r2.start_pose', [90.0, 90.0, -90.0]),
    ('r1.sensor_pose', [90.0, 90.0, -90.0])])
def test_an_angle_in_degrees_is_a_warning_with_its_value_in_radians(name, pose):
    warnings = []
    in_degrees = {'robots': ['r1', 'r2'], name: pose}

    parse(in_degrees, warnings.append)

    sentence, = warnings
    assert sentence.startswith(f'parameter {name!r} has an angle of -90 rad, more than a turn')
    assert sentence.endswith(' write -1.5708')


def test_each_angle_of_a_camera_in_degrees_is_a_warning():
    warnings = []

    parse_adapter(
        {'robots': ['r1'], 'r1.sensor_pose': [7.0, 7.0, 7.0, -90.0, 0.0, -45.0]}, warnings.append)

    assert [sentence[-7:] for sentence in warnings] == ['-1.5708', '-0.7854']


def test_angles_up_to_a_turn_are_no_warning():
    parse({'robots': ['r1'], 'anchor_pose': [0.0, 0.0, math.tau]}, pytest.fail)


def test_thousands_of_unknown_parameters_are_a_few_warnings():
    warnings = []

    parse({'robots': ['r1'], **{f'unknown{k}': k for k in range(10_000)}}, warnings.append)

    assert len(warnings) == 21
    assert warnings[-1] == '9980 more unknown parameters are ignored'


@pytest.mark.parametrize(
    ('name', 'expected', 'values'),
    [
        (
            'robots',
            'a list of names that begin with a letter and go on with letters, digits and _',
            [1, [1], [True], [None]],
        ),
        ('anchor', "one of 'r1', 'r2', ''", [1, None, ['r1']]),
        *(
            (
                name,
                'a number from 0 to 1e9',
                [-1.0, 2e9, math.nan, math.inf, 10**400, True, '1', [1.0]],
            )
            for name in (
                'max_delay', 'stale_after', 'future_limit', 'clock_limit', 'unused_variance')
        ),
        (
            'gate_probability',
            'a number above 0 and up to 1',
            [0, -0.5, 1.0000001, 99, math.nan, True, '0.9'],
        ),
        *(
            (
                name,
                'three numbers [x, y, yaw] from -1e9 to 1e9',
                [[0.0] * 2, [0.0] * 4, [2e9, 0.0, 0.0], [0.0, 0.0, math.nan], 0.0, '000'],
            )
            for name in ('anchor_pose', 'r2.start_pose', 'r1.sensor_pose')
        ),
        *(
            (
                name,
                'three numbers [x, y, yaw] from 0 to 1e6',
                [[0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, math.inf], [True, 0.0, 0.0], 0.1],
            )
            for name in ('anchor_sigma', 'odometry_sigma', 'r1.odometry_sigma', 'r2.start_sigma')
        ),
        *(
            (
                name,
                'two numbers [x, y] from 1e-6 to 1e6',
                [[0.1], [0.1] * 3, [0.1, 0.0], [-0.1, 0.1], [0.1, math.inf], ['0.1', 0.1], 0.1],
            )
            for name in ('landmark_sigma', 'r2.landmark_sigma')
        ),
        ('r2.robot_noise_scale', 'a number from 0.001 to 1000', [0.0, 2000.0, math.nan, '1']),
        ('r1.id', 'an integer from 0 to 2147483647', [-1, 2**31, 1.0, True, '1', [1]]),
        ('shared_landmark_ids', 'true or false', [1, 0, 'yes', None, [True]]),
        ('r1.sensor_frame', 'one line of text', [1, None, 'a\nb', 'a\x00', 'a\u2028b', ['a']]),
        ('output', "a path that does not begin with '~', in one line", [
            1, None, 'a\nb', '~/run', '~', ['a']]),
    ],
)
def test_a_rejected_value_is_shown_with_what_it_must_be(name, expected, values):
    for value in values:
        sentence = f'parameter {name!r} must be {expected}, not {value!r}'
        with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
            parse({'robots': ['r1', 'r2'], name: value})


def test_a_bad_array_from_ros_is_shown_as_a_list():
    with pytest.raises(UsageError, match=re.escape('not [1.0, 2.0]')):
        parse({'robots': ['r1'], 'anchor_pose': array('d', [1.0, 2.0])})


def test_an_old_name_is_accepted_with_a_warning():
    warnings = []
    settings = parse({'robots': ['r1'], 'second_look': True}, warnings.append)
    assert settings == parse({'robots': ['r1'], 'inflate_rejected_scans': True})
    assert warnings == [
        "parameter 'second_look' is deprecated: rename it to 'inflate_rejected_scans'"]


def test_a_warning_is_written_once(caplog):
    warn_once.cache_clear()
    for _ in range(3):
        parse({'robots': ['r1'], 'second_look': False})
    assert len([record for record in caplog.records if 'second_look' in record.message]) == 1


def test_old_and_new_name_together_are_rejected():
    with pytest.raises(UsageError, match=re.escape(
            "parameter 'second_look' is the old name of 'inflate_rejected_scans': give only"
            " 'inflate_rejected_scans'")):
        parse({'robots': ['r1'], 'second_look': True, 'inflate_rejected_scans': True})


def test_every_renamed_parameter_has_its_new_name():
    assert set(RENAMED_PARAMETERS.values()) <= known_parameters().keys()
    assert not RENAMED_PARAMETERS.keys() & known_parameters().keys()
