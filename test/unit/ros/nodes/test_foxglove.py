# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foxglove receives the published messages unchanged, and numbers to plot."""

import mmap
from pathlib import Path
import signal
import subprocess
import sys

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros
from scipy.stats import chi2

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session.live_plots import PLOTTED
from helpers.optional import optional
from helpers.ros import header, meeting, meeting_truth, raw, raw_record

foxglove_client = optional('helpers.foxglove_client')
live_helpers = optional('helpers.live')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = [pytest.mark.ros, pytest.mark.needs('foxglove', 'websockets')]

TEAM = {'robots': ['r1', 'r2'], 'anchor_sigma': [0.1, 0.1, 0.1]}
POSE = '/r1/pose'
MAP = '/estimator/landmarks'


class Viewed:
    """A domain and a view of it in another process, which end with the test."""

    def __init__(self, domain):
        self.domain = domain
        self.process = domain.start('view', '--port', '0')
        self.url = self.process.stdout.readline().split()[-1]
        self._clients = []

    def client(self, *topics):
        """Return a client that wants topics, as soon as they are there."""
        client = foxglove_client.FoxgloveClient(self.url)
        self._clients.append(client)
        for topic in topics:
            self.domain.until(lambda topic=topic: client.sees(topic))
        client.subscribe(*topics)
        return client

    def publisher(self, topic, type_name, latched=False):
        return self.domain.node.create_publisher(
            live_helpers.message_class(type_name), topic, live_helpers.reliable(10, latched))

    def wait_until_wanted(self, publisher):
        self.domain.until(publisher.get_subscription_count)

    def connected(self, topic, type_name, *wanted):
        """Return a publisher and a client that wants topics, once that of the publisher is."""
        publisher, client = self.publisher(topic, type_name), self.client(*wanted)
        self.wait_until_wanted(publisher)
        return publisher, client

    def close(self):
        for client in self._clients:
            client.close()


@pytest.fixture
def viewed(domain):
    viewed = Viewed(domain)
    yield viewed
    viewed.close()


def pose_message(k=0):
    P = np.diag([0.5, 0.25, 0.125])
    estimate = PoseEstimate('r1', k, 'map', np.array([k, 2.0, 0.0]), P)
    return raw('', outgoing.pose(estimate, 0.0)).raw


def large_message():
    """Return two megabytes."""
    empty = ros.std_msgs__msg__MultiArrayLayout(dim=[], data_offset=0)
    return raw('', ros.std_msgs__msg__Float64MultiArray(layout=empty, data=np.zeros(2**18))).raw


def test_the_server_announces_itself_and_its_topics(viewed):
    viewed.publisher('r1/pose', live_helpers.POSE)

    client = viewed.client(POSE)

    assert (client.server_info['op'], client.server_info['name']) == ('serverInfo', 'fej_slam_ros')
    assert client.server_info['capabilities'] == ['time']
    channel = client.channels[POSE]
    assert (channel['encoding'], channel['schemaName'], channel['schemaEncoding']) == (
        'cdr', 'geometry_msgs/msg/PoseWithCovarianceStamped', 'ros2msg')


def test_a_pose_arrives_as_it_was_published(viewed):
    publisher, client = viewed.connected('r1/pose', live_helpers.POSE, POSE)

    publisher.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))
    pose, = client.decoded(POSE)
    assert (pose.header.stamp.nanosec, pose.header.frame_id) == (7, 'map')
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (7.0, 2.0)
    assert pose.pose.covariance[[0, 7, 35]].tolist() == [0.5, 0.25, 0.125]


def test_a_publisher_of_another_quality_of_service_replaces_the_first(viewed):
    first, client = viewed.connected('r1/pose', live_helpers.POSE, POSE)

    viewed.domain.node.destroy_publisher(first)
    second = viewed.domain.node.create_publisher(
        live_helpers.message_class(live_helpers.POSE), 'r1/pose', qos.best_effort(10))
    viewed.wait_until_wanted(second)
    second.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))


