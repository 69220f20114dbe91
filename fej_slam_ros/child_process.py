# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Child processes: their end with their parent, how they ended, their processor time."""

from contextlib import suppress
import ctypes
import multiprocessing
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import runpy
import signal
import sys
from threading import Thread
from typing import cast

#: Option of prctl(2): the signal that a process gets when its parent ends.
PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """End this worker if its parent ends without ending it, even during a computation."""
    def wait() -> None:
        cast(BaseProcess, multiprocessing.parent_process()).join()
        os._exit(1)

    Thread(target=wait, daemon=True).start()


def run_verb() -> None:
    """Run a verb, given after the ID of the parent, which gets SIGTERM if that is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    parent = int(sys.argv.pop(1))
    # Before the call it may have been killed already.
    if os.getppid() == parent:
        runpy.run_module('fej_slam_ros', run_name='__main__', alter_sys=True)


def described_exit(status: int | None) -> str:
    """Return how a process ended, from its exit status; negative are signals."""
    if status == -signal.SIGKILL:
        return 'was killed (SIGKILL), as by a system without memory'
    if status is not None and status < 0:
        with suppress(ValueError):
            return f'was ended by {signal.Signals(-status).name}'
    return f'ended with status {status}'


def processor_time(pid: int) -> float:
    """Return the processor time [s] that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
