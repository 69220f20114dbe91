# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoother of observations without ID, by the landmarks that an estimator has matched them to."""

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.matches import Matches
from fej_slam_ros.core.records import NO_ID, Record, Scan
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import SmootherSettings


class MatchedTeamSmoother(TeamSmoother):
    """A smoother of observations without ID, by their matches; those without are rejected."""

    needs_ids = False

    def __init__(self, settings: SmootherSettings, matches: Matches, solve_every: int) -> None:
        super().__init__(settings, solve_every)
        self._matches = matches

    def add(self, record: Record, received: int | None = None) -> RejectionReason | None:
        """Add a record as `TeamSmoother` does, with IDs for its observations."""
        if not isinstance(record, Scan):
            return super().add(record, received)
        scan = self._matches.with_ids(record)
        for _ in range(len(record.observations) - len(scan.observations)):
            self.statistics.reject(Rejection(
                record.robot, record.stamp, RejectionReason.NO_IDENTITY, id=NO_ID))
        if record.observations and not scan.observations:
            # As where IDs are needed, it is no step.
            self.statistics.count_fully_rejected_scan(record.robot)
            return None
        return super().add(scan, received)
