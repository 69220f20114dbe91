# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot in ``map`` is placed anew by RViz or another node, or restarts, also in a replay."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import parse
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.optional import optional
from helpers.records import MS
from helpers.ros import drive, meeting, raw_record, summary_of

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')
trigger = optional('std_srvs.srv')
Parameter = optional('rclpy.parameter').Parameter

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2'], 'stale_after': 30.0}
#: Messages of both robots in ``map``, up to and after 500 ms.
BEFORE, AFTER = ([raw_record(r) for r in meeting(20) if (r.stamp <= 500 * MS) is early]
                 for early in (True, False))
POSE = np.array([3.0, -2.0, 0.5])


def pose_message(topic=None):
    """Return a pose that r2 is given."""
    said = raw_record(PosePrior('r2', 500 * MS, POSE, 1e-4 * np.eye(3)))
    return said if topic is None else replace(said, topic=topic)


def start(domain, **values):
    """Start an estimator whose robots are both in ``map``; return it and the poses of r2."""
    node = domain.estimate(**{**TEAM, **values})
    poses = domain.listen('r2/pose', live_helpers.POSE)
    domain.send(*BEFORE)
    domain.until(lambda: node.received == len(BEFORE))
    domain.until(lambda: poses and poses[-1].header.frame_id != 'r2/map')
    return node, poses


def pose_at(poses, ms):
    """Return x and y of the pose at a stamp, None until it arrives."""
    for message in poses:
        if message.header.stamp.sec * 1000 + message.header.stamp.nanosec // MS == ms:
            position = message.pose.pose.position
            return message.header.frame_id, [position.x, position.y]
    return None


def ask(domain, service):
    """Call a trigger service and return its response."""
    return domain.ask(service, trigger.Trigger)


def test_a_robot_in_map_is_placed_by_set_pose(domain):
    _, poses = start(domain)

    domain.send(pose_message(), *[m for m in AFTER if 'odom' in m.topic])

    domain.until(lambda: pose_at(poses, 500))
    frame, position = pose_at(poses, 500)
    assert frame == 'map'
    # The scan of this step is 0.1 m, the pose 0.01 m: it is moved little.
    assert_allclose(position, POSE[:2], atol=0.3)


def test_initialpose_places_the_robot_that_a_parameter_names(domain):
    node, poses = start(domain)
    message = Parameter('initialpose_robot', value='r2').to_parameter_msg()
    result, = domain.ask(
        '/estimator/set_parameters', services.SetParameters, parameters=[message]).results
    assert result.successful

    domain.send(pose_message(topic='initialpose'), *[m for m in AFTER if 'odom' in m.topic])

    domain.until(lambda: pose_at(poses, 500))
    assert_allclose(pose_at(poses, 500)[1], POSE[:2], atol=0.3)
    assert node.received == len(BEFORE) + 1 + len([m for m in AFTER if 'odom' in m.topic])


def test_initialpose_of_no_named_robot_is_not_used_and_says_so(domain, capfd):
    node = domain.estimate(**TEAM)

    domain.send(pose_message(topic='initialpose'))
    domain.until(lambda: node.received)

    assert (
        "set the parameter 'initialpose_robot' to its robot, one of r1, r2"
        in capfd.readouterr().err)


def test_a_robot_relocalizes_on_request_and_a_replay_does_the_same(domain, tmp_path):
    _, poses = start(domain, output=str(tmp_path / 'out'), map_frame='world')
    requests = domain.record('r2/set_pose', live_helpers.POSE)

    response = ask(domain, '/r2/relocalize')

    assert response.success
    assert response.message.startswith('r2 restarts in r2/map at its next step')
    domain.until(lambda: requests)
    domain.send(*AFTER)
    domain.until(lambda: pose_at(poses, 1500))
    # Three landmarks that it observes at once are enough to join.
    assert pose_at(poses, 1500)[0] == 'world'
    domain.end_estimate()
    live = summary_of(tmp_path / 'out')
    replayed = EstimatorSession(parse(TEAM), None)
    request = RawMessage('r2/set_pose', live_helpers.POSE, None, bytes(requests[0]))
    drive(replayed, [*BEFORE, request, *AFTER])
    assert live['state_hash'] == replayed.write_files()['state_hash']
    assert live['robots']['r2']['located_anew'] == 1
    assert live['robots']['r2']['set_poses_used'] == 1


@pytest.mark.parametrize(('robot', 'values', 'reason'), [
    ('r2', {}, 'r2 is not in map: it sent no usable odometry'),
    ('r1', {'robots': ['r1']}, 'r1 is not in map: it sent no usable odometry')])
def test_a_request_that_changes_nothing_is_answered_with_the_reason(domain, robot, values, reason):
    domain.estimate(**TEAM | values)

    response = ask(domain, f'/{robot}/relocalize')

    assert not response.success
    assert response.message == reason


def test_the_services_follow_the_team(domain):
    domain.estimate(**TEAM)
    message = Parameter('robots', value=['r1', 'r3']).to_parameter_msg()
    domain.ask('/estimator/set_parameters', services.SetParameters, parameters=[message])

    def offered():
        return {name for name, _ in domain.node.get_service_names_and_types()}

    domain.until(lambda: '/r3/relocalize' in offered() and '/r2/relocalize' not in offered())
