# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Systematic errors of a team: of odometry, observations, and headings of ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fej_slam_ros.core.calibration.observation_errors import fit_observations, RangeBearingErrors
from fej_slam_ros.core.calibration.odometry_errors import (
    fit_to_landmarks, fit_to_truth, MIN_SIGMAS, OdometryErrors)
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.calibration.true_motions import true_motions, TrueMotions
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.offline_matching import Received
from fej_slam_ros.core.ordering.corrected_observations import without_systematic_errors
from fej_slam_ros.core.records import TruePose
from fej_slam_ros.core.settings import RobotSettings, Settings

#: Maximum number of times that errors of headings and of odometry are fitted in turn, and the
#: change of the heading [rad] after which they are not.
MAX_ALIGNMENTS, MAX_CHANGE = 20, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class SystematicErrors:
    """Systematic errors by robot, of those with enough data."""

    by_truth: Mapping[str, OdometryErrors] = field(default_factory=dict)  #: of odometry
    by_landmarks: Mapping[str, OdometryErrors] = field(default_factory=dict)  #: of odometry
    #: of the headings of true poses, with their standard errors [rad]
    headings: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    observations: Mapping[str, RangeBearingErrors] = field(default_factory=dict)

    def with_error_of_ranges(self, robot: RobotSettings) -> 'SystematicErrors':
        """Return errors in which a wrong scale of distances is one of ranges instead."""
        odometry, (scale, bias) = self.by_landmarks[robot.name], _given_observations(robot)
        distance, *others = odometry.values
        ranges = RangeBearingErrors(
            np.array([scale / distance, bias]),
            np.array([scale * odometry.sigma[0] / distance ** 2, np.inf]),
            np.array([True, False]), False, odometry.pairs)
        odometry = replace(odometry, values=np.array([1.0, *others]))
        return replace(
            self, by_landmarks={**self.by_landmarks, robot.name: odometry},
            observations={**self.observations, robot.name: ranges})

    def odometry(self) -> dict[str, OdometryErrors]:
        """Return the errors of odometry from either source."""
        return {**self.by_truth, **self.by_landmarks}


def errors_by_truth(records: Sequence[Received], settings: Settings) -> SystematicErrors:
    """Return the errors that ground truth shows."""
    team = _team(records, settings)
    odometry, headings = {}, {}
    for robot in settings.robots:
        motions = true_motions(team.odometry[robot.name], team.truth)
        if motions is not None:
            odometry[robot.name], heading = _with_heading_error(motions, given_odometry(robot))
            if heading is not None:
                headings[robot.name] = heading
    team = _team(with_corrected_headings(records, headings), settings)
    landmarks = team.truth.landmarks if settings.shared_landmark_ids else {}
    observations = {}
    for robot in settings.robots:
        of_observations = fit_observations(
            [*team.scans[robot.name], *team.robot_scans[robot.name]], landmarks, team.near,
            headings.get(robot.name, (0.0, 0.0))[1], _given_observations(robot))
        if of_observations is not None:
            observations[robot.name] = of_observations
    return SystematicErrors(odometry, {}, headings, observations)


def _with_heading_error(
    motions: TrueMotions, given: Array
) -> tuple[OdometryErrors, tuple[float, float] | None]:
    """Return the errors of odometry, and of true headings with its sigma [rad] if it is shown."""
    as_recorded = fit_to_truth(motions, given)
    errors, heading = as_recorded, 0.0
    for _ in range(MAX_ALIGNMENTS):
        change, sigma = motions.with_headings(heading).heading_error(errors.values)
        heading += change
        errors = fit_to_truth(motions.with_headings(heading), given)
        if abs(change) < MAX_CHANGE:
            break
    if abs(heading) > MIN_SIGMAS * sigma:
        return errors, (heading, sigma)
    return as_recorded, None


def with_errors_by_landmarks(
    found: SystematicErrors, records: Sequence[Received], settings: Settings
) -> SystematicErrors:
    """Return errors with those of the odometry of other robots, which landmarks show."""
    team, by_landmarks = _team(records, settings), {}
    for robot in settings.robots:
        if robot.name not in found.by_truth:
            errors = fit_to_landmarks(team.odometry[robot.name], [
                without_systematic_errors(scan, robot) for scan in team.scans[robot.name]],
                given_odometry(robot))
            if errors is not None:
                by_landmarks[robot.name] = errors
    return replace(found, by_landmarks=by_landmarks)


def with_corrected_headings(
    records: Sequence[Received], errors: Mapping[str, tuple[float, float]]
) -> list[Received]:
    """Return records in which true headings have no errors, given with their sigmas [rad]."""
    return [
        (replace(record, pose=record.pose - [0.0, 0.0, errors[record.robot][0]])
         if isinstance(record, TruePose) and record.robot in errors else record, received)
        for record, received in records]


def _team(records: Sequence[Received], settings: Settings) -> TeamRecords:
    return TeamRecords(
        (record for record, _ in records), [robot.name for robot in settings.robots])


def given_odometry(robot: RobotSettings) -> Array:
    """Return the errors (3,) of odometry that the settings of a robot correct."""
    return np.array([*robot.odometry_scale, robot.odometry_turn_bias])


def _given_observations(robot: RobotSettings) -> Array:
    return np.array([robot.observation_range_scale, robot.observation_bearing_bias])
