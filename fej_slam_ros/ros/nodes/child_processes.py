# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own, on this machine only, which end with the one that started."""

import os
from pathlib import Path
import subprocess
import sys

from fej_slam_ros.errors import UserError

#: A process that does not end within so many seconds of being asked is killed.
PATIENCE = 10.0


def keep_to_this_machine() -> None:
    """Keep to a domain of our own on loopback, away from any robot on the network."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)


def check_alive(process: 'subprocess.Popen[bytes]', name: str) -> None:
    """Raise UserError where a process has ended."""
    if process.poll() is not None:
        raise UserError(f'the {name} ended early with status {process.returncode}')


class Processes:
    """Processes that end with this one, whatever happens."""

    def __init__(self) -> None:
        self._started: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> 'Processes':
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._started:
            process.terminate()
        for process in self._started:
            self._wait(process)

    def start(self, verb: str, parameters: Path) -> 'subprocess.Popen[bytes]':
        """Start a node with a parameter file."""
        command = [sys.executable, '-m', 'fej_slam_ros', verb, '--ros-args']
        options = ['--params-file', str(parameters), '--log-level', 'warn']
        self._started.append(subprocess.Popen([*command, *options]))
        return self._started[-1]

    def end(self, process: 'subprocess.Popen[bytes]') -> None:
        """Ask a process to end, and kill it if it does not."""
        process.terminate()
        self._wait(process)

    def _wait(self, process: 'subprocess.Popen[bytes]') -> None:
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
