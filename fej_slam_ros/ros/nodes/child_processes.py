# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Child processes that run nodes on this machine, and end with their parent."""

import os
from pathlib import Path
import subprocess
import sys

from fej_slam_ros.errors import UserError

#: Time [s] for a child process to end after SIGTERM; it is killed after that. Writing the files of
#: a long run takes a few seconds.
TERMINATION_TIMEOUT = 10.0

#: Runs a verb that ends with this process, even if this is killed.
RUN_VERB = 'from fej_slam_ros.child_process import run_verb; run_verb()'

Process = subprocess.Popen[bytes]


def keep_to_this_machine() -> None:
    """Use a separate ROS domain on loopback, so that robots on the network are not disturbed."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)


def check_alive(process: Process, name: str) -> None:
    """Raise UserError if a process has ended."""
    if process.poll() is not None:
        raise UserError(f'the {name} ended early with status {process.returncode}')


class ChildProcesses:
    """Child processes that end with the context, for any reason."""

    def __init__(self) -> None:
        self._started: list[Process] = []

    def __enter__(self) -> 'ChildProcesses':
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._started:
            process.terminate()
        for process in self._started:
            _wait(process)

    def start(self, verb: str, parameters: Path) -> Process:
        """Start the node of a verb with a parameter file."""
        self._started.append(subprocess.Popen([
            sys.executable, '-c', RUN_VERB, str(os.getpid()), verb, '--ros-args', '--params-file',
            str(parameters), '--log-level', 'warn']))
        return self._started[-1]

    def end(self, process: Process) -> None:
        """Terminate a process, and kill it if that fails."""
        process.terminate()
        _wait(process)


def _wait(process: Process) -> None:
    """Wait until a terminated process has ended; kill it if that takes too long."""
    try:
        process.wait(TERMINATION_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
