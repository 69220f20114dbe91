# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters mean the same in YAML, in ROS and in settings, and every mistake is explained."""

from array import array
from dataclasses import fields, replace
import math
import re

import numpy as np
import pytest

from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import as_parameters, describe, dump, kinds, load, parse, TAKEN
from helpers.optional import given, strategies as st
from helpers.paths import ROOT

NUMBERS = st.floats(-1e9, 1e9)
NOT_NEGATIVE = st.floats(0.0, 1e6)
POSITIVE = st.floats(1e-6, 1e6)
POSES = st.tuples(NUMBERS, NUMBERS, NUMBERS)
PERIOD = st.floats(0.01, 1e6)
POSE_SIGMAS = st.tuples(NOT_NEGATIVE, NOT_NEGATIVE, NOT_NEGATIVE)
POINT_SIGMAS = st.tuples(POSITIVE, POSITIVE)
SCALES = st.floats(1e-3, 1e3)
LINES = st.text(st.characters(codec='utf-8', exclude_categories=('Cc', 'Cn', 'Zl', 'Zp')))
# YAML or ROS could take these words for something else than the name of a robot.
TRAPS = ['no', 'on', 'true', 'null', 'nan', 'e5', 'fej', 'qos_overrides', 'ros__parameters']
NAMES = st.sampled_from(TRAPS) | st.from_regex(
    '[A-Za-z][A-Za-z0-9_]{0,20}', fullmatch=True
).filter(lambda name: name not in TAKEN)
ROBOTS = st.builds(
    RobotSettings,
    name=NAMES,
    id=st.integers(0, 2**31 - 1),
    sensor_pose=POSES,
    sensor_frame=st.none() | LINES,
    odometry_sigma=POSE_SIGMAS,
    landmark_sigma=POINT_SIGMAS,
    odometry_noise_scale=SCALES,
    landmark_noise_scale=SCALES,
    robot_noise_scale=SCALES,
)
UNIQUE = (lambda robot: robot.name, lambda robot: robot.id)


