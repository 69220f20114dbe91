# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A killed estimator continues from its checkpoint as if it had not been interrupted."""

import signal

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.processes import end_session, until
from helpers.ros import run_verb, summary_of, write_parameters
from helpers.slow import slow

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')
Parameter = optional('rclpy.parameter').Parameter

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROBOTS = ('r1', 'r2')
WORLD = {'loops': 2, 'steps_per_loop': 30, 'landmarks': 30, 'seed': 3}
#: No message is lost, and a busy machine ends no run.
LIVE = {
    'robots': ROBOTS, 'stale_after': 30.0, **live_helpers.reliable_inputs(ROBOTS)}


def poses_of_r1(bag):
    return [message.raw for message in bags.read(bag) if message.topic == 'r1/pose']


def start_estimator(domain, path, **values):
    """Start an estimator; return it and a list that fills with the poses of r1."""
    parameters = write_parameters(path, **LIVE, **values)
    estimator = domain.start('estimator', '--ros-args', '--params-file', parameters)
    poses = domain.record('r1/pose', live_helpers.POSE)
    domain.wait_for_reports()
    return estimator, poses


def is_part_of(poses, expected):
    """Return whether poses are consecutive ones of the expected poses."""
    start = expected.index(poses[0])
    return poses == expected[start:start + len(poses)]


@pytest.mark.parametrize(
    ('seed', 'moments'),
    [(3, [0.5])] + [
        slow(seed, [0.1, 0.3, 0.5, 0.7, 0.9]) for seed in (4, 5, 6)])
def test_an_estimator_killed_while_saving_and_restarted_ends_as_if_undisturbed(
    domain, tmp_path, seed, moments,
):
    bag, saved = tmp_path / 'bag', tmp_path / 'run.checkpoint'
    bags.write(bag, simulation.parse({**WORLD, 'seed': seed}).records())
    team = write_parameters(tmp_path / 'team.yaml', robots=ROBOTS)
    words = bag, '--params', team, '--output', tmp_path / 'replayed', '--bag'
    assert run_verb('replay', *words) == 0
    expected = poses_of_r1(tmp_path / 'replayed' / 'bag')
    supervised = {'checkpoint': str(saved), 'restore': str(saved), 'autosave_period': 0.01}

    for moment in moments:
        estimator, poses = start_estimator(domain, tmp_path / 'live.yaml', **supervised)
        player = domain.start('play', bag, '--rate', 10)
        pose = expected[round(moment * len(expected))]
        domain.until(lambda poses=poses, pose=pose: pose in poses)
        until(saved.with_name(f'{saved.name}.part').exists, lambda: None)
        end_session(estimator)
        end_session(player)
        assert is_part_of(poses, expected)

    estimator, poses = start_estimator(
        domain, tmp_path / 'last.yaml', **supervised, output=str(tmp_path / 'live'))
    assert domain.finish(domain.start('play', bag, '--rate', 10)) == (0, '')
    status, errors = domain.finish(estimator, signal.SIGINT)
    assert status == 0, errors
    domain.until(lambda: poses[-1:] == expected[-1:])

    assert 0 < len(poses) < len(expected)
    assert is_part_of(poses, expected)
    live, replayed = summary_of(tmp_path / 'live'), summary_of(tmp_path / 'replayed')
    assert live['state_hash'] == replayed['state_hash']
    assert live['counts']['duplicate'] > 0
    assert not live['depends_on_arrival']
    assert [live['robots'][name]['steps'] for name in ROBOTS] == [
        replayed['robots'][name]['steps'] for name in ROBOTS]


@pytest.mark.parametrize('node', ['estimator', 'smoother'])
def test_a_node_killed_after_its_team_changed_and_a_reset_comes_back_by_itself(
    domain, tmp_path, node,
):
    saved = str(tmp_path / 'run.checkpoint')
    team = write_parameters(
        tmp_path / 'team.yaml', robots=ROBOTS, checkpoint=saved, restore=saved)
    change = Parameter('robots', value=['r1', 'r2', 'r3']).to_parameter_msg()
    words = node, '--ros-args', '--params-file', team

    first = domain.start(*words)
    response = domain.ask(
        f'/{node}/set_parameters', services.SetParameters, parameters=[change])
    assert response.results[0].successful
    assert domain.call(f'/{node}/reset')
    assert domain.call(f'/{node}/save')
    end_session(first)
    again = domain.start(*words)
    topics = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    domain.until(lambda: any(
        status.name == f'{node}: r3' for report in topics for status in report.status))
    status, errors = domain.finish(again, signal.SIGINT)

    assert status == 0, errors
    assert "robots = ['r1', 'r2', 'r3'], not ['r1', 'r2']; to use the given ones" in errors


def test_a_failed_restore_exits_with_one_sentence(domain, tmp_path):
    parameters = write_parameters(
        tmp_path / 'team.yaml', robots=ROBOTS, restore=str(tmp_path / 'missing'))

    status, errors = domain.finish(
        domain.start('estimator', '--ros-args', '--params-file', parameters))

    assert status == 1
    assert f'cannot read the checkpoint {tmp_path / "missing"}: No such file' in errors
    assert 'Traceback' not in errors
