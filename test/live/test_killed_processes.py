# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that is killed stops no other one, and what it leaves behind hinders no start."""

from pathlib import Path
import re
import signal

import pytest

from fej_slam_ros.ros.doctor import shared_memory
from helpers.optional import optional
from helpers.paths import BAGS
from helpers.ros import write_parameters

live_helpers = optional('helpers.live')

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.needs('foxglove')]

ROBOTS = ['r1', 'r2']


@pytest.fixture
def parameters(tmp_path):
    """Return the files with the parameters of the nodes, and of a world that goes on for long."""
    return {
        'simulator': write_parameters(
            tmp_path / 'world.yaml', robots=ROBOTS, loops=100, steps_per_loop=63),
        'node': write_parameters(tmp_path / 'node.yaml', robots=ROBOTS)}


def start(domain, parameters, verb):
    """Start a verb; a viewer listens on any free port."""
    if verb == 'view':
        return domain.start('view', '--port', '0')
    if verb == 'play':
        return domain.start('play', BAGS / 'rendezvous', '--no-wait')
    file = parameters['simulator' if verb == 'simulator' else 'node']
    return domain.start(verb, '--ros-args', '--params-file', file)


def wait_for_more(domain, messages):
    """Wait for messages that are not yet on their way."""
    before = len(messages)
    domain.until(lambda: len(messages) > before + 10)


def memory_of(process):
    """Return the names of the segments that a process has open."""
    maps = Path(f'/proc/{process.pid}/maps').read_text()
    return set(re.findall(r'/(fastrtps_[0-9a-f]{16})$', maps, re.MULTILINE))


def test_the_others_go_on_and_the_next_start_is_clean(domain, parameters):
    running = {verb: start(domain, parameters, verb) for verb in ('simulator', 'estimator')}
    poses = domain.record('r1/pose', live_helpers.POSE)
    wait_for_more(domain, poses)

    for victim in 'smoother', 'view', 'play', 'simulator', 'estimator':
        running.setdefault(victim, start(domain, parameters, victim))
        wait_for_more(domain, poses)
        status, errors = domain.finish(running[victim], signal.SIGKILL)
        assert (status, 'Traceback' in errors) == (-signal.SIGKILL, False)
        running[victim] = start(domain, parameters, victim)
        wait_for_more(domain, poses)

    for verb in 'smoother', 'view', 'simulator', 'estimator':
        status, errors = domain.finish(running[verb], signal.SIGINT)
        assert (verb, status) == (verb, 0)
        assert 'Traceback' not in errors


def test_memory_of_a_killed_node_is_stale_and_can_be_deleted_while_others_run(domain, parameters):
    survivor = start(domain, parameters, 'simulator')
    killed = start(domain, parameters, 'estimator')
    poses = domain.record('r1/pose', live_helpers.POSE)
    wait_for_more(domain, poses)
    memory = memory_of(killed)
    domain.finish(killed, signal.SIGKILL)

    left = [
        segment for segment in shared_memory.survey()
        if segment.is_stale and segment.name in memory]
    for segment in left:
        shared_memory.delete(segment)
    restarted = start(domain, parameters, 'estimator')

    wait_for_more(domain, poses)
    assert left
    assert not any(path.exists() for segment in left for path in segment.files)
    assert [domain.finish(node, signal.SIGINT)[0] for node in (survivor, restarted)] == [0, 0]
