# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publication of maps and paths, which are many and large."""

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from fej_slam_ros.ros.nodes.topics import NodeTopics
from fej_slam_ros.ros.session.outputs import Outputs, Publication


class MapPublisher:
    """
    Publishes maps and paths one by one, so that no step waits for all of them.

    Parameters
    ----------
    is_overdue : whether the process is to end; all are published once more at the end

    """

    def __init__(self, topics: NodeTopics, is_overdue: Callable[[], bool]) -> None:
        self._topics = topics
        self._is_overdue = is_overdue
        self._pending: Iterator[Publication] = iter(())

    def renew(self, outputs: Outputs[Any]) -> None:
        """Let the present maps and paths wait; earlier ones are published completely first."""
        if not self.publish_next():
            self._pending = outputs.maps_and_paths()

    def publish_next(self) -> bool:
        """Publish one that waits; return whether there was any, and time for it."""
        return not self._is_overdue() and self._topics.publish(islice(self._pending, 1)) > 0

    def publish_all(self, outputs: Outputs[Any]) -> None:
        """Publish the present maps and paths at once."""
        self._topics.publish(outputs.maps_and_paths())

    def drop(self) -> None:
        """Drop those that wait, of a team or a run that has ended."""
        self._pending = iter(())
