# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Verbs in child processes that end with their test."""

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
from time import monotonic

#: Maximum time a test waits for an event [s], also on a busy machine.
DEADLINE = 120.0
#: Rows and columns of a terminal; progress bars do not show on one without any.
SIZE = (24, 100)


def until(condition, pause, deadline=DEADLINE):
    """Wait until a condition holds, with a pause before each check."""
    give_up = monotonic() + deadline
    while not condition():
        assert monotonic() < give_up, 'the condition did not become true in time'
        pause()


def start_verb(verb, *words, **options):
    """Start a verb as a process, with a session of its own that it leads."""
    return start(sys.executable, '-m', 'fej_slam_ros', verb, *words, **options)


def start(*words, **options):
    """Start a command as a process, with a session of its own that it leads."""
    # Where the tests run in the background SIGINT is ignored, and a process would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return subprocess.Popen(
        [*map(str, words)], start_new_session=True, text=True,
        **{'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, **options})


def end_session(process):
    """Kill a process and all processes of its session."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


class OnTerminal:
    """A verb as a process on a terminal, in a session of its own."""

    def __init__(self, verb, *words, stream='stdout'):
        self._screen, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack('HHHH', *SIZE, 0, 0))
        self._shown = b''
        self.process = start_verb(verb, *words, **{stream: slave})
        os.close(slave)

    def close(self):
        end_session(self.process)
        os.close(self._screen)

    def shown(self):
        """Return the text shown on the terminal so far."""
        with suppress(OSError):  # no process can write any more
            while select.select([self._screen], [], [], 0.0)[0]:
                self._shown += os.read(self._screen, 4096)
        return self._shown.decode()

    def members(self):
        """Return the IDs of the other processes of its session."""
        found = []
        for folder in Path('/proc').glob('[0-9]*'):
            with suppress(OSError):  # it has ended meanwhile
                if os.getsid(int(folder.name)) == self.process.pid != int(folder.name):
                    found.append(int(folder.name))
        return found

    def family(self):
        """Return the command lines of the other processes of its session."""
        lines = []
        for member in self.members():
            with suppress(OSError):
                lines.append(Path(f'/proc/{member}/cmdline').read_bytes().decode())
        return [line.split('\0') for line in lines]

    def runs(self, verb):
        """Return whether a verb runs in a process of its own."""
        return any(verb in words for words in self.family())

    def until(self, condition):
        """Wait until a condition holds."""
        until(condition, self._pause)

    def _pause(self):
        self.shown()  # an unread terminal would hold the process up
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(0.02)
