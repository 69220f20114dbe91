# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node adapter publishes what `adapt` writes, bit for bit, of messages of each package."""

from collections import Counter, defaultdict
import json
import signal
import sys

import pytest

from fej_slam_ros.ros.parameters.adapter_settings import parse_adapter
from fej_slam_ros.ros.session.adapter_session import AdapterSession
from helpers import foreign
from helpers.message_packages import provided
from helpers.optional import optional
from helpers.ros import assert_one_sentence, cdr, run_verb, write_parameters

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros

CLOUD = 'sensor_msgs/msg/PointCloud2'
TEXT = 'std_msgs/msg/String'
SETTINGS = {
    'robots': ['r1'], 'tf_topics': 'robot',
    'r1.sensor_pose': [0.2, 0.1, 0.5, -1.5708, 0.0, -1.5708]}
NEAR, FAR = (0.3, 0.2, 2.0), (-1.0, 0.1, 5.0)
#: Messages of each format, the first of which is sent until the node has received one.
MESSAGES = {
    'marker_array': [
        foreign.marker_array(k, 'r1/camera', {('', 4): NEAR, ('posts', 9): FAR})
        for k in range(20)],
    'apriltag': [
        foreign.april_tags(k, 'r1/camera', {'tag36h11:14': NEAR, 'tag36h11:19': FAR})
        for k in range(20)],
    'aruco': [foreign.aruco(k, 'r1/camera', {4: NEAR}, {'board': FAR}) for k in range(20)],
    'detection3d': [
        foreign.detections3d(k, 'r1/camera', [('4', '', NEAR, None), ('cup', '', FAR, None)])
        for k in range(20)],
    'landmark_list': [
        foreign.landmark_list(k, 'r1/camera', {'4': (NEAR, 100.0), 'dock': (FAR, 1.0)})
        for k in range(20)],
    'range_bearing': [
        foreign.range_bearing(k, 'r1/camera', [(4, 2.0, 0.1, 0.2), (-1, 3.0, 0.2, 0.1)])
        for k in range(20)]}


@pytest.fixture(scope='module')
def packages(tmp_path_factory):
    """Provide the packages of the messages."""
    definitions = defaultdict(dict)
    definitions['tf2_msgs']['TFMessage'] = 'geometry_msgs/TransformStamped[] transforms\n'
    for name, text in foreign.DEFINITIONS.items():
        package, _, message = name.split('/')
        definitions[package][message] = text
    with provided(tmp_path_factory.mktemp('packages'), definitions):
        yield


def check(formats, tmp_path):
    """Compare what a node publishes for messages with what a session returns."""
    values = {**SETTINGS, 'formats': formats}
    messages = [message for name in formats for message in MESSAGES[name]]
    offline = AdapterSession(parse_adapter(values), {}, lambda ids: None)
    expected = []
    for message in messages:
        offline.receive(message)
        expected += [
            publication for publication in offline.take()
            if publication[0] != 'r1/detection_markers']

    reliable = {
        f'qos_overrides./{topic}.subscription.reliability': 'reliable'
        for topic in offline.object_topics}
    settings = write_parameters(tmp_path / 'adapter.yaml', **values, **reliable)
    with live_helpers.Domain() as domain:
        adapter = domain.start('adapter', '--ros-args', '--params-file', settings)
        landmarks = domain.record('r1/landmarks', CLOUD)
        ids = domain.listen('landmark_ids', TEXT)
        # Until the subscriptions have discovered the publishers, messages are lost.
        for topic in offline.object_topics:
            first, before = next(m for m in messages if m.topic == topic), len(landmarks)
            while len(landmarks) == before:
                domain.send(first)
                domain.node.executor.spin_once(live_helpers.PAUSE)
        landmarks.clear()
        domain.send(*messages)
        sent = [live_helpers.on_the_wire(cdr(m)) for topic, m in expected
                if topic == 'r1/landmarks']
        # Messages on different topics may overtake each other.
        domain.until(lambda: not Counter(sent) - Counter(landmarks))
        status, errors = domain.finish(adapter, signal.SIGINT)

    assert (status, errors.count('Traceback')) == (0, 0)
    # Of those sent before, some may still have been on their way.
    assert {*landmarks} == {*sent}
    # New names are published once a second, and at the end.
    texts = [
        m.data for topic, m in [*expected, *offline.close()] if topic == 'landmark_ids']
    assert json.loads(ids[-1].data) == json.loads(texts[-1])


def test_live_landmarks_are_those_of_adapt(tmp_path):
    check(['marker_array'], tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures('packages')
def test_live_landmarks_of_other_packages_are_those_of_adapt(tmp_path):
    check(['apriltag', 'aruco', 'detection3d', 'landmark_list', 'range_bearing'], tmp_path)


@pytest.mark.usefixtures('domain')
def test_a_package_that_is_not_installed_is_named(tmp_path, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, 'cartographer_ros_msgs', None)
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['landmark_list'])

    status = run_verb('adapter', '--ros-args', '--params-file', settings)

    assert_one_sentence(
        (status, *capfd.readouterr()), 1, 'cartographer_ros_msgs/msg/LandmarkList',
        'ros-jazzy-cartographer-ros-msgs')
