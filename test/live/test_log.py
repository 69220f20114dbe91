# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log has one line for each event of a run, over DDS on /rosout."""

from functools import cached_property
import re

import numpy as np
import pytest

from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.ros.messages import outgoing
from helpers.optional import optional
from helpers.ros import raw, write_parameters

feeds = optional('helpers.feeds')
live_helpers = optional('helpers.live')
endpoints = optional('fej_slam_ros.ros.nodes.endpoints')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

INFO, WARN, ERROR = 20, 30, 40
S = 1_000_000_000


class Log:
    """The lines that the nodes of a domain have logged."""

    def __init__(self, domain):
        self._domain = domain

    @cached_property
    def messages(self):
        # An estimator in this process must be there before the node of the test.
        messages = []
        self._domain.node.create_subscription(
            endpoints.message_class('rcl_interfaces/msg/Log'), '/rosout', messages.append,
            qos.reliable(1000, latched=True))
        return messages

    def lines(self, level=INFO):
        return [message.msg for message in self.messages if message.level >= level]

    def of(self, pattern, level=INFO):
        """Return the lines of a level that contain a pattern."""
        return [
            message.msg for message in self.messages
            if message.level == level and re.search(pattern, message.msg)]

    def until(self, pattern, level=INFO, times=1):
        """Wait for a line."""
        try:
            self._domain.until(lambda: len(self.of(pattern, level)) == times)
        except AssertionError:
            pytest.fail(f'{pattern!r} is not in {self.lines()}')


@pytest.fixture
def log(domain):
    return Log(domain)


def test_a_start_is_followed_line_by_line(domain, log):
    domain.estimate(robots=['r1', 'r2'])

    log.until('^configured: .*')
    configured, = log.of('^configured')
    assert configured.startswith('configured: robots r1 (anchor), r2; filter fej; inputs /r1/{')
    assert '/r2/{odom,landmarks,robots,' in configured
    log.until('^active$')
    log.until(
        r'^waiting for odometry of r1 \(/r1/odom has no publisher\); odometry of r2 \(.*\)$')
    for robot in 'r1', 'r2':
        feeds.Feed(domain, 20, feeds.standing(robot))
        feeds.Feed(domain, 10, feeds.looking(robot))
        log.until(f'^first data of {robot} on /{robot}/odom$')
    log.until('^r2 joined map, by ')

    step_0, = log.of('^step 0')
    assert re.match(r'.* at \d+\.\d{3} s: the anchor r1 observes its first landmark', step_0)
    assert log.of('joined')[0] == 'r1 joined map, by its anchor_pose'
    others = 'waiting', 'transforms'
    order = [line.split()[0] for line in log.lines() if not line.startswith(others)]
    assert order[:3] == ['configured:', 'active', 'first']


@pytest.fixture
def running(domain, log, tmp_path):
    """Return the feeds of r1 and r2, which are in map."""
    domain.estimate(
        robots=['r1', 'r2', 'r3'], checkpoint=str(tmp_path / 'run.checkpoint'),
        inflate_rejected_scans=False)
    flows = {
        robot: (feeds.Feed(domain, 20, feeds.standing(robot)),
                feeds.Feed(domain, 10, feeds.looking(robot)))
        for robot in ('r1', 'r2')}
    log.until('^r2 joined map')
    return flows


@pytest.mark.slow
def test_a_robot_that_is_lost_and_recovers(log, running):
    _, scans = running['r2']

    scans.record = feeds.looking('r2', {k: (-x, -y) for k, (x, y) in feeds.VIEW.items()})
    log.until(r'^r2 is likely lost: \d+ of \d+ observations gated in a row$', WARN)
    scans.record = feeds.looking('r2')
    log.until('^r2 has recovered: ')


@pytest.mark.slow
def test_a_robot_that_stops_and_is_back(log, running):
    odometry, _ = running['r2']

    odometry.pause()
    log.until(r'^r2 is stale: no odometry for \d\.\d s, ', WARN)
    odometry.resume()
    log.until(r'^r2 is back: odometry after \d\.\d s$')

    assert not log.of('^r1 is (stale|back)', WARN)


