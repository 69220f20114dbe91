# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the log of a run."""

from enum import Enum
from typing import NamedTuple


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
