# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first signal ends the work, further ones hurry it, and only the third SIGINT kills."""

from contextlib import ExitStack, suppress
import signal
from signal import raise_signal, SIGINT, SIGTERM
import subprocess
import sys

import pytest

from fej_slam_ros.interrupts import handled, INTERRUPTS, postponed


pytestmark = pytest.mark.usefixtures('same_signals')


@pytest.mark.parametrize('numbers', [
    [SIGINT], [SIGTERM], [SIGINT, SIGTERM], [SIGINT, SIGINT, SIGTERM], [SIGTERM] * 5])
def test_the_first_signal_is_told_from_the_later_ones(numbers):
    calls = []

    with handled(lambda: calls.append('first'), lambda: calls.append('second')):
        for number in numbers:
            raise_signal(number)

    assert calls == ['first', *['second'] * (len(numbers) - 1)]


@pytest.mark.parametrize(('numbers', 'status'), [
    ([SIGINT] * 3, -SIGINT), ([SIGTERM, SIGINT, SIGTERM, SIGINT, SIGINT], -SIGINT),
    ([SIGINT, SIGINT, SIGTERM, SIGTERM], 0)])
def test_only_the_third_sigint_kills(numbers, status):
    script = (
        'import signal\n'
        'from fej_slam_ros.interrupts import handled\n'
        'with handled(bool):\n'
        f'    for number in {[*map(int, numbers)]}:\n'
        '        signal.raise_signal(number)\n')

    assert subprocess.run([sys.executable, '-c', script], check=False).returncode == status


def test_without_a_signal_the_handlers_are_restored():
    before = [signal.getsignal(number) for number in INTERRUPTS]

    with handled(bool):
        assert [signal.getsignal(number) for number in INTERRUPTS] != before

    assert [signal.getsignal(number) for number in INTERRUPTS] == before


def test_after_a_signal_further_ones_are_ignored_while_the_process_ends():
    with handled(bool):
        with handled(bool):
            raise_signal(SIGTERM)
        raise_signal(SIGINT)

    raise_signal(SIGINT)
    raise_signal(SIGTERM)


def test_a_signal_waits_until_the_end_of_the_outermost_context_that_postpones_it():
    calls = []

    with handled(lambda: calls.append('first'), lambda: calls.append('second')):
        with postponed():
            begin_and_end_another(SIGTERM)
            raise_signal(SIGINT)
            assert not calls
        assert calls == ['first', 'second']


def begin_and_end_another(number):
    """Postpone and send a signal."""
    with postponed():
        raise_signal(number)


def test_an_exception_of_a_postponed_signal_passes_through_what_was_entered_before():
    left = []

    def interrupt():
        raise KeyboardInterrupt

    with suppress(KeyboardInterrupt), handled(interrupt), ExitStack() as stack, postponed():
        raise_signal(SIGINT)
        stack.callback(left.append, 'deleted')

    assert left == ['deleted']
