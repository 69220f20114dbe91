# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log of a run on the logger of a node."""

from collections import defaultdict
from collections.abc import Iterable

from rclpy.impl.rcutils_logger import RcutilsLogger

from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity


def write(logger: RcutilsLogger, lines: Iterable[LogLine]) -> None:
    """Write lines; rclpy requires a statement of its own for each severity."""
    for severity, text in lines:
        if severity is LogSeverity.DEBUG:
            logger.debug(text)
        elif severity is LogSeverity.INFO:
            logger.info(text)
        elif severity is LogSeverity.WARN:
            logger.warning(text)
        else:
            logger.error(text)


def grouped(topics: Iterable[str]) -> str:
    """Return full topic names in short, those of one namespace together."""
    by_parent = defaultdict(list)
    for topic in topics:
        parent, _, leaf = topic.rpartition('/')
        by_parent[parent].append(leaf)
    return ', '.join(
        f'{parent}/{leaves[0]}' if len(leaves) == 1 else f'{parent}/{{{",".join(leaves)}}}'
        for parent, leaves in by_parent.items())
