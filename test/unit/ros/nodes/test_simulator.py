# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node publishes the bag of `simulate` in real time, and ends by itself."""

from itertools import pairwise
import signal
from time import time_ns

import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize, restamped
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.ros import cdr, ODOMETRY, write_parameters

services = optional('rcl_interfaces.srv')
services_msg = optional('rcl_interfaces.msg')

pytestmark = pytest.mark.ros

WORLD = {
    'robots': ['r1', 'r2', 'r3'], 'loops': 1, 'steps_per_loop': 20, 'landmarks': 20, 'speed': 8.0,
    'clock': True, 'robot_sigma': [0.1, 0.1]}
CLOCK = 'rosgraph_msgs/msg/Clock'


#: What a user asks a node that runs.
DESCRIBE = '/simulator/describe_parameters'


def without_twist(raw, type_name):
    """Return a message without what bags do not have: the velocity of odometry."""
    message = deserialize(raw, type_name)
    if type_name == ODOMETRY:
        at_rest = dict.fromkeys('xyz', 0.0)
        for vector in message.twist.twist.linear, message.twist.twist.angular:
            vars(vector).update(at_rest)
    return cdr(message)


def stamp(raw, type_name):
    """Return the stamp of a message [ns]."""
    return from_time(deserialize(raw, type_name).header.stamp)


def published(domain, tmp_path, world, compared):
    """
    Return stamps by topic of what the node publishes until it ends.

    It is the bag of `simulate`, compared by a function of bytes and type of a message.
    """
    simulated = simulation.parse(world)
    bags.write(tmp_path / 'bag', simulated.records(), robot_ids=simulated.robot_ids)
    types = {topic: found.type_name for topic, found in bags.topics(tmp_path / 'bag').items()}
    heard = {topic: domain.record(topic, type_name) for topic, type_name in types.items()}

    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **world)
    node = domain.start('simulator', '--ros-args', '--params-file', given)

    assert domain.finish(node) == (0, '')
    expected = {topic: [] for topic in types}
    for message in bags.read(tmp_path / 'bag'):
        expected[message.topic].append(compared(message.raw, message.type_name))
    assert expected == {
        topic: [compared(raw, types[topic]) for raw in heard[topic]] for topic in types}
    return {topic: [stamp(raw, types[topic]) for raw in heard[topic]] for topic in heard}


@pytest.mark.slow
def test_with_a_clock_the_simulator_publishes_the_simulated_bag_and_ends(domain, tmp_path):
    ticks = domain.listen('/clock', CLOCK)

    stamps = published(domain, tmp_path, WORLD, without_twist)

    # 21 steps, 5 a second, from the first second on.
    steps = [NS + k * NS // 5 for k in range(21)]
    for name in WORLD['robots']:
        for kind in ('odom', 'landmarks', 'robots', 'ground_truth'):
            assert stamps[f'{name}/{kind}'] == steps
    assert from_time(ticks[-1].clock) == steps[-1]


@pytest.mark.slow
def test_without_a_clock_the_stamps_are_the_present_time_and_the_values_the_same(
    domain, tmp_path,
):
    def compared(raw, type_name):
        if type_name != ODOMETRY:
            return restamped(without_twist(raw, type_name), 0)
        message = deserialize(raw, type_name)
        return message.pose.pose.position.x, message.pose.pose.orientation.z

    begin = time_ns()
    stamps = published(domain, tmp_path, WORLD | {'clock': False}, compared)
    end = time_ns()

    times = stamps['r1/odom']
    assert begin < times[0] < times[-1] < end
    # 8 times faster than simulated time.
    assert [b - a for a, b in pairwise(times)] == [NS // 5 // 8] * 20
    assert all(of_topic in (times, times[:1]) for of_topic in stamps.values())


@pytest.mark.slow
def test_the_simulator_publishes_robot_observations(domain, tmp_path):
    world = {'environment': 'map_joining', 'speed': 20.0, 'clock': True}
    stamps = published(domain, tmp_path, world, without_twist)

    # Samples 44 to 52, two a second.
    assert stamps['p/robots'] == stamps['q/robots'] == [NS + k * NS // 2 for k in range(44, 53)]
    assert 'ground_truth/landmarks' not in stamps


@pytest.mark.slow
def test_a_node_that_waits_for_subscribers_describes_its_parameters_and_ends_at_a_signal(
    domain, tmp_path,
):
    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **WORLD, seed=4)
    node = domain.start('simulator', '--ros-args', '--params-file', given)

    seed, environment, loops = domain.ask(
        DESCRIBE, services.DescribeParameters, names=['seed', 'environment', 'loops']).descriptors
    values = domain.ask(
        '/simulator/get_parameters', services.GetParameters, names=['seed', 'rate']).values

    value = services_msg.ParameterValue(type=2, integer_value=9)
    refused, = domain.ask(
        '/simulator/set_parameters', services.SetParameters,
        parameters=[services_msg.Parameter(name='seed', value=value)]).results

    assert seed.description.startswith('seed of the world and of all noise')
    assert all(described.read_only for described in (seed, environment, loops))
    assert "one of 'circles', 'figure_eight'" in environment.additional_constraints
    assert 'start the node again' in refused.reason
    assert (values[0].integer_value, values[1].double_value) == (4, 5.0)
    assert domain.finish(node, signal.SIGTERM) == (0, '')


@pytest.mark.slow
def test_without_the_parameter_clock_no_clock_is_published(domain, tmp_path):
    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **WORLD | {'clock': False})
    node = domain.start('simulator', '--ros-args', '--params-file', given)

    domain.until(lambda: domain.node.count_publishers('/r3/landmarks'))

    assert not domain.node.count_publishers('/clock')
    assert domain.finish(node, signal.SIGTERM) == (0, '')
