# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Discovery without multicast, as in docs/scale.md, and the programs of docs/tutorial.md."""

import json
import os
from pathlib import Path
import shutil
import signal
import socket
import sys

import pytest

from fej_slam_ros.ros.files import bags
from helpers.network import Network, why_none
from helpers.optional import optional
from helpers.paths import ROOT
from helpers.processes import DEADLINE, start, until
from helpers.ros import run_verb, summary_of, write_parameters

live_helpers = optional('helpers.live')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

#: Ten times real time.
WORLD = {'loops': 1, 'landmarks': 10, 'speed': 10.0}
TUTORIAL = ROOT / 'docs' / 'tutorial.md'


def used(domain, folder, on_one=(), on_two=(), one=None, two=None):
    """Run an estimator and a simulator on two hosts; return the number of used records."""
    command = sys.executable, '-m', 'fej_slam_ros'
    team = write_parameters(
        folder / 'team.yaml', robots=['r1', 'r2'], output=str(folder / 'out'))
    world = write_parameters(folder / 'world.yaml', **WORLD)
    estimator, simulator = (
        domain.ending(start(
            *on, *command, verb, '--ros-args', '--params-file', parameters,
            env={**os.environ, **(more or {})}))
        for on, verb, parameters, more in (
            (on_one, 'estimator', team, one), (on_two, 'simulator', world, two)))
    _, errors = simulator.communicate(timeout=DEADLINE)
    assert simulator.returncode == 0, errors
    estimator.send_signal(signal.SIGINT)
    estimator.communicate(timeout=DEADLINE)
    return json.loads((folder / 'out' / 'summary.json').read_text())['counts']['used']


def test_static_peers_discover_each_other(domain, tmp_path):
    why = why_none()
    if why:
        pytest.skip(why)
    with Network(seed=1) as network:
        records = used(
            domain, tmp_path, network.on('one'), network.on('two'),
            {'ROS_STATIC_PEERS': '10.77.0.2'}, {'ROS_STATIC_PEERS': '10.77.0.1'})

    # Odometry and a scan of 64 steps of two robots.
    assert records >= 2 * 64


@pytest.mark.skipif(
    shutil.which('fast-discovery-server', path=str(Path(sys.executable).parent)) is None,
    reason='no discovery server beside this Python')
def test_nodes_discover_each_other_through_a_discovery_server(domain, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    server = domain.ending(start(
        Path(sys.executable).with_name('fast-discovery-server'), '-i', 0, '-l', '127.0.0.1', '-p',
        port))
    address = {'ROS_DISCOVERY_SERVER': f'127.0.0.1:{port}'}

    assert used(domain, tmp_path, one=address, two=address) >= 2 * 64
    assert server.poll() is None


def program(name, folder):
    """Save a program of the tutorial in a folder."""
    text = TUTORIAL.read_text(encoding='utf-8').split(f'ave as `{name}`:\n\n```python\n')[1]
    (folder / name).write_text(text.split('```')[0], encoding='utf-8')
    return folder / name


def test_robots_of_the_tutorial_join_one_map(domain, tmp_path):
    publisher = program('publisher.py', tmp_path)
    domain.estimate(robots=['r1', 'r2'])
    poses = domain.listen('r2/pose', live_helpers.POSE)
    rejected = domain.listen('estimator/rejections', 'diagnostic_msgs/msg/DiagnosticStatus')

    robots = [domain.ending(start(sys.executable, publisher, name)) for name in ('r1', 'r2')]

    domain.until(lambda: len([p for p in poses if p.header.frame_id == 'map']) > 20)
    # One correct observation in a thousand fails the gate; a robot cannot be observed before it
    # starts.
    assert {status.message for status in rejected} <= {
        'gated', 'other_robot_stale', 'before_odometry', 'not_joined'}
    for robot in robots:
        robot.send_signal(signal.SIGINT)
        assert robot.communicate()[1] == ''
    until(lambda: all(robot.returncode == 0 for robot in robots), bool)


def test_the_recorder_of_the_tutorial_writes_a_bag_that_can_be_replayed(domain, tmp_path):
    topics = [f'r1/{kind}' for kind in ('odom', 'landmarks', 'robots')]
    odometry = domain.listen('r1/odom', 'nav_msgs/msg/Odometry')
    recorder, robot = (
        domain.ending(start(sys.executable, *words)) for words in (
            (program('recorder.py', tmp_path), tmp_path / 'bag', *(f'/{name}' for name in topics)),
            (program('publisher.py', tmp_path), 'r1')))

    domain.until(lambda: len(odometry) > 60)
    for process in (robot, recorder):
        process.send_signal(signal.SIGINT)
        assert process.communicate()[1] == ''

    params = write_parameters(tmp_path / 'r1.yaml', robots=['r1', 'r2'])
    assert {*topics} == bags.topics(tmp_path / 'bag').keys()
    assert run_verb(
        'replay', tmp_path / 'bag', '--params', params, '--output', tmp_path / 'out') == 0
    assert summary_of(tmp_path / 'out')['robots']['r1']['steps'] > 20
