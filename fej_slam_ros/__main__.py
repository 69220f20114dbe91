# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Entry points: ``python -m fej_slam_ros VERB``, ``fej_slam VERB`` and the executables.

Signals wait while the command line, which handles them, is imported.
"""

from importlib import import_module
import signal
import sys


def main() -> int:
    """Run ``fej_slam VERB ...`` and return the exit status."""
    return _call('main')


def executable() -> int:
    """Run the verb with the name of this executable and return the exit status."""
    return _call('executable')


def _call(function: str) -> int:
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
    # At the end of the process, Python's own handler would print a traceback.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    status: int = getattr(import_module('fej_slam_ros.cli.main'), function)()
    return status


if __name__ == '__main__':
    sys.exit(main())
