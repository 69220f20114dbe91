# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots come and leave through the parameter ``robots`` of a running estimator."""

import pytest

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.optional import optional
from helpers.ros import meeting, odometry_message, raw, raw_record

parameter = optional('rclpy.parameter')
live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')

pytestmark = pytest.mark.ros

#: Nothing is finished because input is missing for a while.
TEAM = {'robots': ['r1', 'r2'], 'stale_after': 60.0}
MEETING = [raw_record(record) for record in meeting()]


def set_robots(domain, names):
    """Set the parameter; return what the node says of it."""
    changed = parameter.Parameter('robots', value=names).to_parameter_msg()
    return domain.ask(
        '/estimator/set_parameters', services.SetParameters, parameters=[changed]).results[0]


def topics_of(domain, robot):
    """Return how many publishers and subscriptions there are on topics of a robot."""
    return (
        domain.node.count_publishers(f'/{robot}/pose'),
        domain.node.count_subscribers(f'/{robot}/odom'))


def odom(robot, ms):
    return raw(f'{robot}/odom', odometry_message(ms), ms)


def test_topics_come_and_go_with_the_robots(domain):
    node = domain.estimate(**TEAM)

    assert set_robots(domain, ['r3', 'r1']).successful

    domain.until(lambda: topics_of(domain, 'r3') == (1, 1) and topics_of(domain, 'r2') == (0, 0))
    assert list(node.get_parameter('robots').value) == ['r3', 'r1']


def test_a_robot_that_came_is_estimated_and_may_leave_and_come_again(domain):
    domain.estimate(**TEAM | {'robots': ['r1'], 'stale_after': 0.0})
    heard = domain.listen('r3/pose', live_helpers.POSE)
    for ms, names in ((0, ['r1', 'r3']), (1000, ['r1']), (2000, ['r1', 'r3'])):
        assert set_robots(domain, names).successful
        if 'r3' in names:
            domain.until(lambda: topics_of(domain, 'r3') == (1, 1))
            domain.send(odom('r3', ms), odom('r1', ms), odom('r3', ms + 500), odom('r1', ms + 500))
            domain.until(lambda at=ms: heard and heard[-1].header.stamp.sec * 1000 >= at)

    frames = {message.header.frame_id for message in heard}
    assert frames == {'r3/map'}


@pytest.mark.parametrize(('names', 'why'), [
    (['r2'], "the anchor 'r1' cannot be removed before it has seen a landmark"),
    (['r1', 'r1'], "'r1' twice"), (['no name'], 'must be a list of names')])
def test_what_cannot_be_is_refused_with_the_reason(domain, names, why):
    node = domain.estimate(**TEAM)

    result = set_robots(domain, names)

    assert not result.successful
    assert why in result.reason
    assert list(node.get_parameter('robots').value) == ['r1', 'r2']


def test_a_new_run_begins_with_the_team_as_it_is(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'out'))
    domain.send(*MEETING)
    domain.until(lambda: node.received == len(MEETING))
    assert set_robots(domain, ['r2', 'r3']).successful

    assert domain.call('/estimator/reset')

    domain.end_estimate()
    names = {path.name for path in (tmp_path / 'out_2').iterdir()}
    assert {'trajectory_r2.csv', 'trajectory_r3.csv'} <= names
    assert 'trajectory_r1.csv' not in names


def test_a_restored_run_has_the_team_that_it_had(domain, tmp_path):
    path = str(tmp_path / 'run.checkpoint')
    run = EstimatorSession(parameters.parse(TEAM | {'checkpoint': path}), None)
    run.change_team(['r1', 'r3'])
    run.save()

    node = domain.estimate(**TEAM, restore=path)

    domain.until(lambda: topics_of(domain, 'r3') == (1, 1) and topics_of(domain, 'r2') == (0, 0))
    assert list(node.get_parameter('robots').value) == ['r1', 'r3']
