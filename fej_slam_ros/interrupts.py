# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM: the first ends the work, the second skips waits, a third SIGINT kills."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import signal

#: Signals that ask a process to end.
INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
#: Number of the SIGINT that ends the process without completing its files. SIGTERM never does:
#: supervisors send it after SIGINT, and SIGKILL if that does not help.
KILLING_SIGINT = 3

#: Calls that wait for the end of each `postponed` context that has begun.
_waiting: list[list[Callable[[], object]]] = []


@contextmanager
def handled(
    first: Callable[[], object], second: Callable[[], object] = lambda: None,
    numbers: Iterable[signal.Signals] = INTERRUPTS,
) -> Iterator[None]:
    """
    Call `first` at the first of the signals and `second` at each later one.

    After a signal, the signals stay ignored when the context ends, so that another one cannot
    change the exit status of the process, which is about to end.

    """
    received: list[int] = []

    def handle(number: int, _frame: object) -> None:
        received.append(number)
        if received.count(signal.SIGINT) >= KILLING_SIGINT:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.raise_signal(signal.SIGINT)
        else:
            _call_or_postpone(second if len(received) > 1 else first)

    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is handle:
                signal.signal(number, signal.SIG_IGN if received else handler)


@contextmanager
def postponed() -> Iterator[None]:
    """Defer signals to the end of a context, so that handlers know the files it creates."""
    # A mask of signals would not do: it holds for one thread, and another one gets the signal.
    _waiting.append([])
    try:
        yield
    finally:
        calls = _waiting.pop()
        for call in calls:
            _call_or_postpone(call)


def _call_or_postpone(call: Callable[[], object]) -> None:
    if _waiting:
        _waiting[-1].append(call)
    else:
        call()
