# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The end of worker processes: with their parent, and described."""

from contextlib import suppress
import multiprocessing
from multiprocessing.process import BaseProcess
import os
import signal
from threading import Thread
from typing import cast


def end_with_parent() -> None:
    """End this worker if its parent ends without ending it, even during a computation."""
    def wait() -> None:
        cast(BaseProcess, multiprocessing.parent_process()).join()
        os._exit(1)

    Thread(target=wait, daemon=True).start()


def described_exit(status: int | None) -> str:
    """Return how a process ended, from its exit status; negative are signals."""
    if status == -signal.SIGKILL:
        return 'was killed (SIGKILL), as by a system without memory'
    if status is not None and status < 0:
        with suppress(ValueError):
            return f'was ended by {signal.Signals(-status).name}'
    return f'ended with status {status}'
