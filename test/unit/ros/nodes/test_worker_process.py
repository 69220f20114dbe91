# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A worker process does one task after the other; its end is detected."""

from contextlib import closing
import math
import os
import subprocess
import sys
import time

import pytest

from helpers.optional import optional
from helpers.processes import until

worker = optional('fej_slam_ros.ros.nodes.worker_process')

pytestmark = pytest.mark.ros

#: In an interpreter of its own, whose first worker it is: that starts a tracker of resources, too.
INTERRUPTED = """
import signal
from fej_slam_ros.ros.nodes.worker_process import Worker
doing = Worker(signal.raise_signal)
while not doing.is_ready:
    doing.result()
doing.begin(signal.SIGINT)
while not doing.is_ready:
    doing.result()
doing.close()
"""


def done(doing):
    """Return the result of what a worker does, when it has come."""
    found = []
    until(lambda: found or found.extend(filter(None, [doing.result()])), pause)
    return found[0]


def ready(doing):
    until(lambda: doing.result() is not None or doing.is_ready, pause)


def pause():
    time.sleep(0.01)  # between two looks at what another process does


def test_a_task_is_done_in_another_process():
    with closing(worker.Worker(math.factorial)) as doing:
        ready(doing)
        for n, expected in (5, 120), (6, 720):
            doing.begin(n)
            assert not doing.is_ready
            assert done(doing) == expected
            assert doing.is_ready


def test_a_process_that_ended_is_detected():
    with closing(worker.Worker(os._exit)) as doing:
        ready(doing)
        doing.begin(3)
        with pytest.raises(EOFError):
            done(doing)


def test_a_computing_process_ends_on_close():
    doing = worker.Worker(time.sleep)
    ready(doing)
    doing.begin(1000.0)

    doing.close()  # waits for its end


def test_ctrl_c_does_not_reach_the_first_worker_either():
    subprocess.run([sys.executable, '-c', INTERRUPTED], check=True, timeout=60)
