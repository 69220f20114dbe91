# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node publishes the bag of `simulate` in real time, and ends by itself."""

import signal

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.ros import write_parameters

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros

WORLD = {
    'robots': ['r1', 'r2', 'r3'], 'loops': 1, 'steps_per_loop': 20, 'landmarks': 20, 'speed': 8.0,
    'clock': True, 'robot_sigma': [0.1, 0.1]}
CLOCK = 'rosgraph_msgs/msg/Clock'


def stamp(raw, type_name):
    """Return the stamp of a message."""
    at = deserialize(raw, type_name).header.stamp
    return at.sec, at.nanosec


def published(domain, tmp_path, world):
    """Return what the node publishes by topic once it has ended, if that is the simulated bag."""
    simulated = simulation.parse(world)
    bags.write(tmp_path / 'bag', simulated.records(), robot_ids=simulated.robot_ids)
    types = {topic: found.type_name for topic, found in bags.topics(tmp_path / 'bag').items()}
    heard = {topic: domain.record(topic, type_name) for topic, type_name in types.items()}

    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **world)
    node = domain.start('simulator', '--ros-args', '--params-file', given)

    assert domain.finish(node) == (0, '')
    expected = {topic: [] for topic in types}
    for message in bags.read(tmp_path / 'bag'):
        expected[message.topic].append(live_helpers.on_the_wire(message.raw))
    assert heard == expected
    return {topic: [stamp(raw, types[topic]) for raw in heard[topic]] for topic in heard}


def test_the_simulator_publishes_the_simulated_bag_and_ends(domain, tmp_path):
    ticks = domain.listen('/clock', CLOCK)

    stamps = published(domain, tmp_path, WORLD)

    # 21 steps, 5 a second, from the first second on.
    steps = [(1 + k // 5, k % 5 * 200_000_000) for k in range(21)]
    for name in WORLD['robots']:
        for kind in ('odom', 'landmarks', 'robots', 'ground_truth'):
            assert stamps[f'{name}/{kind}'] == steps
    assert (ticks[-1].clock.sec, ticks[-1].clock.nanosec) == steps[-1]


@pytest.mark.slow
def test_the_simulator_publishes_robot_observations(domain, tmp_path):
    stamps = published(domain, tmp_path, {'environment': 'map_joining', 'speed': 20.0})

    # Samples 44 to 52, two a second.
    seen = [(1 + k // 2, k % 2 * 500_000_000) for k in range(44, 53)]
    assert stamps['p/robots'] == stamps['q/robots'] == seen
    assert 'ground_truth/landmarks' not in stamps


@pytest.mark.slow
def test_without_the_parameter_clock_no_clock_is_published(domain, tmp_path):
    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **WORLD | {'clock': False})
    node = domain.start('simulator', '--ros-args', '--params-file', given)

    domain.until(lambda: domain.node.count_publishers('/r3/landmarks'))

    assert not domain.node.count_publishers('/clock')
    assert domain.finish(node, signal.SIGTERM) == (130, '')
