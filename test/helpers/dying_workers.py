# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tasks that kill their process, or fail in it; worker processes import them by name."""

from multiprocessing.connection import Connection
import os
import signal


def die_once(task):
    """Return a number; the first call with a file that does not exist kills the process."""
    number, file = task
    if file is not None and not file.exists():
        file.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def fail_twice(folder):
    """Return a number; the first two calls with a folder raise an exception."""
    attempts = len([*folder.iterdir()])
    (folder / str(attempts)).touch()
    if attempts < 2:
        raise ValueError('no luck')
    return attempts


def end_of_file(_):
    """Raise the exception that the pipe of a worker raises when its parent has ended."""
    raise EOFError('too short')


def die_while_answering():
    """Return a number, but kill the process in the middle of passing it on."""
    def send_half(self, buffer, write=os.write):
        write(self.fileno(), buffer[:len(buffer) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    Connection._send = send_half  # noqa: SLF001
    return 1


def die_at_2(number):
    """Return a number other than 2, which kills the process."""
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number
