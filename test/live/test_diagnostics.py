# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""/diagnostics is OK only while the input of a robot arrives and is used, over DDS."""

from dataclasses import replace
from functools import cached_property
import re

import numpy as np
import pytest

from fej_slam_ros.core.records import Observation
from helpers.optional import optional
from helpers.ros import write_parameters

feeds = optional('helpers.feeds')
live_helpers = optional('helpers.live')
rclpy = optional('rclpy')
Context = optional('rclpy.context').Context
Node = optional('rclpy.node').Node
SignalHandlerOptions = optional('rclpy.signals').SignalHandlerOptions
endpoints = optional('fej_slam_ros.ros.nodes.endpoints')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

OK, WARN, ERROR, STALE = range(4)
ROBOTS = ['r1', 'r2']


class Observer:
    """The newest status of each part of the nodes of a domain."""

    def __init__(self, domain):
        self._domain = domain

    @cached_property
    def _reports(self):
        # An estimator in this process must be there before the node of the test.
        return self._domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)

    def statuses(self):
        return {status.name: status for report in self._reports for status in report.status}

    def values(self, name):
        return {item.key: item.value for item in self.statuses()[name].values}

    def until(self, name, level, pattern=''):
        """Wait until a status has a level and a sentence; fail with what it has."""
        def found():
            status = self.statuses().get(name)
            return status and status.level == level and re.search(pattern, status.message)

        try:
            self._domain.until(found)
        except AssertionError:
            pytest.fail(f'{name}: {self.statuses().get(name)}')


@pytest.fixture
def observer(domain):
    return Observer(domain)


@pytest.fixture
def flowing(domain, observer):
    """Return the feeds of r1, with odometry and scans that are used by an estimator."""
    domain.estimate(robots=['r1'])
    odometry = feeds.Feed(domain, 20, feeds.standing('r1'))
    scans = feeds.Feed(domain, 10, feeds.looking('r1'))
    observer.until('estimator: r1', OK, '^in map$')
    return odometry, scans


def test_without_publishers_nothing_is_ok(domain, observer):
    domain.estimate(robots=ROBOTS)

    observer.until('estimator: r1', WARN, 'not joined: .*; /r1/odom has no publisher$')
    observer.until('estimator: filter', WARN, 'no odometry received')


def test_a_publisher_of_another_type_is_an_error(domain, observer):
    domain.estimate(robots=ROBOTS)

    # One participant has one type per topic, so the other node is of a context of its own.
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    other = Node('other', context=context)
    other.create_publisher(endpoints.message_class('geometry_msgs/msg/Twist'), 'r2/odom', 1)

    observer.until(
        'estimator: r2', ERROR,
        '/r2/odom is published as geometry_msgs/msg/Twist, this node needs nav_msgs/msg/Odometry')
    other.destroy_node()
    rclpy.shutdown(context=context)


def test_a_publisher_of_incompatible_qos_is_an_error_of_its_robot(domain, observer):
    domain.estimate(
        robots=ROBOTS, **{'qos_overrides./r1/odom.subscription.reliability': 'reliable'})

    domain.node.create_publisher(
        endpoints.message_class('nav_msgs/msg/Odometry'), 'r1/odom', qos.best_effort(1))

    observer.until('estimator: r1', ERROR, 'a publisher offers BEST_EFFORT')


@pytest.mark.slow
def test_a_robot_without_observations_is_told_which_topics_to_publish(domain, observer):
    domain.estimate(robots=['r1'])
    feeds.Feed(domain, 20, feeds.standing('r1'))

    observer.until(
        'estimator: r1', WARN, '^in map; no landmark observed yet; /r1/landmarks and /r1/robots')
    scans = feeds.Feed(domain, 10, feeds.looking('r1', {}))
    observer.until('estimator: r1', OK, '^in map; no landmark observed yet$')
    scans.record = feeds.looking('r1')
    observer.until('estimator: r1', OK, '^in map$')


@pytest.mark.slow
def test_odometry_and_scans_that_stop_are_reported_until_they_are_back(observer, flowing):
    odometry, scans = flowing

    scans.pause()
    observer.until('estimator: r1', WARN, r'landmark scans stopped \d\.\d s ago$')
    scans.resume()
    observer.until('estimator: r1', OK)

    odometry.pause()
    observer.until('estimator: r1', STALE, r'odometry stopped \d\.\d s ago')
    observer.until('estimator: filter', STALE, 'the odometry of all robots has stopped')
    odometry.resume()
    observer.until('estimator: r1', OK)
    observer.until('estimator: filter', OK, 'running')

    scans.end()
    observer.until('estimator: r1', WARN, 'scans stopped .* ago: /r1/landmarks has no publisher')


