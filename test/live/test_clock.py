# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time over DDS, and bags that are played twice."""

import signal

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.ros import odometry_message, raw, run_verb, summary_of, write_parameters
from helpers.slow import slow

live_helpers = optional('helpers.live')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROBOTS = ('r1', 'r2')
#: 12 s, a step every 200 ms.
WORLD = {'loops': 2, 'steps_per_loop': 30, 'landmarks': 30, 'seed': 3}
#: No message is lost, and a busy machine ends no run.
LIVE = {
    'robots': ROBOTS, 'stale_after': 5.0, **live_helpers.reliable_inputs(ROBOTS)}


@pytest.fixture(scope='module')
def replayed(tmp_path_factory):
    """Return a bag and the summary of its replay."""
    folder = tmp_path_factory.mktemp('clock')
    bags.write(folder / 'bag', simulation.parse(WORLD).records())
    team = write_parameters(folder / 'team.yaml', robots=ROBOTS)
    words = folder / 'bag', '--params', team, '--output', folder / 'replayed'
    assert run_verb('replay', *words) == 0
    return folder / 'bag', summary_of(folder / 'replayed')


def play_to(domain, folder, bag, times, *play_options, **values):
    """Play a bag several times to an estimator; return its diagnostics."""
    parameters = write_parameters(
        folder / 'live.yaml', **LIVE, output=str(folder / 'live'), **values)
    estimator = domain.start('estimator', '--ros-args', '--params-file', parameters)
    reports = domain.wait_for_reports()
    for _ in range(times):
        assert domain.finish(domain.start('play', bag, '--rate', 6, *play_options)) == (0, '')
    status, errors = domain.finish(estimator, signal.SIGINT)
    assert status == 0, errors
    return reports


def of_robot(reports, robot):
    """Return message and values of the status of a robot in each report."""
    statuses = [s for report in reports for s in report.status if s.name.endswith(f' {robot}')]
    return [(s.message, {v.key: v.value for v in s.values}) for s in statuses]


def test_with_simulated_time_no_clock_offset_is_reported(domain, tmp_path, replayed):
    bag, expected = replayed

    reports = play_to(domain, tmp_path, bag, 1, '--clock', use_sim_time=True)

    summary = summary_of(tmp_path / 'live')
    assert summary['state_hash'] == expected['state_hash']
    assert summary['counts']['future'] == 0
    statuses = [(m, v) for m, v in of_robot(reports, 'r1') if v['received'] != '0']
    assert statuses
    assert not any('clock of reception' in message for message, _ in statuses)
    # The clock ticks every 25 ms, 0.15 s of simulated time, so messages can be ahead of it.
    assert all(abs(float(values['delay_s'])) < 1.0 for _, values in statuses)


def test_nothing_that_arrives_during_a_stall_is_ahead_of_simulated_time(domain, tmp_path):
    """The node works only while the test waits: for 10 s of simulated time it takes no message."""
    folder = tmp_path / 'live'
    node = domain.estimate(robots=['r1'], use_sim_time=True, output=str(folder))
    odometry = [raw('r1/odom', odometry_message(ms=ms)) for ms in range(1000, 11_001, 100)]
    domain.send(raw('/clock', outgoing.clock(10**9)), *odometry[:1])
    domain.until(lambda: node.received == 1)

    for message, ms in zip(odometry[1:], range(1100, 11_001, 100), strict=True):
        # The executor is to meet an odometry message before the clock.
        domain.send(message, raw('/clock', outgoing.clock(ms * 10**6)))
    domain.until(lambda: node.received == len(odometry))
    domain.end_estimate()

    counts = summary_of(folder)['counts']
    assert counts['future'] == 0
    assert counts['used'] == len(odometry)


def test_a_bag_played_again_is_rejected(domain, tmp_path, replayed):
    bag, expected = replayed

    play_to(domain, tmp_path, bag, 2, '--clock', use_sim_time=True)

    summary = summary_of(tmp_path / 'live')
    assert summary['state_hash'] == expected['state_hash']
    assert summary['counts']['used'] == expected['counts']['used']
    assert summary['counts']['after_time_jump'] == expected['counts']['used']
    assert not summary['depends_on_arrival']


@pytest.mark.parametrize('clock', [True, slow(False)])
def test_a_bag_played_again_starts_a_new_run_where_that_is_set(domain, tmp_path, replayed, clock):
    bag, expected = replayed
    options = ['--clock'] if clock else []

    play_to(domain, tmp_path, bag, 2, *options, use_sim_time=clock, on_time_jump='reset')

    for folder in ('live', 'live_2'):
        summary = summary_of(tmp_path / folder)
        assert summary['state_hash'] == expected['state_hash']
        assert summary['counts'] == expected['counts']
        assert summary['rmse'] == expected['rmse']


def test_simulated_time_that_stands_still_is_a_warning(domain, tmp_path):
    parameters = write_parameters(tmp_path / 'team.yaml', robots=ROBOTS, use_sim_time=True)
    domain.start('estimator', '--ros-args', '--params-file', parameters)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    clock = domain.node.create_publisher(
        live_helpers.message_class('rosgraph_msgs/msg/Clock'), '/clock', 10)

    def is_reported(text):
        statuses = [s for r in reports[-1:] for s in r.status if s.name.endswith('filter')]
        return any(text in status.message for status in statuses)

    domain.until(lambda: is_reported('waiting for /clock: use_sim_time is set'))
    domain.until(clock.get_subscription_count)
    clock.publish(raw('', outgoing.clock(5 * 10**9)).raw)

    domain.until(lambda: is_reported('simulated time has stood still for'))


def test_simulated_time_out_of_range_is_ignored(domain, tmp_path):
    parameters = write_parameters(tmp_path / 'team.yaml', robots=ROBOTS, use_sim_time=True)
    estimator = domain.start('estimator', '--ros-args', '--params-file', parameters)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    clock = domain.node.create_publisher(
        live_helpers.message_class('rosgraph_msgs/msg/Clock'), '/clock', 10)
    domain.until(lambda: reports and clock.get_subscription_count())

    too_large = outgoing.clock(5 * 10**9)
    too_large.clock.nanosec = 1_500_000_000
    for time in outgoing.clock(5 * 10**9), outgoing.clock(-5 * 10**9), too_large:
        clock.publish(raw('', time).raw)
    clock.publish(raw('', outgoing.clock(6 * 10**9)).raw)
    domain.until(lambda: reports[-1].header.stamp.sec == 6)

    assert domain.finish(estimator, signal.SIGINT)[0] == 0