@pytest.mark.slow
def test_a_late_client_gets_the_map_although_others_are_connected(viewed):
    publisher = viewed.publisher(MAP, 'sensor_msgs/msg/PointCloud2', latched=True)
    cloud = outgoing.landmarks(5, 'map', [3], np.array([[1.0, 2.0]]), np.eye(2)[None])
    publisher.publish(raw('', cloud).raw)

    for _ in range(3):
        client = viewed.client(MAP)

        viewed.domain.until(lambda client=client: client.got(MAP))

        cloud, *_ = client.decoded(MAP)
        assert cloud.width == 1
        assert np.frombuffer(cloud.data.tobytes()[:8], np.float32).tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_topics_without_clients_are_not_subscribed(viewed):
    publisher, client = viewed.connected('r1/pose', live_helpers.POSE, POSE)

    client.close()

    viewed.domain.until(lambda: publisher.get_subscription_count() == 0)


@pytest.mark.slow
def test_a_client_that_disconnects_does_not_affect_others(viewed):
    publisher = viewed.publisher('r1/pose', live_helpers.POSE)
    goes, stays = viewed.client(POSE), viewed.client(POSE)
    viewed.wait_until_wanted(publisher)
    publisher.publish(pose_message(1))
    viewed.domain.until(lambda: goes.got(POSE) and stays.got(POSE))

    goes.close()
    publisher.publish(pose_message(2))

    viewed.domain.until(lambda: stays.got(POSE, 2))
    assert stays.decoded(POSE)[-1].header.stamp.nanosec == 2


@pytest.mark.slow
def test_a_client_that_reads_nothing_delays_no_other(viewed):
    topic = '/estimator/joint_covariance'
    publisher = viewed.publisher(topic, 'std_msgs/msg/Float64MultiArray')
    viewed.client(topic)  # is never read: what lies in buffers between is far below 40 MB
    reads = viewed.client(topic)
    viewed.wait_until_wanted(publisher)

    for count in range(1, 21):
        publisher.publish(large_message())

        viewed.domain.until(lambda count=count: reads.got(topic, count))


@pytest.mark.slow
def test_nis_and_nees_are_numbers_with_their_bands(viewed):
    viewed.domain.estimate(**TEAM)
    client = viewed.client('/view/consistency')

    viewed.domain.send(*map(raw_record, [*meeting_truth()[1:], *meeting()]))

    viewed.domain.until(lambda: client.got('/view/consistency') and 'nees' in str(
        client.decoded('/view/consistency')[-1]))
    r1, r2 = client.decoded('/view/consistency')[-1]['robots']
    assert (r1['name'], r2['name']) == ('r1', 'r2')
    assert set(r1) == {'name', *PLOTTED}
    np.testing.assert_allclose(
        (r1['nees_low'], r1['nees_high']), chi2.ppf([0.025, 0.975], 3) / 3.0, rtol=1e-9)
    # Landmarks and robots are seen without an error here.
    assert 0.0 <= r1['nis'] < 1e-3 < r1['nis_low'] < 1.0 < r1['nis_high']


@pytest.mark.slow
def test_frames_that_have_not_joined_are_drawn_at_the_origin(viewed):
    viewed.domain.estimate(**TEAM)

    client = viewed.client('/view/frames')

    viewed.domain.until(lambda: client.got('/view/frames'))
    transforms = client.decoded('/view/frames')[-1].transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in transforms] == [
        ('map', 'r1/map'), ('map', 'r2/map')]


def test_diagnostics_of_other_nodes_are_passed_on_only(viewed):
    publisher, client = viewed.connected(
        '/diagnostics', live_helpers.DIAGNOSTICS, '/diagnostics', '/view/consistency')
    status = ros.diagnostic_msgs__msg__DiagnosticStatus(
        level=0, name='motor', message='warm', hardware_id='m1', values=[])

    publisher.publish(raw('', ros.diagnostic_msgs__msg__DiagnosticArray(
        header=header(0, ''), status=[status])).raw)

    viewed.domain.until(lambda: client.got('/diagnostics'))
    assert client.decoded('/diagnostics')[0].status[0].message == 'warm'
    assert not client.got('/view/consistency')


