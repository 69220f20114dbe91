# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo runs two processes, shows what came of it, and leaves none behind."""

import os
from pathlib import Path
import signal

import pytest

live_helpers = pytest.importorskip('live_helpers', reason='rclpy is not installed')

pytestmark = pytest.mark.ros

PNG = b'\x89PNG\r\n\x1a\n'


def family(process):
    """Return the verbs that run in the session of a process, itself left out."""
    verbs = {}
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            words = (folder / 'cmdline').read_bytes().decode().split('\0')
            session = os.getsid(int(folder.name))
        except (OSError, ProcessLookupError):
            continue
        if session == process.pid and int(folder.name) != process.pid and 'fej_slam_ros' in words:
            verbs[words[words.index('fej_slam_ros') + 1]] = int(folder.name)
    return verbs


@pytest.fixture
def demo(tmp_path):
    """Return a demo that has just been started, in a session of its own."""
    process = live_helpers.start_verb('demo', '--output', tmp_path / 'demo')
    yield process
    live_helpers.end_session(process)


def test_the_demo_is_two_processes_and_ends_with_a_table_and_a_picture(demo, tmp_path):
    live_helpers.until(lambda: set(family(demo)) == {'estimator', 'simulator'}, lambda: None)

    told, errors = demo.communicate(timeout=live_helpers.DEADLINE)

    assert (demo.returncode, errors) == (0, '')
    for word in ('r1', 'r2', 'RMSE', 'NEES/3', 'landmarks', 'used', 'refused'):
        assert word in told
    assert (tmp_path / 'demo' / 'scene.png').read_bytes().startswith(PNG)
    assert not family(demo)


@pytest.mark.parametrize('signal_', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('wanted', [set(), {'estimator'}, {'estimator', 'simulator'}])
@pytest.mark.parametrize('to_all', [True, False])
def test_an_interrupted_demo_leaves_no_process_behind(demo, wanted, signal_, to_all):
    live_helpers.until(lambda: wanted <= set(family(demo)), lambda: None)

    if to_all:
        os.killpg(demo.pid, signal_)
    else:
        demo.send_signal(signal_)
    demo.communicate(timeout=live_helpers.DEADLINE)

    assert demo.returncode != 0
    assert not family(demo)


def test_an_interruption_in_the_middle_of_the_run_leaves_no_process_behind(demo):
    live_helpers.until(lambda: 'simulator' in family(demo), lambda: None)
    # The simulated world takes 8 s; both processes have begun to work after one.
    demo_time = live_helpers.monotonic() + 3.0
    live_helpers.until(lambda: live_helpers.monotonic() > demo_time, lambda: None)

    os.killpg(demo.pid, signal.SIGINT)
    demo.communicate(timeout=live_helpers.DEADLINE)

    assert demo.returncode == 130
    assert not family(demo)


def test_an_earlier_demo_is_not_overwritten(tmp_path):
    (tmp_path / 'demo').mkdir()
    (tmp_path / 'demo' / 'scene.png').write_bytes(PNG)

    process = live_helpers.start_verb('demo', '--output', tmp_path / 'demo')
    _, errors = process.communicate(timeout=live_helpers.DEADLINE)

    assert process.returncode == 2
    assert '--force' in errors
    assert errors.count('\n') == 1
