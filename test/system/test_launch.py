# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The launch files start what they should, with what they are given, and leave nothing behind."""

from itertools import pairwise
from pathlib import Path
import re
import signal
import sys

import pytest

from fej_slam_ros.ros.parameters import load_values, parse
from fej_slam_ros.ros.parameters.adapter_settings import load_adapter
from fej_slam_ros.ros.parameters.detector_settings import load_detector
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.paths import ROOT
from helpers.processes import start
from helpers.slow import slow

fake_launch = optional('helpers.fake_launch')

FILES = sorted(path.name.removesuffix('.launch.py') for path in ROOT.glob('launch/*.launch.py'))
BAG = ROOT / 'bags' / 'two_circles'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
ESTIMATOR, SIMULATOR, PLAY, RVIZ = (
    'fej_slam_ros/estimator', 'fej_slam_ros/simulator', 'fej_slam_ros/play', 'rviz2/rviz2')


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    """Return the prefix where the package is installed, and RViz is not; there is a display."""
    pytest.importorskip('ament_index_python', reason='ament_index_python is not installed')
    share = tmp_path / 'prefix' / 'share'
    (share / 'ament_index' / 'resource_index' / 'packages').mkdir(parents=True)
    (share / 'fej_slam_ros').symlink_to(ROOT)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    monkeypatch.setenv('DISPLAY', ':0')
    add_package(tmp_path / 'prefix', 'fej_slam_ros')
    return tmp_path / 'prefix'


def add_package(prefix, name):
    (prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / name).touch()


@pytest.fixture
def rviz_installed(prefix):
    add_package(prefix, 'rviz2')
    (prefix / 'lib' / 'rviz2').mkdir(parents=True)
    (prefix / 'lib' / 'rviz2' / 'rviz2').touch()


@pytest.fixture
def new_context(prefix, monkeypatch):
    """Return what makes the context of a launch with arguments."""
    fake_launch.install(monkeypatch)
    folder = prefix / 'parameters'
    folder.mkdir()
    return lambda **arguments: fake_launch.LaunchContext(folder, dict(arguments))


@pytest.fixture
def launched(new_context):
    """Return what executes a launch file of the package and returns its context."""

    def execute(name, **arguments):
        context = new_context(**arguments)
        description_of(name).execute(context)
        return context

    return execute


def description_of(name):
    return fake_launch.load(ROOT / 'launch' / f'{name}.launch.py')


def needed(name):
    return {'bag': str(BAG)} if name == 'replay' else {}


def started(context):
    return [command[0] for command in context.commands]


def command_of(context, executable):
    found, = (command for command in context.commands if command[0] == executable)
    return found


def options(words, option):
    return [value for word, value in pairwise(words) if word == option]


def parameters_of(context, node, namespace='/'):
    """Return the parameters that a node is given; the later of two wins."""
    files = options(command_of(context, f'fej_slam_ros/{node}'), '--params-file')
    return {
        name: value for path in files
        for name, value in load_values(Path(path), [node], namespace=namespace).items()}


def shown_by_rviz(context):
    """Return the topics in the configuration that RViz is started with."""
    path, = options(command_of(context, RVIZ), '-d')
    return re.findall(r'^ +Value: (/.*)$', Path(path).read_text(), re.MULTILINE)


@pytest.mark.parametrize('name', FILES)
def test_every_argument_is_described(launched, name):
    descriptions = launched(name, **needed(name)).descriptions

    expected = {
        'robots', 'params_file', 'filter', 'output', 'initialpose_robot', 'namespace',
        'use_sim_time', 'autostart', 'log_level', 'respawn', 'required', 'rviz', 'rviz_config',
        *needed(name)}
    assert expected <= descriptions.keys()
    assert all(re.fullmatch('[a-zA-Z].{10,}', text) for text in descriptions.values())


@pytest.mark.parametrize(
    ('name', 'processes'),
    [
        ('estimator', [ESTIMATOR]),
        ('demo', [ESTIMATOR, RVIZ, SIMULATOR]),
        ('replay', [ESTIMATOR, RVIZ, PLAY]),
    ])
