# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log lines of topics of which all messages are rejected."""

from collections.abc import Callable, Iterable, Iterator

from fej_slam_ros.ros.session.input_faults import reasons_in_words
from fej_slam_ros.ros.session.input_health import InputHealth
from fej_slam_ros.ros.session.inputs import MEASUREMENT_TOPICS
from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity


class RejectedTopics:
    """The topics of which all messages are rejected."""

    def __init__(self) -> None:
        self._topics: set[str] = set()

    def lines(
        self, health: InputHealth, robots: Iterable[str], now: int,
        topic_name: Callable[[str], str],
    ) -> Iterator[LogLine]:
        """Yield a line for each topic that has become one of them, or is one no longer."""
        for robot in robots:
            for kind in MEASUREMENT_TOPICS:
                flow, topic = health.flow(robot, kind), f'{robot}/{kind}'
                is_rejected = flow.are_all_rejected(now) and not flow.is_sent_again()
                if is_rejected and topic not in self._topics:
                    self._topics.add(topic)
                    yield LogLine(LogSeverity.WARN, (
                        f'all messages on {topic_name(topic)} are rejected:'
                        f' {reasons_in_words(flow.rejected_in_a_row)}'))
                elif topic in self._topics and not flow.rejected_in_a_row:
                    self._topics.remove(topic)
                    yield LogLine(
                        LogSeverity.INFO, f'messages on {topic_name(topic)} are accepted again')
