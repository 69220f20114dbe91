# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the log of a run."""

from collections import Counter
from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

#: Number of times that a line is repeated in full.
MAX_REPEATS = 5


class LogSeverity(Enum):
    """Severities of log lines."""

    DEBUG = 'debug'
    INFO = 'info'
    WARN = 'warn'
    ERROR = 'error'


class LogLine(NamedTuple):
    """One line of the log."""

    severity: LogSeverity  #: its severity
    text: str  #: sentence for users


class RepeatableLines:
    """Lines that a sender may cause as often as it likes."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def lines(self, severity: LogSeverity, text: str, cause: str = '') -> Iterator[LogLine]:
        """
        Yield the line the first few times, then the tenth, the hundredth and so on.

        Lines of one cause, of which there are few, are counted together whatever their numbers.

        """
        self._counts[cause or text] += 1
        count = self._counts[cause or text]
        if count <= MAX_REPEATS:
            yield LogLine(severity, text)
        elif str(count).strip('0') == '1':
            yield LogLine(severity, f'{text} ({count} times)')
