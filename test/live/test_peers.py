# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothers in processes without a central node: over DDS, bad links and restarts."""

import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from time import monotonic

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
import helpers
from helpers.network import HOSTS
from helpers.optional import optional
from helpers.paths import BAGS
from helpers.processes import end_session, start
from helpers.radio import central, is_measurement, poses_in_frame_of, team_settings
from helpers.ros import (
    csv_rows, meeting, raw_record, run_verb, summary_of, write_parameters)

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')
Parameter = optional('rclpy.parameter').Parameter

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RENDEZVOUS = BAGS / 'rendezvous'
COUNTER = Path(helpers.__file__).with_name('frame_counter.py')


def peer_parameters(folder, name, other, **values):
    """Write the parameters of a smoother that exchanges measurements with one other."""
    return write_parameters(
        folder / f'{name}.yaml', robots=[name], peers=[other], shared_landmark_ids=False,
        output=str(folder / name), stale_after=30.0, **live_helpers.reliable_inputs([name]),
        **values)


def smoothed(folder):
    """Return the state hash and the poses of the central smoother."""
    parameters = write_parameters(
        folder / 'central.yaml', robots=['p', 'q'], shared_landmark_ids=False)
    words = RENDEZVOUS, '--params', parameters, '--output', folder / 'central'
    assert run_verb('smooth', *words) == 0
    return summary_of(folder / 'central')['state_hash'], poses(folder / 'central')


def poses(folder):
    """Return stamp and pose of each robot in the files of a run."""
    return {
        name: np.array([
            [float(row[column]) for column in ('stamp_ns', 'x', 'y', 'yaw')]
            for row in csv_rows(folder / f'trajectory_{name}.csv')])
        for name in 'pq'}


def play_and_end(domain, smoothers):
    """Play the rendezvous until q is in map, and end the smoothers."""
    base_nodes = domain.listen('q/base_node', live_helpers.POSE)
    assert domain.finish(domain.start('play', RENDEZVOUS, '--rate', 4)) == (0, '')
    domain.until(lambda: 'map' in {message.header.frame_id for message in base_nodes})
    for smoother in smoothers:
        status, errors = domain.finish(smoother, signal.SIGINT)
        assert status == 0, errors


def test_each_robot_ends_with_the_central_result(domain, tmp_path):
    expected_hash, expected = smoothed(tmp_path)
    smoothers = [
        domain.start('smoother', '--ros-args', '--params-file', peer_parameters(
            tmp_path, name, other, exchange_file=str(tmp_path / f'{name}.exchange')))
        for name, other in ('pq', 'qp')]
    play_and_end(domain, smoothers)

    # Both make the same bits where they have the same anchor.
    assert summary_of(tmp_path / 'p')['state_hash'] == expected_hash
    of_p = poses(tmp_path / 'p')
    for name in 'pq':
        assert_allclose(of_p[name], expected[name], rtol=0.0, atol=1e-9)
    alignment = json.loads((tmp_path / 'q' / 'alignment.json').read_text())
    assert alignment['maps'][0]['robots'] == ['q', 'p']


def test_the_anchor_of_a_smoother_may_be_another_robot(domain, tmp_path):
    smoother = domain.start('smoother', '--ros-args', '--params-file', peer_parameters(
        tmp_path, 'q', 'p', anchor='p'))

    domain.until(
        lambda: smoother.poll() is not None or domain.node.count_subscribers('/q/odom'))

    assert smoother.poll() is None
    assert domain.finish(smoother, signal.SIGINT)[0] == 0


def test_a_robot_becomes_a_peer_of_a_running_smoother(domain, tmp_path):
    expected_hash, _ = smoothed(tmp_path)
    smoothers = [
        domain.start(
            'smoother', '--ros-args', '--params-file', peer_parameters(tmp_path, *names), '-r',
            f'__node:=smoother_of_{names[0]}') for names in ('pz', 'qp')]
    for value, is_right in (['z', 'a'], False), (['q'], True):
        message = Parameter('peers', value=value).to_parameter_msg()
        result, = domain.ask(
            '/smoother_of_p/set_parameters', services.SetParameters, parameters=[message]).results
        assert result.successful is is_right, result.reason
    play_and_end(domain, smoothers)

    summary = summary_of(tmp_path / 'p')
    assert summary['state_hash'] == expected_hash
    assert summary['config']['peers'] == ['q']


def test_a_smoother_that_is_killed_and_restarted_ends_with_the_central_result(domain, tmp_path):
    _, expected = smoothed(tmp_path)
    path = str(tmp_path / 'p.exchange')
    parameters = peer_parameters(tmp_path, 'p', 'q', exchange_file=path)
    first = domain.start('smoother', '--ros-args', '--params-file', parameters)
    other = domain.start(
        'smoother', '--ros-args', '--params-file', peer_parameters(tmp_path, 'q', 'p'))
    published = domain.listen('p/pose', live_helpers.POSE)
    player = domain.start('play', RENDEZVOUS, '--rate', 2)
    # p drives for 12 s, and is killed; what it measures until its restart is lost.
    domain.until(lambda: len({message.header.stamp.sec for message in published}) > 12)
    end_session(first)
    killed = max(message.header.stamp.sec for message in published)
    published.clear()
    second = domain.start('smoother', '--ros-args', '--params-file', parameters)
    domain.until(lambda: published)
    domain.finish(player)
    for smoother in (other, second):
        status, errors = domain.finish(smoother, signal.SIGINT)
        assert status == 0, errors
    # It takes long after hours.
    assert re.search(rf'processing [0-9.]+ MB of measurements in {path}', errors)

    of_p = poses(tmp_path / 'p')['p']
    assert of_p[0, 0] == expected['p'][0, 0]
    # What was measured more than a second before is not lost.
    limit = (killed - 1) * 1e9
    assert np.sum(of_p[:, 0] < limit) == np.sum(expected['p'][:, 0] < limit)


