# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The front end of SLAM, live or from a bag: observations of landmarks from data of sensors."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Protocol

from fej_slam_ros.ros.messages import outgoing, RawMessage
from fej_slam_ros.ros.session.input_faults import Level
from fej_slam_ros.ros.session.outputs import IsWanted, Publication
from fej_slam_ros.ros.topic_types import DIAGNOSTICS_TOPIC

#: A robot, a warning or '', and the counts of its input and output.
RobotCounts = tuple[str, str, dict[str, int]]


class FrontEnd(Protocol):
    """A front end of some robots: messages in, messages out."""

    @property
    def robots(self) -> Collection[str]:
        """Return the names of the robots."""

    @property
    def topics(self) -> Mapping[str, str]:
        """Return the types of the topics that are read, by topic."""

    @property
    def outputs(self) -> Mapping[str, str]:
        """Return the types of the topics that are published, by topic."""

    def receive(self, arrived: RawMessage) -> None:
        """Add a message, or count its rejection."""

    def take(self, is_wanted: IsWanted = lambda _: True) -> Iterator[Publication]:
        """Yield what is to be published now; markers are left out where they are not wanted."""

    def close(self) -> Iterator[Publication]:
        """Yield what is to be published at the end of the input."""

    def counts(self) -> Iterator[RobotCounts]:
        """Yield each robot, a warning or '', and the counts of its input and output."""


def report(node: str, counts: Iterable[RobotCounts], stamp: int) -> Publication:
    """Return the diagnostics of the front end of a node by its counts, at a time [ns]."""
    statuses = [
        outgoing.diagnostic_status(
            f'{node}: {name}', Level.WARN if warning else Level.OK, warning or 'detecting',
            values, name)
        for name, warning, values in counts]
    return DIAGNOSTICS_TOPIC, outgoing.diagnostics(stamp, statuses)