@pytest.mark.usefixtures('rviz_installed')
def test_only_the_default_processes_start_without_arguments(launched, name, processes):
    assert started(launched(name, **needed(name))) == processes


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('rviz', ['auto', 'true', 'false'])
@pytest.mark.usefixtures('rviz_installed')
def test_rviz_is_started_on_request(launched, name, rviz):
    context = launched(name, rviz=rviz, **needed(name))

    assert (RVIZ in started(context)) == (rviz != 'false')
    assert not context.log


@pytest.mark.parametrize('name', FILES)
def test_rviz_that_is_missing_is_left_out_with_a_line(launched, name):
    context = launched(name, rviz='auto', **needed(name))

    assert RVIZ not in started(context)
    assert context.log == ['RViz is not started: rviz2 is not installed']


@pytest.mark.usefixtures('rviz_installed')
def test_rviz_is_not_started_on_its_own_account_without_a_display(launched, monkeypatch):
    for name in 'DISPLAY', 'WAYLAND_DISPLAY':
        monkeypatch.delenv(name, raising=False)

    assert launched('demo').log == ['RViz is not started: there is no display']
    assert RVIZ in started(launched('demo', rviz='true'))


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize(
    ('argument', 'value'),
    [
        ('rviz', 'true'), ('rviz', 'maybe'), ('respawn', 'maybe'), ('use_sim_time', 'maybe'),
        ('autostart', 'maybe'), ('namespace', 'my fleet'), ('params_file', 'absent.yaml'),
        ('output', 'screen'),
    ])
def test_a_launch_that_fails_has_started_nothing(new_context, name, argument, value):
    context = new_context(**needed(name), **{argument: value})

    with pytest.raises((RuntimeError, ValueError), match=value.replace('true', 'install rviz2')):
        description_of(name).execute(context)
    assert not context.commands


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('robots', ['a,b', '[a, b]', 'a b', "['a', 'b']"])
def test_robots_override_those_of_the_parameter_file(launched, name, robots):
    context = launched(
        name, robots=robots, params_file=str(ROOT / 'bags' / 'two_circles.yaml'), **needed(name))

    assert parse(parameters_of(context, 'estimator')).estimation.robots[1].name == 'b'
    if name == 'demo':
        simulated = simulation.parse(parameters_of(context, 'simulator'))
        assert simulated.environment.world.robots == ('a', 'b')


@pytest.mark.parametrize(
    ('given', 'placed'),
    [
        ({}, 'r2'), ({'initialpose_robot': 'r1'}, 'r1'), ({'robots': 'a,b'}, ''),
        ({'robots': 'a,b', 'initialpose_robot': 'b'}, 'b'),
    ])
def test_the_pose_tool_of_rviz_is_for_a_robot_of_the_launch(launched, given, placed):
    values = parameters_of(launched('demo', **given), 'estimator')

    parse(values)
    assert values['initialpose_robot'] == placed


def test_a_name_with_a_dash_stays_one_name_for_the_node_to_reject(launched):
    assert parameters_of(launched('estimator', robots='robot-1'), 'estimator')['robots'] == [
        'robot-1']


@pytest.mark.parametrize('name', FILES)
def test_without_the_argument_robots_are_those_of_the_parameter_file(launched, name):
    context = launched(
        name, params_file=str(ROOT / 'bags' / 'two_circles.yaml'), **needed(name))

    assert parameters_of(context, 'estimator')['robots'] == ['r1', 'r2']


@pytest.mark.parametrize(
    ('name', 'given', 'simulated'),
    [
        ('estimator', {}, False), ('estimator', {'use_sim_time': 'true'}, True),
        ('demo', {}, True), ('demo', {'use_sim_time': 'false'}, False),
        ('replay', {}, True), ('replay', {'use_sim_time': 'false'}, False),
    ])
def test_all_nodes_use_simulated_time_or_none_does(launched, name, given, simulated):
    context = launched(name, **needed(name), **given)

    assert parameters_of(context, 'estimator')['use_sim_time'] is simulated
    if name == 'demo':
        assert parameters_of(context, 'simulator')['clock'] is simulated


@pytest.mark.parametrize('name', FILES)
def test_filter_output_and_log_level_reach_the_estimator(launched, name):
    context = launched(
        name, robots='a,b', filter='invariant', output='2026', log_level='debug', **needed(name))

    run = parse(parameters_of(context, 'estimator'))
    assert run.estimation.filter == 'invariant'
    assert run.node.output == '2026'
    assert options(command_of(context, ESTIMATOR), '--log-level') == ['debug']