@pytest.mark.slow
@pytest.mark.usefixtures('running')
def test_a_pose_that_places_a_robot(domain, log):
    feeds.Feed(domain, 20, feeds.standing('r3'))
    log.until('^first data of r3')
    log.until(r'waiting for r3 to join map \(')

    def place(topic, stamp, x):
        prior = PosePrior('r3', stamp, np.array([x, 0.0, 0.0]), 0.01 * np.eye(3))
        _, message = outgoing.input_message(prior, {})
        domain.send(raw(topic, message))

    place('r3/set_pose', domain.node.get_clock().now().nanoseconds, np.nan)
    log.until('^set_pose of r3 rejected: not_finite$', WARN)
    place('r3/set_pose', domain.node.get_clock().now().nanoseconds, 2.0)
    log.until('^r3 joined map, by set_pose$')
    log.until('^set_pose of r3 accepted$')


@pytest.mark.slow
def test_a_landmark_that_is_moved(log, running):
    for robot, (_, scans) in running.items():
        scans.record = feeds.looking(robot, feeds.VIEW | {3: (3.0, -4.0)})

    log.until('^landmark 3 was moved: its observations are rejected$', WARN)


@pytest.mark.slow
@pytest.mark.usefixtures('running')
def test_a_checkpoint_and_a_reset(domain, log, tmp_path):
    domain.call('/estimator/save')
    log.until(f'^checkpoint written to {tmp_path}/run.checkpoint$')

    domain.call('/estimator/reset')
    log.until('^reset: a new run begins with the next input$')
    log.until('^step 0', times=2)


@pytest.mark.slow
def test_a_run_writes_no_line_per_message(domain, log, running):
    count = len(log.lines())
    sent = domain.node.get_clock().now().nanoseconds

    domain.until(lambda: domain.node.get_clock().now().nanoseconds - sent > 3 * S)

    assert len(log.lines()) - count <= 1, log.lines()[count:]
    assert running


@pytest.mark.slow
def test_missing_input_is_repeated_every_five_seconds(domain, log):
    domain.estimate(robots=['r1'])

    log.until('^waiting for', times=2)
    first, second = [
        message.stamp.sec + 1e-9 * message.stamp.nanosec for message in log.messages
        if message.msg.startswith('waiting')]

    assert 4.5 < second - first < 6.0


@pytest.mark.slow
def test_a_jump_of_time_is_an_error_once(domain, log, running):
    for odometry, scans in running.values():
        odometry.record, scans.record = (
            shifted(feed.record, -5000) for feed in (odometry, scans))

    log.until(r'^time jumped back by [45]\.\d{3} s, all input is rejected: call ~/reset', ERROR)
    assert domain.call('/estimator/reset')
    log.until('^step 0', times=2)


def shifted(record, shift):
    """Return records whose stamps are shifted by a time in ms."""
    return lambda ms: record(ms + shift)


def test_a_node_that_waits_for_the_clock(domain, log):
    domain.estimate(robots=['r1'], use_sim_time=True)

    log.until(r'^waiting for /clock \(use_sim_time is set\)$')


@pytest.mark.slow
def test_the_smoother_logs_its_start(domain, log, tmp_path):
    path = write_parameters(tmp_path / 'team.yaml', robots=['r1', 'r2'])
    domain.start('smoother', '--ros-args', '--params-file', path)
    log.until(r'^configured: robots r1 \(anchor\), r2; inputs /r1/\{odom,landmarks,robots,')
    log.until('^waiting for odometry of r1')

    for robot in 'r1', 'r2':
        feeds.Feed(domain, 20, feeds.standing(robot))
        feeds.Feed(domain, 10, feeds.looking(robot))

    log.until('^first data of r1')
    log.until('^r1 joined map, by its anchor_pose$')
    log.until('^r2 joined map, by observations of robots and shared landmarks$')
