# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag is played on its topics as it was recorded."""

from itertools import count, repeat, takewhile
import re
import signal
from time import monotonic

import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.ros.files import bags
from helpers.optional import optional
from helpers.ros import (
    meeting, meeting_truth, ODOMETRY, odometry_message, raw, run_verb, write_bag, write_parameters)

endpoints = optional('fej_slam_ros.ros.nodes.endpoints')
qos = optional('fej_slam_ros.ros.nodes.qos')
process = optional('fej_slam_ros.ros.nodes.ros_process')
live_helpers = optional('helpers.live')
player = optional('fej_slam_ros.ros.nodes.player')
nodes = optional('rclpy.node')

pytestmark = pytest.mark.ros

CLOCK = 'rosgraph_msgs/msg/Clock'


@pytest.fixture
def bag(tmp_path):
    """Return a bag with ten messages a second on each topic of two robots."""
    records = [*meeting_truth(21), *meeting(21)]
    bags.write(tmp_path / 'bag', sorted(records, key=lambda record: record.stamp))
    return tmp_path / 'bag'


def recorded(bag):
    """Return the messages on each topic of a bag."""
    contents = {topic: [] for topic in bags.topics(bag)}
    for message in bags.read(bag):
        contents[message.topic].append(live_helpers.on_the_wire(message.raw))
    return contents


@pytest.fixture
def node(domain):
    """Return a node for a player beside the node of the test."""
    assert domain.node
    node = nodes.Node('player')
    yield node
    node.destroy_node()


def test_topics_of_packages_that_are_not_installed_are_left_out(domain, bag, tmp_path):
    # tf2_msgs is not on PyPI; where it is installed, this test has nothing to show.
    if endpoints.is_installed('tf2_msgs/msg/TFMessage'):
        pytest.skip('tf2_msgs is installed')
    team = write_parameters(tmp_path / 'team.yaml', robots=['r1', 'r2'])
    words = bag, '--params', team, '--output', tmp_path / 'out', '--bag'
    assert run_verb('replay', *words) == 0

    playing = domain.start('play', tmp_path / 'out' / 'bag', '--rate', 100, '--no-wait')
    status, errors = domain.finish(playing)

    assert status == 0
    assert re.search(
        r'left out: tf \(\d+ messages\); to play them, apt install ros-jazzy-tf2-msgs', errors)


def test_a_late_subscriber_gets_the_static_transforms_of_all_nodes(domain, node):
    # Any type will do: tf2_msgs is not on PyPI.
    sent = [raw('tf_static', odometry_message(ms), received_ms=0) for ms in (1, 2, 3)]
    playing = player.Player(node, {'tf_static': ODOMETRY}, ['tf_static'], 1.0, clock=False)
    playing.play(sent, process.Stop())

    heard = []
    domain.node.create_subscription(
        live_helpers.message_class(ODOMETRY), '/tf_static', heard.append,
        qos.reliable(100, latched=True), raw=True)
    domain.until(lambda: len(heard) == 3)

    assert heard == [live_helpers.on_the_wire(message.raw) for message in sent]


@pytest.mark.slow
def test_a_recorded_clock_is_the_only_one(domain, tmp_path):
    times = [ros.rosgraph_msgs__msg__Clock(
        clock=ros.builtin_interfaces__msg__Time(sec=sec, nanosec=0)) for sec in range(10, 60)]
    write_bag(tmp_path / 'bag', [
        raw('clock', time, received_ms=100 * k) for k, time in enumerate(times)])
    ticks = domain.listen('/clock', CLOCK)

    status, errors = domain.finish(domain.start('play', tmp_path / 'bag', '--clock'))

    assert status == 0
    assert '--clock has no effect' in errors
    assert [tick.clock.sec for tick in ticks] == [*range(10, 60)]


def test_playing_waits_until_every_topic_has_a_subscriber(domain, node):
    topics = {f'{name}/odom': ODOMETRY for name in ('r1', 'r2')}
    waiting = player.Player(node, topics, (), 1.0, clock=False)
    domain.listen('r1/odom', ODOMETRY)
    ticks = count()

    def tick():
        if next(ticks) == 3:
            domain.listen('r2/odom', ODOMETRY)

    # It works only if the node spins.
    node.create_timer(0.01, tick)
    waiting.wait_for_subscribers(process.Stop())

    assert next(ticks) > 3


@pytest.fixture
def connecting(domain, node, monkeypatch):
    """Return a player with a subscriber that is connected, and one of /clock that never is."""
    monkeypatch.setattr(player, 'DISCOVERY_WAIT', 0.0)
    domain.listen('r1/odom', ODOMETRY)
    playing = player.Player(node, {'r1/odom': ODOMETRY}, (), 1.0, clock=True)
    # A volatile publisher does not offer what this subscription requests.
    refused = domain.node.create_subscription(
        live_helpers.message_class(CLOCK), '/clock', lambda message: None,
        qos.reliable(1, latched=True))
    domain.until(lambda: node.count_subscribers('/clock'))
    return playing, refused