def test_without_arguments_filter_and_output_are_those_of_the_parameter_file(launched, tmp_path):
    path = tmp_path / 'team.yaml'
    path.write_text('/**: {ros__parameters: {robots: [a], filter: standard, output: run}}\n')

    run = parse(parameters_of(launched('estimator', params_file=str(path)), 'estimator'))

    assert (run.estimation.filter, run.node.output) == ('standard', 'run')


@pytest.mark.parametrize(
    ('pushed', 'namespace', 'expected'),
    [('', '', '/'), ('', 'fleet', '/fleet'), ('', '/fleet', '/fleet'), ('site', '', '/site'),
     ('site', 'fleet', '/site/fleet'), ('site', '/fleet', '/fleet')])
@pytest.mark.usefixtures('rviz_installed')
def test_all_nodes_are_in_the_namespace_also_when_included_in_another(
    new_context, pushed, namespace, expected,
):
    context = new_context(namespace=namespace)
    push = [fake_launch.PushRosNamespace(pushed)] if pushed else []
    included = fake_launch.IncludeLaunchDescription(
        fake_launch.PythonLaunchDescriptionSource(str(ROOT / 'launch' / 'demo.launch.py')))
    fake_launch.GroupAction([*push, included]).execute(context)

    for executable in ESTIMATOR, SIMULATOR:
        remaps = options(command_of(context, executable), '-r')
        assert f'__ns:={expected}' in remaps
    assert parameters_of(context, 'estimator', expected)['robots'] == ['r1', 'r2']
    assert parameters_of(context, 'simulator', expected)['environment'] == 'circles'
    assert f'{expected.rstrip("/")}/r2/pose' in shown_by_rviz(context)


@pytest.mark.usefixtures('rviz_installed')
@pytest.mark.parametrize('given', ['robots', 'params_file'])
def test_rviz_shows_the_robots_of_the_launch(launched, tmp_path, given):
    path = tmp_path / 'team.yaml'
    path.write_text('/**: {ros__parameters: {robots: [left, right]}}\n')
    arguments = {'robots': 'left,right', 'params_file': str(path)}

    shown = shown_by_rviz(launched('estimator', rviz='true', **{given: arguments[given]}))

    assert {'/left/pose', '/right/pose', '/estimator/markers'} <= set(shown)
    assert '/r1/pose' not in shown


@pytest.mark.usefixtures('rviz_installed')
def test_rviz_is_started_with_the_configuration_of_the_user(launched):
    context = launched('demo', rviz_config='my.rviz')

    assert options(command_of(context, RVIZ), '-d') == ['my.rviz']


@pytest.fixture
def nav2_installed(prefix):
    add_package(prefix, 'nav2_bringup')
    (prefix / 'share' / 'nav2_bringup' / 'launch').mkdir(parents=True)
    (prefix / 'share' / 'nav2_bringup' / 'launch' / 'navigation_launch.py').write_text(
        'from launch import LaunchDescription\nfrom launch_ros.actions import Node\n'
        'def generate_launch_description():\n'
        "    return LaunchDescription([Node(package='nav2_controller', executable='server')])\n")


EXAMPLE = ROOT / 'launch' / 'two_robots_nav2.launch.yaml'


@pytest.mark.usefixtures('nav2_installed')
def test_the_example_starts_one_estimator_and_nav2_in_the_namespace_of_each_robot(new_context):
    context = new_context()
    fake_launch.load(EXAMPLE).execute(context)

    assert started(context) == [ESTIMATOR, 'nav2_controller/server', 'nav2_controller/server']
    namespaces = [options(command, '-r')[-1] for command in context.commands]
    assert namespaces == ['__ns:=/', '__ns:=/r1', '__ns:=/r2']
    run = parse(parameters_of(context, 'estimator'))
    assert [robot.name for robot in run.estimation.robots] == ['r1', 'r2']
    assert run.node.tf_topics == 'robot'


@pytest.mark.parametrize(
    ('sensors', 'node', 'load'),
    [('lasers', 'detector', load_detector), ('tags', 'adapter', load_adapter)])