def test_the_last_steps_of_a_robot_are_released_and_solved_although_hellos_go_on(
    domain, tmp_path
):
    smoother = domain.start(
        'smoother', '--ros-args', '--params-file',
        write_parameters(
            tmp_path / 'r1.yaml', robots=['r1'], peers=['r2'],
            **live_helpers.reliable_inputs(['r1'])))
    published = domain.listen('r1/pose', live_helpers.POSE)
    reports = domain.wait_for_reports()
    records = [record for record in meeting(20) if getattr(record, 'robot', '') == 'r1']
    domain.send(*map(raw_record, records))

    # The last step waits for later odometry otherwise, and a solution for 50 poses.
    domain.until(lambda: len(published) == 20)
    domain.until(lambda: any(
        value.key == 'solve_time_s' and float(value.value) > 0.0
        for status in reports[-1].status for value in status.values))
    values = {value.key: value.value for s in reports[-1].status for value in s.values}
    assert int(values['exchange_messages']) > 0
    assert domain.finish(smoother, signal.SIGINT)[0] == 0


def robot_bag(folder, name, records):
    """Write a bag of what one robot measures."""
    bags.write(
        folder / f'{name}.bag', [record for record in records if record.robot == name],
        robot_ids={'p': 1, 'q': 2})
    return folder / f'{name}.bag'


@pytest.mark.timeout(300)
@pytest.mark.parametrize('experiment', ['map_joining', 'sensor_extension'])
def test_over_a_bad_link_near_the_rendezvous_each_robot_has_the_central_result(
    domain, network, tmp_path, experiment
):
    environment = RENDEZVOUS_ENVIRONMENTS[experiment]
    records = [*filter(is_measurement, environment.records(np.random.default_rng(7)))]
    last = max(window.last for window in environment.world.windows) * 0.5
    # Out of reach: what a radio sends is lost, but its interface is there.
    network.lose(1.0)
    counters = [
        start(*network.on(host), sys.executable, COUNTER, 'cable', 'FEJ', stdin=subprocess.PIPE)
        for host in HOSTS]
    smoothers, players = [], []
    for host, (name, other) in zip(HOSTS, ('pq', 'qp')):
        words = peer_parameters(
            tmp_path, name, other, exchange_file=str(tmp_path / f'{name}.exchange'))
        smoothers.append(domain.ending(on_host(
            network, host, 'smoother', '--ros-args', '--params-file', words)))
        players.append(domain.ending(on_host(
            network, host, 'play', robot_bag(tmp_path, name, records), '--rate', 2)))
    begin = min(window.first for window in environment.world.windows) * 0.5
    wait(domain, 5.0 + begin / 2)
    network.lose(0.2)
    wait(domain, 15.0 + (last - begin) / 2)
    network.lose(1.0)
    for player in players:
        domain.finish(player)
    for smoother in smoothers:
        status, errors = domain.finish(smoother, signal.SIGINT)
        assert status == 0, errors

    for name, other in ('pq', 'qp'):
        values = summary_of(tmp_path / name)
        assert values['robots'][other]['frame'] == 'map', values
        compare_with_central(tmp_path, name, records)
    # Both logs in both files, a quarter more for what was lost, as much for headers and hellos.
    logs = (tmp_path / 'p.exchange').stat().st_size
    assert sum(exchange_bytes(counter) for counter in counters) < 2.0 * logs


def compare_with_central(folder, name, records):
    """Compare the files of a robot with the central smoother of what it knows."""
    known = {robot: values[:, 0].max() for robot, values in poses(folder / name).items()}
    settings = team_settings(['p', 'q'], name, shared=False)
    team = central([r for r in records if r.stamp <= known[r.robot]], settings)
    expected, found = poses_in_frame_of(team, name), poses(folder / name)
    for robot in 'pq':
        assert_allclose(found[robot][:, 1:], expected[robot], rtol=0.0, atol=1e-9)


def exchange_bytes(counter):
    """Return the number of bytes of frames with messages of the exchange that a host has sent."""
    output, _ = counter.communicate()
    return int(output.split()[0])


def on_host(network, host, verb, *words):
    """Start a verb on a host of the network."""
    environment = os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}
    return start(
        *network.on(host), sys.executable, '-m', 'fej_slam_ros', verb, *words, env=environment)


def wait(domain, seconds):
    """Wait for a time in which the link is as it is."""
    end = monotonic() + seconds
    domain.until(lambda: monotonic() > end)
