# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a load, and the results computed from its traffic."""

from collections import Counter

from fej_slam_ros.benchmark.latency import live_time, Traffic
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import deserialize, restamped, stamp_of
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

MS = 10**6
LOAD = Load(robots=3, odometry_rate=20, seconds=2)


def test_each_robot_sends_at_its_rates_and_no_two_at_once():
    messages = list(LOAD.messages())

    counts = Counter(message.topic for message in messages)
    assert counts == {
        f'r{k}/{kind}': n for k in (1, 2, 3) for kind, n in (('odom', 40), ('landmarks', 20))}
    odometry = [m.received for m in messages if m.topic.endswith('odom')]
    assert odometry == sorted(set(odometry))


def test_each_scan_has_as_many_observations_as_wanted():
    scans = [m for m in LOAD.messages() if m.topic.endswith('landmarks')]

    assert {deserialize(scan.raw, scan.type_name).width for scan in scans} == {10}


def test_an_estimator_with_the_parameters_uses_all_messages_in_one_map():
    run = EstimatorSession(parameters.parse(LOAD.parameters()), None)
    messages = list(LOAD.messages())
    for message in messages:
        run.receive(message)
    list(run.close())

    assert sum(map(run.estimator.used, run.estimator.robots)) == len(messages)
    assert run.estimator.groups.not_in_map == {}


def test_restamping_changes_the_stamp_only():
    message = next(LOAD.messages())

    changed = restamped(message.raw, 7_000_000_008)

    assert stamp_of(changed) == 7_000_000_008
    assert restamped(changed, message.received) == message.raw


def test_latency_counts_from_max_delay_after_sending_and_includes_the_wait():
    sent = {(robot, k * 50 * MS): (k * 50 + late) * MS
            for robot, late in (('a', 0), ('b', 3)) for k in range(10)}
    # Odometry of both has passed 0 + 100 ms with that of 150 ms, sent at 153 ms at the latest.
    traffic = Traffic(20, sent, {('a', 0): 160 * MS, ('b', 450 * MS): 900 * MS})

    time = live_time(Load(2, 20), traffic, max_delay=0.1)

    assert round(time.latency.longest, 9) == 0.060
    assert round(time.waited.longest, 9) == 0.053