@st.composite
def valid_settings(draw):
    first, *others = draw(st.lists(ROBOTS, min_size=1, max_size=4, unique_by=UNIQUE))
    started = [replace(r, start_pose=draw(POSES), start_sigma=draw(POSE_SIGMAS)) for r in others]
    prior = draw(LINES)
    robots = draw(st.permutations([first, *draw(st.sampled_from([others, started]))]))
    return Settings(
        robots=tuple(robots),
        anchor=draw(st.sampled_from([first.name, ''])) if prior else first.name,
        anchor_pose=draw(POSES),
        anchor_sigma=draw(POSE_SIGMAS),
        filter=draw(st.sampled_from(['fej', 'invariant', 'standard', 'ideal'])),
        update_iterations=draw(st.integers(0, 100)),
        compressed=draw(st.booleans()),
        start_covariance=draw(st.sampled_from(['anchored', 'independent'])),
        gate_probability=draw(st.floats(0.0, 1.0, exclude_min=True)),
        match_probability=draw(st.floats(0.0, 1.0, exclude_min=True)),
        inflate_rejected_scans=draw(st.booleans()),
        moved_landmarks=draw(st.sampled_from(['report', 'forget', 'ignore'])),
        max_delay=draw(NOT_NEGATIVE),
        stale_after=draw(NOT_NEGATIVE),
        future_limit=draw(NOT_NEGATIVE),
        clock_limit=draw(NOT_NEGATIVE),
        on_time_jump=draw(st.sampled_from(['refuse', 'reset'])),
        join_heading_sigma=draw(NOT_NEGATIVE),
        shared_landmark_ids=draw(st.just(True) if prior else st.booleans()),
        prior_landmarks=prior,
        unused_variance=draw(NOT_NEGATIVE),
        map_period=draw(PERIOD),
        publish_tf=draw(st.booleans()),
        output=draw(LINES),
        checkpoint=draw(LINES.filter(lambda line: line not in ('', prior))),
        autosave_period=draw(NOT_NEGATIVE),
        restore=draw(LINES),
        autostart=draw(st.booleans()),
        odometry_sigma=draw(POSE_SIGMAS),
        landmark_sigma=draw(POINT_SIGMAS),
        odometry_noise_scale=draw(SCALES),
        landmark_noise_scale=draw(SCALES),
        robot_noise_scale=draw(SCALES),
    )


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a parameter file."""

    def write(text):
        path = tmp_path / 'params.yaml'
        path.write_text(text, encoding='utf-8')
        return path

    return write


@pytest.fixture
def ros_values():
    """Return a function that reads a parameter file as a node named estimator does."""
    rclpy = pytest.importorskip('rclpy')
    context = rclpy.Context()

    def read(path):
        rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
        node = rclpy.create_node(
            'estimator', context=context, automatically_declare_parameters_from_overrides=True
        )
        values = {name: p.value for name, p in node.get_parameters_by_prefix('').items()}
        node.destroy_node()
        return values

    yield read
    context.try_shutdown()


def test_defaults_are_those_of_the_contract():
    assert as_parameters(parse({'robots': ['a', 'b']})) == {
        'robots': ['a', 'b'],
        'anchor': 'a',
        'anchor_pose': [0.0, 0.0, 0.0],
        'anchor_sigma': [0.0, 0.0, 0.0],
        'filter': 'fej',
        'update_iterations': 0,
        'compressed': True,
        'odometry_sigma': [0.05, 0.05, 0.02],
        'landmark_sigma': [0.1, 0.1],
        'odometry_noise_scale': 1.0,
        'landmark_noise_scale': 1.0,
        'robot_noise_scale': 1.0,
        'start_covariance': 'anchored',
        'gate_probability': 0.999,
        'match_probability': 0.99,
        'inflate_rejected_scans': False,
        'moved_landmarks': 'report',
        'max_delay': 0.1,
        'stale_after': 1.0,
        'future_limit': 5.0,
        'clock_limit': 1.0,
        'on_time_jump': 'refuse',
        'join_min_landmarks': 3,
        'join_probability': 0.99,
        'join_heading_sigma': 0.1,
        'shared_landmark_ids': True,
        'prior_landmarks': '',
        'unused_variance': 0.0,
        'map_period': 1.0,
        'publish_tf': True,
        'output': '',
        'checkpoint': '',
        'autosave_period': 0.0,
        'restore': '',
        'autostart': True,
        'a.id': 1,
        'a.sensor_pose': [0.0, 0.0, 0.0],
        'a.odometry_sigma': [0.05, 0.05, 0.02],
        'a.landmark_sigma': [0.1, 0.1],
        'a.odometry_noise_scale': 1.0,
        'a.landmark_noise_scale': 1.0,
        'a.robot_noise_scale': 1.0,
        'b.id': 2,
        'b.sensor_pose': [0.0, 0.0, 0.0],
        'b.odometry_sigma': [0.05, 0.05, 0.02],
        'b.landmark_sigma': [0.1, 0.1],
        'b.odometry_noise_scale': 1.0,
        'b.landmark_noise_scale': 1.0,
        'b.robot_noise_scale': 1.0,
    }


@given(valid_settings())
def test_settings_survive_the_way_through_ros_parameters(settings):
    assert parse(as_parameters(settings)) == settings


@given(settings=valid_settings())
def test_settings_survive_the_way_through_a_file(tmp_path_factory, settings):
    path = tmp_path_factory.mktemp('dump') / 'params.yaml'
    path.write_text(dump(settings), encoding='utf-8')
    assert load(path) == settings


def test_every_setting_is_a_parameter_with_a_description():
    described = {name.removeprefix('<robot>.') for name in describe()}
    assert described == {f.name for f in (*fields(Settings), *fields(RobotSettings))} - {'name'}


@pytest.mark.parametrize(
    ('name', 'line'),
    [
        ('r1.id', 'number in clouds of robots; default: place in robots, from 1'),
        ('max_delay', 'lateness up to which data are put in order [s]; default: 0.1'),
    ],
)
def test_a_description_tells_meaning_unit_and_default(name, line):
    assert describe(['r1', 'r2'])[name] == line


def test_a_robot_inherits_the_noise_of_the_team():
    own, inherited = parse(
        {
            'robots': ['r1', 'r2'],
            'odometry_sigma': [0.1, 0.2, 0.3],
            'landmark_sigma': [0.4, 0.5],
            'odometry_noise_scale': 2.0,
            'r1.odometry_sigma': [0.6, 0.7, 0.8],
            'r1.landmark_sigma': [0.9, 1.0],
            'r1.odometry_noise_scale': 3.0,
        }
    ).robots
    assert (own.odometry_sigma, own.landmark_sigma) == ((0.6, 0.7, 0.8), (0.9, 1.0))
    assert (inherited.odometry_sigma, inherited.landmark_sigma) == ((0.1, 0.2, 0.3), (0.4, 0.5))
    assert (own.odometry_noise_scale, inherited.odometry_noise_scale) == (3.0, 2.0)


@pytest.mark.parametrize(
    'pose', [[1, 2.5, 3], (1, 2.5, 3), array('d', [1.0, 2.5, 3.0]), np.array([1.0, 2.5, 3.0])]
)
def test_an_integer_or_an_array_does_for_floats(pose):
    settings = parse({'robots': ['r1'], 'anchor_pose': pose, 'max_delay': 2})
    assert settings == parse({'robots': ['r1'], 'anchor_pose': [1.0, 2.5, 3.0], 'max_delay': 2.0})
    assert {type(x) for x in (*settings.anchor_pose, settings.max_delay)} == {float}


def test_lists_go_to_ros_as_floats_throughout():
    settings = Settings(robots=(RobotSettings('r1', 1),), anchor='r1', anchor_pose=(0, 0.5, 1))
    assert 'anchor_pose: [0.0, 0.5, 1.0]\n' in dump(settings)


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
def test_parameters_that_every_node_has_are_nobodys_mistake(name, value):
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
def test_a_quality_of_service_that_is_none_is_refused(policy, value, expected):
    name = f'qos_overrides./r1/odom.subscription.{policy}'
    with pytest.raises(UsageError, match=re.escape(f'parameter {name!r} must be {expected}')):
        parse({'robots': ['r1'], name: value})


@pytest.mark.parametrize(
    ('wrong', 'sentence'),
    [
        (
            {'gate_probabilty': 0.9},
            "unknown parameter 'gate_probabilty': did you mean 'gate_probability'?",
        ),
        ({'stale': 5}, "unknown parameter 'stale': did you mean 'stale_after'?"),
        ({'r1.start': [0, 0, 0]}, "unknown parameter 'r1.start': did you mean 'r1.start_pose'?"),
        (
            {'r7.start_pose': [0, 0, 0]},
            (
                "unknown parameter 'r7.start_pose': 'r7' is not in robots, "
                "did you mean 'r2.start_pose'?"
            ),
        ),
        (
            {'robots': []},
            "parameter 'robots' is missing or empty: list the robots, for example [r1, r2]",
        ),
        ({'robots': ['r1', 'r1']}, "parameter 'robots' names 'r1' twice: a name is one robot"),
        (
            {'anchor': 'r3'},
            "parameter 'anchor' must be one of 'r1', 'r2', '', not 'r3'",
        ),
        (
            {'filter': 'ekf'},
            "parameter 'filter' must be one of 'fej', 'invariant', 'standard', 'ideal', not 'ekf'",
        ),
        (
            {'update_iterations': 101},
            "parameter 'update_iterations' must be an integer from 0 to 100, not 101",
        ),
        (
            {'start_covariance': 'exact'},
            "parameter 'start_covariance' must be one of 'anchored', 'independent', not 'exact'",
        ),
        (
            {'r1.id': 2},
            "parameters 'r1.id' and 'r2.id' are both 2: give each robot its own",
        ),
        (
            {'r2.start_sigma': [0, 0, 0]},
            "parameter 'r2.start_sigma' needs a start: give 'r2.start_pose' too",
        ),
        (
            {'autosave_period': 5.0},
            "parameter 'autosave_period' needs a file: give 'checkpoint' too",
        ),
        (
            {'prior_landmarks': 'survey.csv', 'shared_landmark_ids': False},
            (
                "parameter 'prior_landmarks' needs numbers that all robots share: leave out "
                "'shared_landmark_ids'"
            ),
        ),
        (
            {'prior_landmarks': 'run', 'checkpoint': 'run'},
            "parameters 'prior_landmarks' and 'checkpoint' are one file: save to another one",
        ),
        (
            {'anchor': ''},
            (
                "parameter 'anchor' is empty, so nothing has a place in map: name a robot, or "
                "give 'prior_landmarks'"
            ),
        ),
        (
            {'robots': ['r1', 'ground_truth']},
            "parameter 'robots' names 'ground_truth', which is taken: choose another",
        ),
        (
            {'r1.start_pose': [0, 0, 0]},
            (
                "parameter 'r1.start_pose' is for robots other than the anchor: "
                "give 'anchor_pose' instead"
            ),
        ),
        (
            {'anchor': 'r2', 'r2.start_sigma': [0, 0, 0]},
            (
                "parameter 'r2.start_sigma' is for robots other than the anchor: "
                "give 'anchor_sigma' instead"
            ),
        ),
    ],
)
def test_a_mistake_is_explained_in_one_sentence(wrong, sentence):
    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
        parse({'robots': ['r1', 'r2'], **wrong})


def test_a_team_must_be_given():
    with pytest.raises(UsageError, match="'robots' is missing"):
        parse({'anchor': 'r1'})


@pytest.mark.parametrize(
    ('name', 'expected', 'values'),
    [
        (
            'robots',
            'a list of names that begin with a letter and go on with letters, digits and _',
            ['r1', ['1r'], ['r-1'], ['r1/a'], ['_r'], ['r1\n'], ['é'], [''], [1], [True]],
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
        *(
            (name, 'one line of text', [1, None, 'a\nb', 'a\x00', 'a\u2028b', ['a']])
            for name in ('output', 'r1.sensor_frame')
        ),
    ],
)
def test_a_bad_value_is_shown_beside_what_it_must_be(name, expected, values):
    for value in values:
        sentence = f'parameter {name!r} must be {expected}, not {value!r}'
        with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
            parse({'robots': ['r1', 'r2'], name: value})


@pytest.mark.parametrize(
    'kind', [kind for kind in kinds(['r1', 'r2']).values() if kind.within is not None])
def test_a_range_ends_where_values_are_refused(kind):
    low, high = kind.within.low, kind.within.high
    assert kind.read(value_of(kind, high)) is not None
    assert (kind.read(value_of(kind, low)) is None) == kind.within.open
    for beyond in (
        (low - 1, high + 1) if kind.element is int
        else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    ):
        assert kind.read(value_of(kind, beyond)) is None


def value_of(kind, x):
    """Return a value of a kind with one element, or all, equal to x."""
    return [x] * kind.shape[0] if kind.shape else x


def test_a_bad_array_from_ros_is_shown_as_a_list():
    with pytest.raises(UsageError, match=re.escape('not [1.0, 2.0]')):
        parse({'robots': ['r1'], 'anchor_pose': array('d', [1.0, 2.0])})


@pytest.mark.parametrize(
    'section',
    [
        '/**:',
        '/*:',
        'estimator:',
        '/estimator:',
        '/**/estimator:',
        '/**: {estimator: ',
        '/: {estimator: ',
    ],
)
def test_a_section_for_the_node_is_read(file, section):
    end = '}' * section.count('{')
    text = f'{section} {{ros__parameters: {{robots: [r1], r1: {{id: 7}}}}}}{end}'
    assert load(file(text)) == parse({'robots': ['r1'], 'r1.id': 7})


def test_the_name_of_the_node_chooses_the_sections(file):
    path = file(
        '/**: {ros__parameters: {robots: [r1], max_delay: 1e-3}}\n'
        'smoother: {ros__parameters: {max_delay: 0.5}}\n'
        'simulator: {ros__parameters: {landmarks: 20}}\n'
        '/team/estimator: {ros__parameters: {max_delay: 0.7}}\n'
    )
    assert load(path).max_delay == 0.001
    assert load(path, ['smoother']).max_delay == 0.5


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('', "no parameters for the node 'estimator': put them under /**: and ros__parameters:"),
        ('robots: [r1]\n', "no parameters for the node 'estimator'"),
        ('simulator:\n  ros__parameters:\n    robots: [r1]\n', "for the node 'estimator'"),
        ('/**:\n  ros__parameters:\n', "no parameters for the node 'estimator'"),
        ('- robots\n', "no parameters for the node 'estimator'"),
        ('/**:\n\tros__parameters: {}\n', 'correct line 2, which is not YAML: '),
        ('a: 1\nb: 2\na: 3\n', 'correct line 3, which is not YAML: found duplicate key "a"'),
        ('\x00\x01', 'not a YAML text: give the path of a ROS parameter file'),
        ('a: 2026-13-01\n', 'not a YAML text: give the path of a ROS parameter file'),
        (
            '/**:\n  ros__parameters:\n    robots: [r1]\n    filter: ekf\n',
            "parameter 'filter' must be one of 'fej', 'invariant', 'standard', 'ideal', not 'ekf'",
        ),
    ],
)
def test_a_mistake_in_a_file_is_explained_with_its_path(file, text, sentence):
    path = file(text)
    with pytest.raises(UsageError, match=f'^{re.escape(str(path))}: .*{re.escape(sentence)}'):
        load(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    path = tmp_path / 'absent.yaml'
    sentence = f'{path}: No such file or directory: give the path of a ROS parameter file'
    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
        load(path)


@pytest.mark.ros
def test_ros_reads_a_dumped_file_as_the_same_settings(file, ros_values):
    settings = parse(
        {
            'robots': TRAPS,
            'anchor': 'on',
            'anchor_pose': [1e-05, -1e9, 3],
            'max_delay': 2,
            'output': 'a "b" \\ é 😀: #',
            'no.sensor_frame': '',
            'no.start_pose': [0, 1.5, 1e-300],
            'no.start_sigma': [0, 0, 1e-12],
            'fej.id': 2**31 - 1,
        }
    )
    assert parse(ros_values(file(dump(settings)))) == settings


@pytest.mark.ros
@pytest.mark.parametrize(
    'sections',
    [
        ('/**', 'estimator'),
        ('estimator', '/**'),
        ('/*', '/**/estimator'),
        ('/estimator', '/*'),
        ('/**', '/team/estimator'),
        ('/**', '/*/estimator'),
    ],
)
def test_a_file_means_to_replay_what_it_means_to_ros(file, ros_values, sections):
    first, second = sections
    path = file(
        f'{first}: {{ros__parameters: {{robots: [r1], r1: {{id: 3}}, max_delay: 1e-3}}}}\n'
        f'{second}: {{ros__parameters: {{r1.id: 4, stale_after: 2}}}}\n'
    )
    assert load(path) == parse(ros_values(path))


def test_the_example_file_has_every_parameter_of_a_team_with_its_default():
    path = ROOT / 'config' / 'estimator.yaml'

    named = re.findall(r'^    (?:# )?(\w+):', path.read_text(encoding='utf-8'), re.MULTILINE)

    assert named == [*kinds([])]
    assert load(path) == parse({'robots': ['r1', 'r2']})
