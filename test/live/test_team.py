# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots are added and removed through the parameter ``robots`` of a running node."""

import signal

import pytest

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.optional import optional
from helpers.ros import meeting, odometry_message, raw, raw_record, save, write_parameters

parameter = optional('rclpy.parameter')
live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')

pytestmark = pytest.mark.ros

#: Pauses between messages end no run.
TEAM = {'robots': ['r1', 'r2'], 'stale_after': 60.0}
MEETING = [raw_record(record) for record in meeting()]


def set_robots(domain, names, node='estimator'):
    """Set the parameter; return the result that the node reports."""
    changed = parameter.Parameter('robots', value=names).to_parameter_msg()
    return domain.ask(
        f'/{node}/set_parameters', services.SetParameters, parameters=[changed]).results[0]


def topics_of(domain, robot):
    """Return the numbers of publishers and subscriptions of a robot."""
    return (
        domain.node.count_publishers(f'/{robot}/pose'),
        domain.node.count_subscribers(f'/{robot}/odom'))


def odom(robot, ms):
    return raw(f'{robot}/odom', odometry_message(ms), ms)


def test_topics_are_created_and_removed_with_the_robots(domain):
    node = domain.estimate(**TEAM)

    assert set_robots(domain, ['r3', 'r1']).successful

    domain.until(lambda: topics_of(domain, 'r3') == (1, 1) and topics_of(domain, 'r2') == (0, 0))
    assert list(node.get_parameter('robots').value) == ['r3', 'r1']


def test_an_added_robot_is_estimated_and_can_be_removed_and_added_again(domain):
    domain.estimate(**TEAM | {'robots': ['r1'], 'stale_after': 0.0})
    poses = domain.listen('r3/pose', live_helpers.POSE)
    for ms, names in ((0, ['r1', 'r3']), (1000, ['r1']), (2000, ['r1', 'r3'])):
        assert set_robots(domain, names).successful
        if 'r3' in names:
            domain.until(lambda: topics_of(domain, 'r3') == (1, 1))
            domain.send(odom('r3', ms), odom('r1', ms), odom('r3', ms + 500), odom('r1', ms + 500))
            domain.until(lambda at=ms: poses and poses[-1].header.stamp.sec * 1000 >= at)

    frames = {message.header.frame_id for message in poses}
    assert frames == {'r3/map'}


@pytest.mark.parametrize(('names', 'reason'), [
    (['r2'], "the anchor 'r1' cannot be removed before it has seen a landmark"),
    (['r1', 'r1'], "'r1' twice"), (['no name'], "contains 'no name'")])
def test_an_impossible_team_is_rejected_with_the_reason(domain, names, reason):
    node = domain.estimate(**TEAM)

    result = set_robots(domain, names)

    assert not result.successful
    assert reason in result.reason
    assert list(node.get_parameter('robots').value) == ['r1', 'r2']


def test_a_new_run_starts_with_the_current_team(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'out'))
    domain.send(*MEETING)
    domain.until(lambda: node.received == len(MEETING))
    # Step 0 is later than the messages are received; the anchor cannot leave before.
    domain.until(lambda: set_robots(domain, ['r2', 'r3']).successful)

    assert domain.call('/estimator/reset')

    domain.end_estimate()
    names = {path.name for path in (tmp_path / 'out_2').iterdir()}
    assert {'trajectory_r2.csv', 'trajectory_r3.csv'} <= names
    assert 'trajectory_r1.csv' not in names


def test_a_restored_run_has_its_own_team(domain, tmp_path):
    path = str(tmp_path / 'run.checkpoint')
    run = EstimatorSession(parameters.parse(TEAM | {'checkpoint': path}), None)
    run.change_team(['r1', 'r3'])
    save(run)

    node = domain.estimate(**TEAM, restore=path)

    domain.until(lambda: topics_of(domain, 'r3') == (1, 1) and topics_of(domain, 'r2') == (0, 0))
    assert list(node.get_parameter('robots').value) == ['r1', 'r3']


@pytest.mark.slow
def test_robots_are_added_to_a_smoother_and_removed(domain, tmp_path):
    parameters = write_parameters(
        tmp_path / 'team.yaml', **TEAM | {'robots': ['r1']}, output=str(tmp_path / 'out'),
        **live_helpers.reliable_inputs(['r1', 'r2']))
    smoother = domain.start('smoother', '--ros-args', '--params-file', parameters)
    domain.wait_for_reports()

    assert set_robots(domain, ['r1', 'r2'], 'smoother').successful
    poses = domain.listen('r2/pose', live_helpers.POSE)
    domain.until(lambda: topics_of(domain, 'r2') == (1, 1))
    domain.send(*MEETING)
    domain.until(lambda: len(poses) >= 4)
    assert set_robots(domain, ['r1'], 'smoother').successful
    domain.until(lambda: topics_of(domain, 'r2') == (0, 0))
    assert set_robots(domain, ['r1', 'r2'], 'smoother').successful
    domain.until(lambda: topics_of(domain, 'r2') == (1, 1))
    status, errors = domain.finish(smoother, signal.SIGINT)

    assert status == 0, errors
    assert (tmp_path / 'out' / 'trajectory_r2.csv').read_text().count('\n') >= 5


@pytest.mark.slow
def test_a_smoother_goes_on_when_its_anchor_is_removed_before_it_has_sent_odometry(
    domain, tmp_path,
):
    parameters = write_parameters(tmp_path / 'team.yaml', **TEAM)
    smoother = domain.start('smoother', '--ros-args', '--params-file', parameters)

    assert set_robots(domain, ['r2'], 'smoother').successful

    domain.until(lambda: topics_of(domain, 'r1') == (0, 0) and topics_of(domain, 'r2') == (1, 1))
    assert domain.finish(smoother, signal.SIGINT)[0] == 0
