# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The launch files start what they should, with what they are given."""

from itertools import pairwise
from pathlib import Path
import re
import sys

import pytest

from fej_slam_ros.ros.parameters import load_values, parse
from fej_slam_ros.ros.session import simulation
from helpers import fake_launch
from helpers.paths import ROOT
from helpers.processes import start

FILES = sorted(path.name.removesuffix('.launch.py') for path in ROOT.glob('launch/*.launch.py'))
BAG = ROOT / 'bags' / 'two_circles'


@pytest.fixture
def launched(tmp_path, monkeypatch):
    """Return what executes a launch file of the package, as where it is installed."""
    pytest.importorskip('ament_index_python', reason='ament_index_python is not installed')
    share = tmp_path / 'prefix' / 'share'
    index = share / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'fej_slam_ros').touch()
    (share / 'fej_slam_ros').symlink_to(ROOT)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    fake_launch.install(monkeypatch)
    (tmp_path / 'parameters').mkdir()

    def execute(name, **arguments):
        return fake_launch.launch(
            ROOT / 'launch' / f'{name}.launch.py', tmp_path / 'parameters', **arguments)

    return execute


def needed(name):
    return {'bag': str(BAG)} if name == 'replay' else {}


def started(context):
    return [command[0] for command in context.commands]


def command_of(context, executable):
    found, = (command for command in context.commands if command[0] == executable)
    return found


def parameters_of(context, node):
    """Return the parameters that a node is given; the later of two wins."""
    words = command_of(context, f'fej_slam_ros/{node}')
    files = [path for option, path in pairwise(words) if option == '--params-file']
    return {
        name: value for path in files for name, value in load_values(Path(path), [node]).items()}


@pytest.mark.parametrize('name', FILES)
def test_every_argument_is_described(launched, name):
    descriptions = launched(name, **needed(name)).descriptions

    expected = {'robots', 'params_file', 'use_sim_time', 'rviz', *needed(name)}
    assert expected <= descriptions.keys()
    assert all(re.fullmatch('[a-zA-Z].{10,}', text) for text in descriptions.values())


@pytest.mark.parametrize(
    ('name', 'processes'),
    [
        ('estimator', ['fej_slam_ros/estimator']),
        ('demo', ['fej_slam_ros/estimator', 'rviz2/rviz2', 'fej_slam_ros/simulator']),
        ('replay', ['fej_slam_ros/estimator', 'fej_slam_ros/play']),
    ])
def test_only_the_default_processes_start_without_arguments(launched, name, processes):
    assert started(launched(name, **needed(name))) == processes


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('rviz', ['true', 'false'])
def test_rviz_is_started_with_the_configuration_of_the_package_on_request(launched, name, rviz):
    context = launched(name, rviz=rviz, **needed(name))

    assert ('rviz2/rviz2' in started(context)) == (rviz == 'true')
    if rviz == 'true':
        words = command_of(context, 'rviz2/rviz2')
        assert Path(words[words.index('-d') + 1]).samefile(ROOT / 'config' / 'fej_slam.rviz')


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('robots', ['a,b', '[a, b]', 'a b', "['a', 'b']"])
def test_robots_override_those_of_the_parameter_file(launched, name, robots):
    context = launched(
        name, robots=robots, params_file=str(ROOT / 'bags' / 'two_circles.yaml'), **needed(name))

    assert parse(parameters_of(context, 'estimator')).estimation.robots[1].name == 'b'
    if name == 'demo':
        simulated = simulation.parse(parameters_of(context, 'simulator'))
        assert simulated.environment.world.robots == ('a', 'b')


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


def test_a_bag_is_played_with_its_time_and_no_ros_arguments(launched):
    context = launched('replay', bag='folder/of bag', rate='2.5')

    assert command_of(context, 'fej_slam_ros/play')[1:] == [
        'folder/of bag', '--clock', '--rate', '2.5']


def test_a_replay_needs_a_bag(launched):
    with pytest.raises(AssertionError, match='bag was not provided'):
        launched('replay')


@pytest.mark.ros
@pytest.mark.parametrize(
    ('name', 'given'),
    [('demo', {'rviz': 'false'}),
     pytest.param(
         'replay', {'bag': str(BAG), 'rate': '8.0', 'robots': 'r1,r2'}, marks=pytest.mark.slow)])
def test_a_launched_team_is_estimated(launched, domain, name, given):
    poses = domain.listen('r2/pose', 'geometry_msgs/msg/PoseWithCovarianceStamped')

    for (executable, *words) in launched(name, **given).commands:
        verb = executable.removeprefix('fej_slam_ros/')
        domain.ending(start(sys.executable, '-m', 'fej_slam_ros', verb, *words))

    domain.until(lambda: poses and poses[-1].header.frame_id == 'map')
