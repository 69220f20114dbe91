# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`play` publishes topics under the expected names; `replay` equals a node in a namespace."""

from dataclasses import replace
import signal

import pytest

from fej_slam_ros.ros.files import bags
from helpers.optional import optional
from helpers.ros import (
    meeting, odometry_message, raw, raw_record, run_verb, summary_of, write_bag, write_parameters)

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros

NAMES = {
    'r1/odom': 'fleet/husky1/odometry/filtered', 'r1/landmarks': 'fleet/husky1/tags',
    'r2/odom': 'fleet/r2/odom', 'r2/landmarks': 'fleet/r2/landmarks'}
OPTIONS = (
    '--namespace', 'fleet', '--remap', '/fleet/husky1/odometry/filtered:=/r1/odom',
    '/fleet/husky1/tags:=/r1/landmarks')


@pytest.mark.slow
def test_publishers_have_the_new_names_only(domain, tmp_path):
    topics = 'husky1/odom', 'husky2/odom', 'vicon/odom'
    bag = write_bag(tmp_path / 'bag', [raw(topic, odometry_message(), 0) for topic in topics])

    playing = domain.start(
        'play', bag, '--remap', '/husky1/odom:=/r1/odom', '--remap', '/husky2/:=/fleet/r2/')
    expected = '/r1/odom', '/fleet/r2/odom', '/vicon/odom'
    domain.until(lambda: all(map(domain.node.count_publishers, expected)))

    assert not domain.node.count_publishers('/husky1/odom')
    assert not domain.node.count_publishers('/husky2/odom')
    domain.finish(playing, signal.SIGINT)


@pytest.mark.slow
def test_every_message_arrives_on_its_new_topic(domain, tmp_path):
    messages = [raw_record(record) for record in meeting(21)]
    bag = write_bag(tmp_path / 'bag', [replace(m, topic=NAMES[m.topic]) for m in messages])
    types = {message.topic: message.type_name for message in messages}
    heard = {name: domain.record(name, type_name) for name, type_name in types.items()}

    assert domain.finish(domain.start('play', bag, '--rate', 10, *OPTIONS)) == (0, '')

    assert heard == {
        name: [live_helpers.on_the_wire(m.raw) for m in messages if m.topic == name]
        for name in NAMES}


@pytest.mark.slow
def test_an_estimator_of_other_names_estimates_from_a_played_bag(domain, tmp_path):
    messages = [raw_record(record) for record in meeting()]
    bag = write_bag(tmp_path / 'bag', [replace(m, topic=NAMES[m.topic]) for m in messages])
    robots = ['r1', 'r2']
    domain.estimate(robots=robots, **live_helpers.reliable_inputs(robots))
    poses = [domain.listen(f'{robot}/pose', live_helpers.POSE) for robot in robots]

    playing = domain.start('play', bag, *OPTIONS)
    domain.until(lambda: all(poses))

    assert {pose.header.frame_id for pose in poses[0]} == {'map'}
    domain.finish(playing)


@pytest.mark.slow
def test_a_node_in_a_namespace_publishes_what_replay_writes(domain, tmp_path):
    messages = [replace(m, topic=f'fleet/{m.topic}') for m in map(raw_record, meeting(21))]
    bag = write_bag(tmp_path / 'bag', messages)
    values = live_helpers.live_values(write_parameters(tmp_path / 'team.yaml'), tmp_path / 'live')
    params = write_parameters(tmp_path / 'fleet.yaml', node='/fleet/estimator', **{
        name.replace('qos_overrides./', 'qos_overrides./fleet/'): value
        for name, value in values.items()})
    assert run_verb('replay', bag, '--params', params, '--output', tmp_path / 'replayed', '--bag',
                    '--namespace', '/fleet') == 0
    expected = [m.raw for m in bags.read(tmp_path / 'replayed/bag') if m.topic == 'fleet/r2/pose']

    heard = domain.record('fleet/r2/pose', live_helpers.POSE)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    node = domain.start(
        'estimator', '--ros-args', '-r', '__ns:=/fleet', '--params-file', params)
    # DDS discovers endpoints in order: when a report arrives, the poses are connected.
    domain.until(lambda: reports)
    assert domain.finish(domain.start('play', bag, '--rate', 2)) == (0, '')
    domain.finish(node, signal.SIGINT)
    domain.until(lambda: len(heard) >= len(expected))

    assert heard == expected
    live, replayed = summary_of(tmp_path / 'live'), summary_of(tmp_path / 'replayed')
    assert live['state_hash'] == replayed['state_hash']
