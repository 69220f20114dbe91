# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run equals the `replay` of its recorded input, bit for bit."""

import signal

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.ros import run_verb, summary_of, write_parameters
from helpers.slow import slow

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros

ROBOTS = ('r1', 'r2')
WORLD = {
    'loops': 2, 'steps_per_loop': 30, 'landmarks': 30, 'seed': 3, 'robot_sigma': [0.3, 0.3],
    'range': 30.0}


def as_recorded(messages):
    """Keep the order: each scan follows the odometry of its robot."""
    return messages


def odometry_first(messages):
    """Put the odometry of all robots before all scans at each stamp."""
    return sorted(messages, key=lambda m: (m.received, not m.topic.endswith('odom')))


def with_losses(messages):
    """Drop every third odometry of r1, every fifth scan of r2, and the second half of r2."""
    odometry = [m for m in messages if m.topic == 'r1/odom']
    scans = [m for m in messages if m.topic == 'r2/landmarks']
    of_r2 = [m for m in messages if m.topic.startswith('r2')]
    lost = {*map(id, odometry[::3]), *map(id, scans[1::5]), *map(id, of_r2[len(of_r2) // 2:])}
    return [m for m in messages if id(m) not in lost]


def rewrite(recorded, bag, change):
    """Copy a bag with its list of messages changed; return the copy."""
    with bags.BagWriter(bag) as writer:
        for message in change(list(bags.read(recorded))):
            decoded = deserialize(message.raw, message.type_name)
            writer.write(message.topic, message.received, decoded)
    return bag


def replay(bag, parameter_file, folder):
    """Return the poses of each robot from `replay`, and its summary."""
    words = bag, '--params', parameter_file, '--output', folder, '--bag'
    assert run_verb('replay', *words) == 0
    poses = {robot: [] for robot in ROBOTS}
    for message in bags.read(folder / 'bag'):
        robot, _, kind = message.topic.partition('/')
        if kind == 'pose':
            poses[robot].append(message.raw)
    return poses, summary_of(folder)


def record_poses(domain):
    """Return lists that fill with the poses of each robot."""
    return {robot: domain.record(f'{robot}/pose', live_helpers.POSE) for robot in ROBOTS}


def arrived(poses, expected):
    """Return the condition that as many poses of each robot have arrived as expected."""
    return lambda: all(len(poses[robot]) >= len(expected[robot]) for robot in ROBOTS)


@pytest.mark.parametrize('order', [odometry_first, slow(with_losses)])
def test_a_live_run_equals_its_replay(domain, tmp_path, order):
    simulated = simulation.parse(WORLD)
    bags.write(tmp_path / 'recorded', simulated.records(), robot_ids=simulated.robot_ids)
    bag = rewrite(tmp_path / 'recorded', tmp_path / 'played', order)
    team = write_parameters(tmp_path / 'team.yaml', robots=ROBOTS)
    expected, replayed = replay(bag, team, tmp_path / 'replayed')

    domain.estimate(**live_helpers.live_values(team, tmp_path / 'live'))
    poses = record_poses(domain)
    assert domain.finish(domain.start('play', bag, '--rate', 10)) == (0, '')
    domain.end_estimate()
    domain.until(arrived(poses, expected))

    assert poses == expected
    live = summary_of(tmp_path / 'live')
    assert live['state_hash'] == replayed['state_hash']
    assert live['counts'] == replayed['counts']


@pytest.fixture(scope='module')
def park_bag(data, tmp_path_factory):
    """Return the bag of Victoria Park, its parameters, and the result of `replay`."""
    folder = tmp_path_factory.mktemp('victoria_park')
    words = 'victoria_park', '--input', data / 'fej_ekf_paper', '--output', folder / 'bag'
    assert run_verb('convert', *words) == 0
    team = folder / 'bag.yaml'
    return folder / 'bag', team, *replay(folder / 'bag', team, folder / 'replayed')


@pytest.mark.slow
@pytest.mark.parametrize('order', [as_recorded, odometry_first])
def test_victoria_park_live_over_three_processes_equals_its_replay(
    domain, tmp_path, park_bag, order,
):
    recorded, team, expected, replayed = park_bag
    bag = rewrite(recorded, tmp_path / 'played', order)
    values = live_helpers.live_values(team, tmp_path / 'live')
    parameters = write_parameters(tmp_path / 'live.yaml', **values)

    estimator = domain.start('estimator', '--ros-args', '--params-file', parameters)
    poses = record_poses(domain)
    reports = domain.wait_for_reports()
    assert domain.finish(domain.start('play', bag, '--rate', 50)) == (0, '')
    status, _ = domain.finish(estimator, signal.SIGINT)
    domain.until(arrived(poses, expected))

    hashes = [value.value for value in reports[-1].status[-1].values if value.key == 'state_hash']
    assert status == 0
    assert poses == expected
    assert [*hashes, summary_of(tmp_path / 'live')['state_hash']] == 2 * [replayed['state_hash']]
