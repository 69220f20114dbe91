# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Observations in a row that failed the gate, of robots with few landmarks in view.

A scan of one landmark does not show whether the pose of its robot or the landmark is wrong. The
latest observations together do, those by the robot and those of it by others: if all of them
failed, and they relate it to several landmarks and robots, its pose is wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import (
    Association, CONTRADICTION_D2, MIN_CONTRADICTIONS, MIN_KNOWN, StatisticsByRobot)
from fej_slam_ros.core.ekf.state import Landmark, Robot
from fej_slam_ros.core.records import LandmarkKey

#: Minimum number of observations, and of landmarks and robots to which they relate a robot, that
#: show that its pose is a few standard deviations off.
MIN_REJECTIONS, MIN_OTHERS = 3, 2
#: Expected squared distance of an observation.
EXPECTED_D2 = 2.0


@dataclass(slots=True)
class RejectedInARow:
    """The latest observations by and of a robot, all of which failed the gate."""

    begin: int  #: stamp of the first [ns]
    #: the latest squared distances by the other robot or the landmark, at most nine each
    d2: dict[str | LandmarkKey, list[float]] = field(default_factory=dict)

    def add(self, other: str | LandmarkKey, d2: float) -> None:
        """Add a further observation."""
        self.d2[other] = [*self.d2.get(other, []), d2][-MIN_CONTRADICTIONS:]

    def explained(self) -> list[float]:
        """Return the distances if a pose that is a few standard deviations off explains enough."""
        explained = [
            [x for x in of_other if x <= CONTRADICTION_D2] for of_other in self.d2.values()]
        d2 = [*chain.from_iterable(explained)]
        is_enough = len(d2) >= MIN_REJECTIONS and sum(map(bool, explained)) >= MIN_OTHERS
        return d2 if is_enough else []

    def count(self) -> int:
        """Return the number of observations."""
        return sum(map(len, self.d2.values()))


class ConsecutiveRejections:
    """The latest observations of each robot, until one passes the gate."""

    def __init__(self) -> None:
        self._rows: dict[str, RejectedInARow] = {}

    def add(self, innovation: Innovation, statistics: StatisticsByRobot) -> None:
        """
        Add the observations of an update, with its `scan_gate_statistics`.

        Scans that are large enough to check a pose are left to the detection of lost robots.

        """
        for association in innovation.used if self._rows else ():
            for robot, other in pairs(association):
                if not self._has_started(robot, other):
                    self.forget(robot.name)
        for gated in innovation.rejected:
            for robot, other in pairs(gated.association):
                is_alone = isinstance(other, Robot) or not statistics[robot.name].can_clear()
                if is_alone and not gated.passed():
                    row = self._rows.setdefault(robot.name, RejectedInARow(robot.stamp))
                    row.add(_key(other), gated.least_d2())

    def factor(self, robot: str) -> float:
        """Return the factor on the covariance of a robot that explains its row, 1 without."""
        d2 = self._rows[robot].explained() if robot in self._rows else []
        return float(np.mean(d2)) / EXPECTED_D2 if d2 else 1.0

    def count(self, robot: str) -> int:
        """Return the number of observations in a row that show a wrong pose, 0 if none do."""
        row = self._rows.get(robot)
        if row is None:
            return 0
        is_lost = len(row.d2) >= MIN_KNOWN and row.count() >= MIN_CONTRADICTIONS
        return row.count() if is_lost or row.explained() else 0

    def forget(self, robot: str) -> None:
        """End the row of a robot."""
        self._rows.pop(robot, None)

    def _has_started(self, robot: Robot, other: Robot | Landmark) -> bool:
        """Return whether a robot has started a landmark in its row, which fits its wrong pose."""
        row = self._rows.get(robot.name)
        return row is not None and isinstance(other, Landmark) and (
            other.owner == robot.name and other.created >= row.begin)


def pairs(association: Association) -> Iterator[tuple[Robot, Robot | Landmark]]:
    """Yield each robot of an observation, with what the observation relates it to."""
    observer, observed, _ = association
    yield observer, observed
    if isinstance(observed, Robot):
        yield observed, observer


def _key(other: Robot | Landmark) -> str | LandmarkKey:
    return other.name if isinstance(other, Robot) else other.key
