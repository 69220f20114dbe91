# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Signals: status and files of processes that are interrupted once, twice or by SIGTERM."""

import json
from pathlib import Path
import signal
from time import sleep

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.paths import BAGS
from helpers.processes import end_session, start_verb, until
from helpers.ros import meeting, raw_record, write_parameters
from helpers.slow import slow

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')

pytestmark = pytest.mark.ros

BOTH = pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
#: A world whose bag takes seconds to write and to replay.
WORLD = {'loops': 5, 'landmarks': 60}
TEAM = {'robots': ['r1', 'r2']}


def left_in(folder):
    """Return the names of all files in a folder, hidden ones too."""
    return {path.name for path in folder.rglob('*')}


def pause():
    sleep(0.005)


def interrupted(process, is_at_work, *numbers):
    """Send signals to a process at work; return its status and its errors."""
    try:
        until(lambda: process.poll() is not None or is_at_work(), pause)
        assert process.poll() is None
        for number in numbers:
            process.send_signal(number)
        _, errors = process.communicate()
    finally:
        end_session(process)
    return process.returncode, errors


@BOTH
def test_an_interrupted_simulate_leaves_no_partial_bag(tmp_path, number):
    given = write_parameters(tmp_path / 'world.yaml', 'simulator', **WORLD | {'loops': 50})
    process = start_verb('simulate', '--params', given, '--output', tmp_path / 'out' / 'bag')

    status, errors = interrupted(
        process, (tmp_path / 'out' / '.bag.partial').exists, number)

    assert (status, errors) == (130, '')
    assert not left_in(tmp_path / 'out')


@pytest.mark.slow
@pytest.mark.parametrize('numbers', [
    [signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGTERM],
    [signal.SIGTERM, signal.SIGINT, signal.SIGINT]])
@pytest.mark.parametrize('verb', ['replay', 'smooth'])
def test_an_interrupted_replay_leaves_neither_part_files_nor_a_partial_bag(
    tmp_path, verb, numbers,
):
    bags.write(tmp_path / 'bag', simulation.parse(WORLD).records())
    given = write_parameters(tmp_path / 'team.yaml', **TEAM)
    out = tmp_path / 'out'
    process = start_verb(
        verb, tmp_path / 'bag', '--params', given, '--output', out, '--bag')

    status, errors = interrupted(
        process, lambda: {'trajectory_r1.csv.part', '.bag.partial'} <= left_in(out), *numbers)

    assert (status, errors) == (130, '')
    assert not left_in(out)


@pytest.mark.slow
@pytest.mark.parametrize('numbers', [
    [signal.SIGINT, signal.SIGTERM],
    [signal.SIGTERM, signal.SIGTERM, signal.SIGINT],
    [signal.SIGINT, signal.SIGINT]])
def test_a_second_signal_loses_no_file_of_a_node(domain, tmp_path, numbers):
    given = write_parameters(
        tmp_path / 'team.yaml', **TEAM, output=str(tmp_path / 'run'), stale_after=60.0,
        **live_helpers.reliable_inputs(TEAM['robots']))
    estimator = domain.start('estimator', '--ros-args', '--params-file', given)
    poses = domain.listen('r1/pose', live_helpers.POSE)
    domain.until(lambda: domain.node.count_publishers('/r1/pose'))
    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: len(poses) >= 4)

    for number in numbers:
        estimator.send_signal(number)
    status, errors = domain.finish(estimator)

    assert status == 0, errors
    rows = (tmp_path / 'run' / 'trajectory_r1.csv').read_text().splitlines()[1:]
    assert len(rows) == 6
    assert json.loads((tmp_path / 'run' / 'summary.json').read_text())['state_hash']
    assert not [name for name in left_in(tmp_path / 'run') if name.endswith('.part')]


@pytest.mark.parametrize('number', [signal.SIGINT, slow(signal.SIGTERM)])
def test_play_answers_parameter_services_until_a_signal_ends_it_with_status_0(domain, number):
    playing = domain.start('play', BAGS / 'two_circles', '--rate', 1e-3, '--no-wait')

    listed = domain.ask('/play/list_parameters', services.ListParameters)

    assert 'use_sim_time' in listed.result.names
    assert domain.finish(playing, number) == (0, '')


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize('verb', ['estimator', 'simulator', 'smoother'])
def test_a_node_that_is_interrupted_while_it_starts_ends_with_status_0(domain, verb, number):
    process = domain.start(verb, '--ros-args', '-p', 'robots:=[r1, r2]')

    # It loads modules for a second; numpy is among the first.
    domain.until(lambda: 'numpy' in mapped(process))

    assert domain.finish(process, number)[0] == 0


def mapped(process):
    """Return the libraries that a process has loaded."""
    return Path(f'/proc/{process.pid}/maps').read_text(encoding='utf-8')