def diagnostics_of(*statuses, stamp=0):
    """Return the bytes of a report of statuses with name, hardware ID and values."""
    return raw('', outgoing.diagnostics(stamp, [
        outgoing.diagnostic_status(name, 0, '', values, hardware)
        for name, hardware, values in statuses])).raw


def test_nis_and_nees_are_plotted_at_the_stamps_of_their_reports(viewed):
    # After the end of a simulation an estimator goes on to report at its last simulated time.
    stamps = [64_000_000_000, 65_000_000_000, -1_000_000_000]
    publisher, client = viewed.connected(
        '/diagnostics', live_helpers.DIAGNOSTICS, '/view/consistency')

    for stamp in stamps:
        publisher.publish(diagnostics_of(
            ('estimator: r1', 'r1', {'sightings_used': 5}), stamp=stamp))

    viewed.domain.until(lambda: client.got('/view/consistency', len(stamps)))
    # Foxglove has no negative time.
    assert [at for at, _ in client.received['/view/consistency']] == [*stamps[:2], 0]


def test_whatever_diagnostics_contain_poses_are_passed_on(viewed):
    publisher = viewed.publisher('/diagnostics', live_helpers.DIAGNOSTICS)
    poses = viewed.publisher('r1/pose', live_helpers.POSE)
    client = viewed.client('/diagnostics', '/view/consistency', POSE)
    viewed.wait_until_wanted(publisher)
    viewed.wait_until_wanted(poses)
    whole = diagnostics_of(('estimator: r1', 'r1', {'sightings_used': 5, 'nis_band': '1..2'}))
    reports = [
        whole, whole[:-7], whole[:9], whole[:4] + b'\xff' * 40,
        diagnostics_of(('estimator: r1', 'r1', {
            'sightings_used': 'x', 'nis_band': 'nan..inf', 'nees_latest': 'nan'})),
        diagnostics_of(('estimator: ' + 'r' * 100_000, 'r' * 100_000, {'sightings_used': 1}))]

    for report in reports:
        publisher.publish(report)
    viewed.domain.until(lambda: client.got('/diagnostics', len(reports)))
    poses.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))
    robots = [r for content in client.decoded('/view/consistency') for r in content['robots']]
    assert {key for robot in robots for key in robot} == {'name'}


def test_topics_of_others_do_not_replace_those_of_the_view(viewed):
    stranger = viewed.publisher('/view/consistency', live_helpers.POSE)
    poses, client = viewed.connected('r1/pose', live_helpers.POSE, POSE, '/view/consistency')

    poses.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))
    assert client.channels['/view/consistency']['encoding'] == 'json'
    assert stranger.get_subscription_count() == 0


@pytest.mark.slow
def test_clients_that_send_garbage_do_not_affect_others(viewed):
    publisher, client = viewed.connected('r1/pose', live_helpers.POSE, POSE)

    foxglove_client.send_garbage(viewed.url, client.channels[POSE]['id'], seed=1)
    publisher.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))


@pytest.mark.slow
def test_a_client_that_reads_nothing_takes_bounded_memory(viewed):
    topic = '/estimator/joint_covariance'
    publisher = viewed.publisher(topic, 'std_msgs/msg/Float64MultiArray')
    viewed.client(topic)  # is never read
    reads = viewed.client(topic)
    viewed.wait_until_wanted(publisher)

    sizes = []
    for count in range(1, 401):
        publisher.publish(large_message())
        viewed.domain.until(lambda count=count: reads.got(topic, count))
        reads.received[topic] = [b''] * count
        sizes.append(resident_mb(viewed.process.pid))

    # 256 messages of 2.1 MB wait.
    assert max(sizes[-50:]) < sizes[0] + 256 * 2.1 + 100
    assert max(sizes[-50:]) < max(sizes[300:350]) + 20