def test_scans_that_are_all_rejected_are_an_error_with_the_reason(observer, flowing):
    _, scans = flowing

    scans.record = lambda ms: replace(
        feeds.looking('r1')(ms), observations=(Observation(-2, np.zeros(2), np.eye(2)),))

    observer.until(
        'estimator: r1', ERROR,
        r'the last \d+ messages on /r1/landmarks were all rejected: \d+ bad_id$')


@pytest.mark.slow
def test_gated_observations_are_an_error_also_with_one_per_scan(observer, flowing):
    _, scans = flowing

    scans.record = feeds.looking('r1', {1: (-5.0, 8.0)})
    observer.until('estimator: r1', ERROR, r'10 of the last 10 observations gated')
    scans.record = feeds.looking('r1')
    observer.until('estimator: r1', OK)


@pytest.mark.slow
def test_landmarks_of_which_none_is_used_are_a_warning_with_the_reason(observer, flowing):
    _, scans = flowing

    # The clock of the scanner is ahead of that of the odometry by less than future_limit.
    look = feeds.looking('r1')
    scans.record = lambda ms: look(ms + 4900)

    observer.until(
        'estimator: r1', WARN, r'none of \d+ observations used for .* \d+ messages wait for later')


@pytest.mark.slow
def test_a_robot_that_delays_the_others_is_a_warning_with_the_delay(domain, observer):
    domain.estimate(robots=ROBOTS)
    for robot, rate in ('r1', 50), ('r2', 1.25):
        feeds.Feed(domain, rate, feeds.standing(robot))
        feeds.Feed(domain, 5, feeds.looking(robot))

    observer.until('estimator: r2', WARN, r'delays the other robots by up to 0\.[78]\d s')

    assert 'delays' not in observer.statuses()['estimator: r1'].message
    assert 0.7 < float(observer.values('estimator: r2')['delays_others_s']) < 0.9


@pytest.mark.slow
@pytest.mark.usefixtures('flowing')
def test_each_topic_has_its_rate(domain, observer):
    def rates():
        values = observer.values('estimator: r1')
        return [float(values[f'{kind}_rate_hz']) for kind in ('odom', 'landmarks', 'robots')]

    domain.until(lambda: np.allclose(rates(), [20.0, 10.0, 0.0], rtol=0.15))


@pytest.mark.slow
def test_the_statuses_of_two_estimators_have_names_of_their_own(domain, observer, tmp_path):
    path = write_parameters(tmp_path / 'team.yaml', robots=['r1'])
    for namespace in 'east', 'west':
        domain.start(
            'estimator', '--ros-args', '--params-file', path, '-r', f'__ns:=/{namespace}')

    domain.until(lambda: len(observer.statuses()) == 8)

    assert {name: status.hardware_id for name, status in observer.statuses().items()} == {
        f'{namespace}/estimator: {part}': hardware for namespace in ('east', 'west')
        for part, hardware in {
            'r1': 'r1', 'qos': 'fej_slam_ros', 'files': 'fej_slam_ros',
            'filter': 'fej_slam_ros'}.items()}


@pytest.mark.slow
def test_the_smoother_reports_its_input_too(domain, observer, tmp_path):
    path = write_parameters(tmp_path / 'team.yaml', robots=['r1'])
    domain.start('smoother', '--ros-args', '--params-file', path)
    observer.until('smoother: r1', WARN, '/r1/odom has no publisher')

    odometry = feeds.Feed(domain, 20, feeds.standing('r1'))
    feeds.Feed(domain, 10, feeds.looking('r1'))
    observer.until('smoother: smoother', OK, 'running')
    odometry.pause()

    observer.until('smoother: r1', STALE, 'odometry stopped')


@pytest.mark.slow
@pytest.mark.usefixtures('flowing')
def test_another_node_that_publishes_the_pose_of_a_robot_is_named(domain, observer):
    pose = domain.node.create_publisher(
        live_helpers.message_class(live_helpers.POSE), 'r1/pose', 10)
    name = domain.node.get_fully_qualified_name()

    observer.until('estimator: r1', WARN, f'its pose is also published by {name}: stop one')

    domain.node.destroy_publisher(pose)
    observer.until('estimator: r1', OK, '^in map$')
