# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults in diagnostics: a level and one sentence."""

from enum import IntEnum
from typing import NamedTuple


class Level(IntEnum):
    """Levels of a status, as in ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Fault(NamedTuple):
    """A condition of an input, an estimate or a node."""

    level: Level
    message: str  #: sentence for users