def resident_mb(pid):
    """Return the resident memory [MB] of a process."""
    return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * mmap.PAGESIZE / 1e6


@pytest.mark.slow
def test_messages_that_are_too_large_are_not_passed_on(viewed):
    topic = '/estimator/joint_covariance'
    publisher, client = viewed.connected(topic, 'std_msgs/msg/Float64MultiArray', topic)

    for number in 2**20, 2:
        empty = ros.std_msgs__msg__MultiArrayLayout(dim=[], data_offset=0)
        publisher.publish(raw('', ros.std_msgs__msg__Float64MultiArray(
            layout=empty, data=np.zeros(number))).raw)

    viewed.domain.until(lambda: client.got(topic))
    assert [len(message.data) for message in client.decoded(topic)] == [2]


@pytest.mark.slow
def test_negative_simulated_time_ends_nothing(viewed):
    clock = viewed.publisher('/clock', 'rosgraph_msgs/msg/Clock')
    poses = viewed.publisher('r1/pose', live_helpers.POSE)
    client = viewed.client(POSE)
    viewed.wait_until_wanted(clock)
    viewed.wait_until_wanted(poses)

    clock.publish(raw('', outgoing.clock(-1_500_000_000)).raw)
    poses.publish(pose_message(7))

    viewed.domain.until(lambda: client.got(POSE))


def test_simulated_time_is_used_if_published(viewed):
    clock, client = viewed.connected('/clock', 'rosgraph_msgs/msg/Clock')

    clock.publish(raw('', outgoing.clock(1_500_000_000)).raw)

    def has_simulated_time():
        client.got('/view/consistency', 0)
        return client.times[-1:] == [1_500_000_000]

    client.received['/view/consistency'] = []
    viewed.domain.until(has_simulated_time)


def test_the_time_of_the_machine_is_used_again_once_nobody_publishes_simulated_time(viewed):
    clock, client = viewed.connected('/clock', 'rosgraph_msgs/msg/Clock')
    clock.publish(raw('', outgoing.clock(1_500_000_000)).raw)
    client.received['/view/consistency'] = []

    def sent(is_last):
        client.got('/view/consistency', 0)
        return bool(client.times) and is_last(client.times[-1])

    viewed.domain.until(lambda: sent(lambda time: time == 1_500_000_000))
    viewed.domain.node.destroy_publisher(clock)

    # That of the machine is decades later.
    viewed.domain.until(lambda: sent(lambda time: time > 10**18))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_server_cleanly(viewed, number):
    viewed.client()

    assert viewed.domain.finish(viewed.process, number) == (0, '')


@pytest.mark.slow
def test_a_port_in_use_is_an_error(viewed):
    port = viewed.url.rpartition(':')[2]

    status, errors = viewed.domain.finish(viewed.domain.start('view', '--port', port))

    assert status == 1
    assert f' view: cannot serve at 127.0.0.1, port {port} (' in errors
    assert errors.count('\n') == 1


@pytest.mark.parametrize('port', ['-1', '65536', 'http'])
def test_an_invalid_port_is_a_usage_error(domain, port):
    status, errors = domain.finish(domain.start('view', f'--port={port}'))

    assert status == 2
    assert errors.endswith(f' view: --port: {port} is not an integer from 0 to 65535\n')


def test_without_the_extra_one_sentence_says_what_to_install():
    without = (
        "import sys; sys.modules['foxglove'] = None; sys.argv = ['fej_slam', 'view']\n"
        'from fej_slam_ros.cli.main import main; sys.exit(main())')

    process = subprocess.run(
        [sys.executable, '-c', without], capture_output=True, text=True, check=False)

    assert process.returncode == 1
    assert process.stderr.startswith('fej_slam view: the Python module foxglove is missing')
    assert 'foxglove]' in process.stderr
    assert process.stderr.count('\n') == 1
