# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node detector publishes what `detect` writes, bit for bit."""

from itertools import repeat
import signal
from types import MappingProxyType

import numpy as np
import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings, known_parameters
from helpers.optional import optional
from helpers.ros import run_verb, write_parameters

front_end = optional('fej_slam_ros.ros.nodes.front_end')
live_helpers = optional('helpers.live')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

WORLD = {'environment': 'posts', 'steps_per_loop': 100, 'loops': 1, 'beams': 360, 'seed': 1}
CLOUD = 'sensor_msgs/msg/PointCloud2'
#: Level of a line of the log, as rcl_interfaces/msg/Log defines it.
INFO = 20
RELIABLE = {
    f'qos_overrides./{robot}/{kind}.subscription.{policy}': value
    for robot in ('r1', 'r2') for kind in ('odom', 'scan')
    for policy, value in (('reliability', 'reliable'), ('depth', 3000))}


def counted(reports, robot, count):
    """Return a count of a robot in the latest diagnostics."""
    values = {
        entry.key: int(entry.value) for report in reports[-1:] for status in report.status
        if status.name.endswith(robot) for entry in status.values}
    return values.get(count, 0)


@pytest.mark.slow
def test_a_sensor_that_falls_silent_is_a_warning(tmp_path):
    world = write_parameters(tmp_path / 'world.yaml', **WORLD)
    assert run_verb('simulate', '--params', world, '--output', tmp_path / 'bag') == 0
    sent = [m for m in bags.read(tmp_path / 'bag') if m.topic in {'r1/odom', 'r1/scan'}]

    with live_helpers.Domain() as domain:
        domain.start('detector', '--ros-args', '-p', 'robots:=[r1]')
        reports = domain.wait_for_reports()
        while not counted(reports, 'r1', 'scans'):
            domain.send(*sent[:200])
            before = len(reports)
            domain.until(lambda: len(reports) > before)  # noqa: B023

        domain.until(lambda: 'the scans have stopped' in reports[-1].status[0].message)


def test_scans_of_another_type_are_named():
    with live_helpers.Domain() as domain:
        domain.start('detector', '--ros-args', '-p', 'robots:=[r1]')
        reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
        domain.node.create_publisher(live_helpers.message_class(CLOUD), 'r1/scan', 1)

        domain.until(lambda: reports and reports[-1].status[0].message == (
            '/r1/scan is published as sensor_msgs/msg/PointCloud2, this node needs'
            ' sensor_msgs/msg/LaserScan'))


class EndlessFrontEnd:
    """A front end that always has something to publish."""

    robots, topics = (), MappingProxyType({})
    outputs = MappingProxyType(
        {'r1/landmarks': CLOUD, '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'})

    def take(self, is_wanted):
        return self.close()

    def close(self):
        return repeat(('r1/landmarks', outgoing.detections(
            0, 'r1/base_link', [], np.empty((0, 2)), np.empty((0, 2, 2)))))


def test_work_without_end_delays_neither_messages_nor_the_end_of_a_node():
    with live_helpers.Domain() as domain:
        domain.node.get_logger()
        node = front_end.FrontEndNode('front_end')
        node.start(EndlessFrontEnd(), DetectorSettings(), known_parameters())

        node.work()
        assert node.is_behind
        node.close()
        node.destroy_node()


@pytest.mark.slow
def test_the_log_names_the_topics_that_are_read_after_remapping():
    with live_helpers.Domain() as domain:
        detector = domain.start(
            'detector', '--ros-args', '-r', '__ns:=/fleet', '-p', 'robots:=[r1, r2]',
            '-r', 'r1/scan:=/hokuyo')
        domain.wait_for_reports()
        _, log = domain.finish(detector, signal.SIGINT)

    # Topics of transforms follow, where tf2_msgs is installed.
    assert (
        'active: robots r1, r2; inputs /hokuyo, /fleet/r2/{scan,odom}, /fleet/r1/odom') in log


def test_reports_name_the_namespace_and_a_missing_clock():
    with live_helpers.Domain() as domain:
        domain.start('detector', '--ros-args', '-r', '__ns:=/fleet', '-p', 'robots:=[r1]',
                     '-p', 'use_sim_time:=true')
        reports = domain.wait_for_reports()

    status, = reports[0].status
    assert status.name == 'fleet/detector: r1'
    assert status.message == 'waiting for /clock: use_sim_time is set'


@pytest.mark.slow
def test_simulated_time_that_begins_late_is_logged_without_a_warning():
    with live_helpers.Domain() as domain:
        domain.start('detector', '--ros-args', '-p', 'robots:=[r1]', '-p', 'use_sim_time:=true')
        lines = domain.listen('/rosout', 'rcl_interfaces/msg/Log')
        domain.until(lambda: [line for line in lines if 'waiting for /clock' in line.msg])

    assert {line.level for line in lines if 'waiting for /clock' in line.msg} == {INFO}


@pytest.mark.slow
def test_an_incompatible_publisher_is_named_with_the_parameter_that_resolves_it():
    with live_helpers.Domain() as domain:
        domain.start(
            'detector', '--ros-args', '-p', 'robots:=[r1]', '-p',
            'qos_overrides./r1/scan.subscription.reliability:=reliable')
        reports = domain.wait_for_reports()
        domain.node.create_publisher(
            live_helpers.message_class('sensor_msgs/msg/LaserScan'), '/r1/scan',
            qos.best_effort(1))

        domain.until(lambda: (
            'set qos_overrides./r1/scan.subscription.reliability: best_effort'
            in reports[-1].status[0].message))


def test_live_landmarks_are_those_of_detect(tmp_path):
    world = write_parameters(tmp_path / 'world.yaml', **WORLD)
    settings = write_parameters(tmp_path / 'detector.yaml', robots=['r1', 'r2'], **RELIABLE)
    assert run_verb('simulate', '--params', world, '--output', tmp_path / 'bag') == 0
    words = tmp_path / 'bag', '--params', settings, '--output', tmp_path / 'out'
    assert run_verb('detect', *words) == 0
    expected = {'r1/landmarks': [], 'r2/landmarks': []}
    sent = []
    for message in bags.read(tmp_path / 'out'):
        if message.topic in expected:
            expected[message.topic].append(live_helpers.on_the_wire(message.raw))
        elif message.topic.endswith(('/odom', '/scan')):
            sent.append(message)

    with live_helpers.Domain() as domain:
        detector = domain.start('detector', '--ros-args', '--params-file', settings)
        received = {topic: domain.record(topic, CLOUD) for topic in expected}
        reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
        # Until subscribers have discovered the publishers, messages are lost; again they change
        # nothing.
        for kind, count in (('odom', 'odometry'), ('scan', 'scans_late')):
            first = [next(m for m in sent if m.topic == f'{r}/{kind}') for r in ('r1', 'r2')]
            while not all(counted(reports, robot, count) for robot in ('r1', 'r2')):
                domain.send(*first)
                before = len(reports)
                domain.until(lambda: len(reports) > before)  # noqa: B023
        domain.send(*sent)
        # Without the last scans, which wait for odometry until the node ends.
        domain.until(lambda: all(len(received[t]) >= len(expected[t]) - 1 for t in expected))
        status, errors = domain.finish(detector, signal.SIGINT)

    assert (status, errors.count('Traceback')) == (0, 0)
    for topic, messages in expected.items():
        assert [live_helpers.on_the_wire(raw) for raw in received[topic]] == messages[
            :len(received[topic])]
