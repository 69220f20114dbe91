# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo runs two processes, prints a table, draws a figure and leaves no process behind."""

import os
import re
import signal

import pytest

from helpers.processes import DEADLINE, OnTerminal, start_verb
from helpers.ros import summary_of


pytestmark = pytest.mark.ros

PNG = b'\x89PNG\r\n\x1a\n'
#: Ways to interrupt: a signal, and whether the whole process group gets it, as with Ctrl-C.
WAYS = {
    'Ctrl-C': (signal.SIGINT, True), 'SIGINT': (signal.SIGINT, False),
    'SIGTERM': (signal.SIGTERM, False), 'SIGTERM to all': (signal.SIGTERM, True)}


@pytest.fixture
def demo(tmp_path):
    """Return a demo that has just been started."""
    demo = OnTerminal('demo', '--output', tmp_path / 'demo')
    yield demo
    demo.close()


def at_once(_demo):
    """Do not wait."""


def estimator_started(demo):
    demo.until(lambda: demo.runs('estimator'))


def both_started(demo):
    demo.until(lambda: demo.runs('estimator') and demo.runs('simulator'))


def running(demo):
    demo.until(lambda: re.search(r'\d of 63.0 s  r1 \(.*r2 \(', demo.shown()))


def simulator_ended(demo):
    running(demo)
    demo.until(lambda: not demo.runs('simulator'))


def estimator_ended(demo):
    simulator_ended(demo)
    demo.until(lambda: not demo.runs('estimator'))


def test_the_demo_runs_two_processes_and_ends_with_a_table_and_a_figure(demo, tmp_path):
    both_started(demo)
    running(demo)
    assert demo.runs('estimator')
    assert demo.runs('simulator')

    demo.until(lambda: demo.process.poll() is not None)

    assert demo.process.returncode == 0
    assert demo.process.stderr.read() == ''
    for word in ('r1', 'r2', 'RMSE', 'NEES/3', 'landmarks', 'used', 'rejected'):
        assert word in demo.shown()
    assert (tmp_path / 'demo' / 'scene.png').read_bytes().startswith(PNG)
    assert not demo.family()


@pytest.mark.slow
@pytest.mark.parametrize(('sensor', 'node'), [('laser', 'detector'), ('tags', 'adapter')])
def test_robots_of_unknown_start_join_by_what_their_sensors_see(tmp_path, sensor, node):
    demo = OnTerminal('demo', '--sensor', sensor, '--output', tmp_path / 'demo')
    demo.until(lambda: demo.runs(node))

    demo.until(lambda: demo.process.poll() is not None)

    assert demo.process.returncode == 0
    assert not summary_of(tmp_path / 'demo')['not_in_map']
    assert (tmp_path / 'demo' / 'scene.png').read_bytes().startswith(PNG)
    assert not demo.family()
    demo.close()


@pytest.mark.slow
@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize(
    'moment',
    [at_once, estimator_started, both_started, running, simulator_ended, estimator_ended])
def test_an_interrupted_demo_leaves_no_process_behind(demo, moment, way):
    moment(demo)

    number, to_all = WAYS[way]
    (os.killpg if to_all else os.kill)(demo.process.pid, number)
    demo.until(lambda: demo.process.poll() is not None)

    # A process that is still loading Python ends as Python does: by the signal, or with status 1.
    assert demo.process.returncode in ((0, 1, -number) if moment is at_once else (0,))
    assert not demo.family()


@pytest.mark.slow
def test_ctrl_c_ends_the_demo_with_a_sentence(demo):
    running(demo)

    os.killpg(demo.process.pid, signal.SIGINT)
    demo.until(lambda: demo.process.poll() is not None)

    assert demo.process.stderr.read() == (
        'interrupted: the nodes have ended, there are no results\n')


def test_an_earlier_demo_is_not_overwritten(tmp_path):
    (tmp_path / 'demo').mkdir()
    (tmp_path / 'demo' / 'scene.png').write_bytes(PNG)

    process = start_verb('demo', '--output', tmp_path / 'demo')
    _, errors = process.communicate(timeout=DEADLINE)

    assert process.returncode == 2
    assert '--force' in errors
    assert errors.count('\n') == 1


@pytest.mark.slow
def test_the_nodes_end_with_a_demo_that_was_killed(demo):
    both_started(demo)

    os.kill(demo.process.pid, signal.SIGKILL)

    demo.until(lambda: not demo.family())
