# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interface of an estimator or smoother to its input."""

from collections.abc import Mapping
from typing import Protocol

from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings


class Consumer(Protocol):
    """An estimator or smoother, or a collector of their records; it counts rejections."""

    statistics: InputStatistics

    @property
    def settings(self) -> CommonSettings:
        """Return the settings of the team."""

    @property
    def robots(self) -> Mapping[str, RobotSettings]:
        """Return the present team by name."""

    @property
    def needs_ids(self) -> bool:
        """Return whether observations without ID are rejected."""

    def add(self, record: Record, received: int | None = None) -> RejectionReason | None:
        """Insert a record; return the reason if it is rejected, None if it is accepted."""

    def used(self, robot: str) -> int:
        """Return the number of messages of a robot that were used."""