def test_the_examples_with_sensors_start_their_node_and_an_estimator(
    new_context, sensors, node, load,
):
    context = new_context()
    fake_launch.load(ROOT / 'launch' / f'two_robots_{sensors}.launch.yaml').execute(context)

    assert started(context) == [f'fej_slam_ros/{node}', ESTIMATOR]
    # Both read their sections of one file.
    settings = load(ROOT / 'config' / f'two_robots_{sensors}.yaml')
    run = parse(parameters_of(context, 'estimator'))
    assert [robot.name for robot in run.estimation.robots] == [*settings.robots] == ['r1', 'r2']


def test_the_example_without_nav2_starts_nothing(new_context):
    context = new_context(nav2_params_file='given.yaml')

    with pytest.raises(LookupError, match='nav2_bringup'):
        fake_launch.load(EXAMPLE).execute(context)
    assert not context.commands


def test_a_bag_is_played_with_its_time_and_no_ros_arguments(launched):
    context = launched('replay', bag='folder/of bag', rate='2.5')

    assert command_of(context, PLAY)[1:] == ['folder/of bag', '--clock', '--rate', '2.5']


def test_a_replay_needs_a_bag(launched):
    with pytest.raises(RuntimeError, match='bag was not provided'):
        launched('replay')


class Launch:
    """The processes of a launch, running; a fake RViz sleeps."""

    def __init__(self, context, domain):
        self._domain = domain
        self.service = fake_launch.LaunchService(context, self._start)

    def processes(self, executable):
        return [
            process for action, process in self.service.running.items()
            if action.command[0] == executable]

    def until(self, condition):
        def stepped():
            self.service.step()
            return condition()

        self._domain.until(stepped)

    def _start(self, command):
        executable, *words = command
        verb = executable.removeprefix('fej_slam_ros/')
        command = ['sleep', '1000'] if executable == RVIZ else [
            sys.executable, '-m', 'fej_slam_ros', verb, *words]
        return self._domain.ending(start(*command))


@pytest.mark.ros
@pytest.mark.parametrize(
    ('name', 'given', 'topic'),
    [('demo', {'namespace': 'fleet'}, '/fleet/r2/pose'),
     slow('replay', {'bag': str(BAG), 'rate': '8.0', 'robots': 'r1,r2'}, '/r2/pose')])
def test_a_launched_team_is_estimated(launched, domain, name, given, topic):
    poses = domain.listen(topic, POSE)

    launch = Launch(launched(name, **given), domain)

    launch.until(lambda: poses and poses[-1].header.frame_id == 'map')


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize('victim', [ESTIMATOR, RVIZ])
@pytest.mark.usefixtures('rviz_installed')
def test_when_a_process_of_the_demo_dies_none_is_left(launched, domain, victim):
    poses = domain.listen('/r1/pose', POSE)
    launch = Launch(launched('demo'), domain)
    launch.until(lambda: poses)

    launch.processes(victim)[0].kill()

    launch.until(lambda: not launch.service.running)
    assert launch.service.reason
    others = launch.service.returncodes.keys() - {victim, RVIZ}
    assert {launch.service.returncodes[executable] for executable in others} == {0}


@pytest.mark.ros
@pytest.mark.slow
def test_when_the_simulator_fails_the_demo_ends(launched, domain, tmp_path):
    path = tmp_path / 'team.yaml'
    path.write_text('/**: {ros__parameters: {robots: [a, b]}}\nsimulator: {ros__parameters: {'
                    'environment: moon}}\n')

    launch = Launch(launched('demo', params_file=str(path)), domain)

    launch.until(lambda: not launch.service.running)
    assert launch.service.reason == 'the simulator has failed'


@pytest.mark.ros
@pytest.mark.slow
def test_an_estimator_that_dies_is_started_again_on_request(launched, domain):
    launch = Launch(launched('estimator', robots='r1', respawn='true', required='true'), domain)
    first, = launch.processes(ESTIMATOR)

    first.send_signal(signal.SIGKILL)

    launch.until(lambda: launch.processes(ESTIMATOR) not in ([], [first]))
    launch.service.shut_down('end of the test')
    launch.until(lambda: not launch.service.running)
