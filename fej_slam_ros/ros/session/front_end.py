# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The front end of SLAM, live or from a bag: observations of landmarks from data of sensors."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence

from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages import outgoing, RawMessage
from fej_slam_ros.ros.session.faults import Level
from fej_slam_ros.ros.session.outputs import IsWanted, Publication
from fej_slam_ros.ros.topic_types import DIAGNOSTICS_TOPIC

#: Number of reports, one a second, over which warnings look back.
RECENT_REPORTS = 5
#: A robot, its warnings, and the counts of its input and output.
RobotCounts = tuple[str, Sequence[str], dict[str, int]]


class FrontEnd(ABC):
    """
    A front end of some robots: messages in, messages out.

    Attributes
    ----------
    robots : the robots by name
    topics : types of the topics that are read, by topic
    outputs : types of the topics that are published, by topic

    """

    robots: Mapping[str, RobotSettings]
    topics: Mapping[str, str]
    outputs: Mapping[str, str]

    @abstractmethod
    def receive(self, arrived: RawMessage) -> None:
        """Add a message, or count its rejection."""

    @abstractmethod
    def take(self, is_wanted: IsWanted = lambda _: True) -> Iterator[Publication]:
        """Yield what is to be published now; markers are left out where they are not wanted."""

    @abstractmethod
    def close(self) -> Iterator[Publication]:
        """Yield what is to be published at the end of the input, and reject what still waits."""

    @abstractmethod
    def counts(self) -> Iterator[RobotCounts]:
        """
        Yield each robot, its warnings, and the counts of its input and output.

        It is called once for each report; the warnings are of the time since the latest ones.

        """


def report(node: str, counts: Iterable[RobotCounts], stamp: int) -> Publication:
    """Return the diagnostics of the front end of a node by its counts, at a time [ns]."""
    statuses = [
        outgoing.diagnostic_status(
            f'{node}: {name}', Level.WARN if warnings else Level.OK,
            '; '.join(warnings) or 'detecting', values, name)
        for name, warnings, values in counts]
    return DIAGNOSTICS_TOPIC, outgoing.diagnostics(stamp, statuses)