def test_playing_waits_until_all_known_subscribers_are_connected(
        connecting, domain, node, capfd):
    playing, refused = connecting
    ticks = count()

    def tick():
        if next(ticks) == 3:
            domain.node.destroy_subscription(refused)

    node.create_timer(0.01, tick)
    playing.wait_for_subscribers(process.Stop())

    assert next(ticks) > 3
    assert 'connected' not in capfd.readouterr().err


def test_a_subscriber_that_is_not_connected_in_time_is_named(connecting, monkeypatch, capfd):
    monkeypatch.setattr(player, 'MAX_CONNECTION_WAIT', 0.0)
    playing, _ = connecting

    playing.wait_for_subscribers(process.Stop())

    warned, = (line for line in capfd.readouterr().err.splitlines() if 'WARN' in line)
    assert 'not all subscribers are connected: 0 of 1 of /clock (' in warned


def test_a_topic_without_subscriber_is_named_with_the_way_to_begin_without(
        node, monkeypatch, capfd):
    monkeypatch.setattr(player, 'REMINDER_PERIOD', 0.0)
    waiting = player.Player(node, {'imu': ODOMETRY}, (), 1.0, clock=False)
    stopped = process.Stop()
    node.create_timer(0.1, stopped.set)
    waiting.wait_for_subscribers(stopped)

    assert 'waiting for subscribers of imu; to begin without them, give --no-wait' in (
        capfd.readouterr().err)


def test_the_node_spins_even_if_playback_is_too_slow_to_wait(node):
    message = raw('r1/odom', odometry_message(), received_ms=0)
    playing = player.Player(node, {'r1/odom': message.type_name}, (), 1.0, clock=False)
    ticks, began = [], monotonic()
    node.create_timer(0.01, lambda: ticks.append(monotonic()))

    # All messages are due at once, and the last comes once the timer has fired.
    playing.play(takewhile(
        lambda _: len(ticks) < 3 and monotonic() < began + 30.0, repeat(message)), process.Stop())

    assert len(ticks) == 3


@pytest.mark.slow
def test_every_byte_arrives_in_order(domain, bag):
    types = {topic: found.type_name for topic, found in bags.topics(bag).items()}
    heard = {topic: domain.record(topic, type_name) for topic, type_name in types.items()}

    assert domain.finish(domain.start('play', bag, '--rate', 10)) == (0, '')

    assert heard == recorded(bag)


@pytest.mark.slow
def test_a_late_subscriber_gets_a_latched_topic(domain, bag):
    playing = domain.start('play', bag, '--rate', 1e-3, '--no-wait')
    domain.until(lambda: domain.node.get_publishers_info_by_topic('/ground_truth/landmarks'))

    info, = domain.node.get_publishers_info_by_topic('/ground_truth/landmarks')
    assert info.qos_profile.durability.name == 'TRANSIENT_LOCAL'
    assert domain.finish(playing, signal.SIGINT)[0] == 0


def test_playing_takes_the_length_of_the_bag_divided_by_the_rate(node):
    messages = [raw('r1/odom', odometry_message(), received_ms=ms) for ms in (0, 20_000)]
    topics = {'r1/odom': messages[0].type_name}

    began = monotonic()
    player.Player(node, topics, (), 100.0, clock=False).play(messages, process.Stop())

    assert 0.2 <= monotonic() - began < 20.0


def test_the_clock_goes_on_between_messages_and_ends_at_the_last(domain, node):
    messages = [raw('r1/odom', odometry_message(), received_ms=ms) for ms in (1000, 2000)]
    topics = {'r1/odom': messages[0].type_name}
    ticks = domain.listen('/clock', CLOCK)
    playing = player.Player(node, topics, (), 4.0, clock=True)
    domain.until(lambda: domain.node.count_publishers('/clock'))

    playing.play(messages, process.Stop())
    domain.until(lambda: ticks and ticks[-1].clock.sec == 2)

    times = [tick.clock.sec + 1e-9 * tick.clock.nanosec for tick in ticks]
    assert times == sorted(times)
    assert sum(1.0 < time < 2.0 for time in times) >= 2


def test_without_waiting_a_bag_is_played_without_subscribers(domain, bag):
    assert domain.finish(domain.start('play', bag, '--no-wait', '--rate', 100)) == (0, '')


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_waiting(domain, bag, number):
    playing = domain.start('play', bag)
    domain.until(lambda: domain.node.count_publishers('/r1/odom'))

    assert domain.finish(playing, number) == (0, '')
