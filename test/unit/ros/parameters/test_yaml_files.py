# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A parameter file means the same to ROS and to the verbs of the package."""

import re

import pytest

from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import (
    dump, ESTIMATOR, known_parameters, load, load_parsed, load_values, parse, RunSettings)
from fej_slam_ros.ros.parameters.detector_settings import parse_detector
from fej_slam_ros.ros.parameters.yaml_files import check_for_ros, fault_for
from helpers.optional import given
from helpers.paths import ROOT
from helpers.settings import TRICKY_NAMES, valid_settings


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


@given(settings=valid_settings())
def test_a_dumped_file_gives_the_settings_it_was_made_from(tmp_path_factory, settings):
    path = tmp_path_factory.mktemp('dump') / 'params.yaml'
    path.write_text(dump(settings), encoding='utf-8')
    assert load(path) == settings


def test_lists_go_to_ros_as_floats_throughout():
    settings = Settings(robots=(RobotSettings('r1', 1),), anchor='r1', anchor_pose=(0, 0.5, 1))
    assert 'anchor_pose: [0.0, 0.5, 1.0]\n' in dump(RunSettings(settings))


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
    assert load(path).estimation.max_delay == 0.001
    assert load(path, ['smoother']).estimation.max_delay == 0.5


@pytest.mark.parametrize(
    ('section', 'applies'),
    [
        ('/fleet/estimator', True), ('/**', True), ('/**/estimator', True), ('/*/estimator', True),
        ('/fleet/*', True), ('estimator', False), ('/*', False), ('/fleet/b/estimator', False),
        ('/fleet', False),
    ],
)
def test_the_namespace_of_the_node_chooses_the_sections(file, section, applies):
    path = file(
        '/fleet/**: {ros__parameters: {robots: [r1]}}\n'
        f'{section}: {{ros__parameters: {{max_delay: 0.7}}}}\n')

    values = load_values(path, ['estimator'], namespace='/fleet')

    assert values['robots'] == ['r1']
    assert ('max_delay' in values) == applies


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('', "no parameters for the node 'estimator': put them under /**: and ros__parameters:"),
        ('robots: [r1]\n', "no parameters for the node 'estimator'"),
        ('simulator:\n  ros__parameters:\n    robots: [r1]\n', "for the node 'estimator'"),
        ('estimatr:\n  ros__parameters:\n    robots: [r1]\n', 'only for /estimatr: put them'),
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


@pytest.mark.parametrize('section', ['/**', '/fleet/**', '/*/estimator', 'fleet/estimator'])
def test_nothing_is_wrong_with_a_file_with_a_section_for_a_node(file, section):
    path = file(f'{section}: {{ros__parameters: {{robots: [r1]}}}}\n')

    assert fault_for(path, '/fleet/estimator') == ''


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('estimator: {ros__parameters: {robots: [r1]}}\n',
         "no parameters for the node 'fleet/estimator', only for /estimator: put them under /**:"),
        ('/**: {ros__parameters: {r1: {max_speed: 1.0}, r1.max_speed: 2.0}}\n',
         "parameter 'r1.max_speed' is given twice"),
    ],
)
def test_a_mistake_in_a_file_that_ros_accepts_is_explained_with_its_path(file, text, sentence):
    path = file(text)

    assert fault_for(path, '/fleet/estimator').startswith(f'{path}: {sentence}')


def test_a_parameter_that_is_given_twice_is_named_without_its_values(file):
    path = file('/**:\n  ros__parameters:\n    robots: [r1]\n    robots: [r2]\n')
    with pytest.raises(UsageError) as caught:
        load(path)
    assert str(caught.value) == (
        f'{path}: correct line 4, which is not YAML: found duplicate key "robots"')


def test_a_parameter_that_is_given_with_a_dot_and_as_a_block_is_named(file):
    path = file(
        '/**:\n  ros__parameters:\n    robots: [r1]\n    r1: {max_speed: 1.0}\n'
        '    r1.max_speed: 50.0\n')
    for read in (load, check_for_ros):
        with pytest.raises(UsageError) as caught:
            read(path)
        assert str(caught.value) == (
            f"{path}: parameter 'r1.max_speed' is given twice, with a dot and as a block: keep one"
            ' of them')


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    path = tmp_path / 'absent.yaml'
    sentence = f'{path}: No such file or directory: give the path of a ROS parameter file'
    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
        load(path)


def test_noise_of_the_team_that_is_changed_in_a_dumped_file_is_that_of_its_robots(file):
    text = dump(parse({'robots': ['r1', 'r2'], 'r2.landmark_noise_scale': 4.0}))

    changed = load(file(text.replace(' landmark_noise_scale: 1.0', ' landmark_noise_scale: 3.0')))

    assert [r.landmark_noise_scale for r in changed.estimation.robots] == [3.0, 4.0]


@pytest.mark.ros
def test_ros_reads_a_dumped_file_as_the_same_settings(file, ros_values):
    settings = parse(
        {
            'robots': TRICKY_NAMES,
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
def test_of_several_sections_the_later_one_wins_as_in_ros(file, ros_values, sections):
    first, second = sections
    path = file(
        f'{first}: {{ros__parameters: {{robots: [r1], r1: {{id: 3}}, max_delay: 1e-3}}}}\n'
        f'{second}: {{ros__parameters: {{r1.id: 4, stale_after: 2}}}}\n'
    )
    assert load(path) == parse(ros_values(path))


def test_the_example_file_has_every_parameter_of_a_team_with_its_default():
    path = ROOT / 'config' / 'estimator.yaml'

    named = re.findall(r'^    (?:# )?(\w+):', path.read_text(encoding='utf-8'), re.MULTILINE)

    assert named == [*known_parameters([], ESTIMATOR)]
    assert load(path) == parse({'robots': ['r1', 'r2']})


def test_an_old_name_in_a_file_is_replaced_with_one_warning(file, caplog):
    path = file('/**: {ros__parameters: {robots: [r1], second_look: true}}\n')
    assert load(path).estimation.inflate_rejected_scans
    assert len(caplog.messages) == 1


def test_a_list_for_which_ros_refuses_the_file_is_a_warning_offline(file, caplog):
    path = file('/**: {ros__parameters: {robots: [r1], anchor_pose: [1, 0.5, 0]}}\n')

    settings = load(path)

    assert settings.estimation.anchor_pose == (1.0, 0.5, 0.0)
    sentence = "parameter 'anchor_pose' mixes integers and floats, which ROS refuses: write "
    assert caplog.messages == [f'{path}: {sentence}[1.0, 0.5, 0.0]']


def test_a_warning_begins_with_the_path_for_settings_of_any_node(file, caplog):
    path = file('/**: {ros__parameters: {robots: [r1], min_beam: 4}}\n')

    load_parsed(path, ['detector'], parse_detector)

    assert caplog.messages == [
        f"{path}: unknown parameter 'min_beam' is ignored: did you mean 'min_beams'?"]
