# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Systematic errors of a team: of odometry, observations, and headings of ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from fej_slam_ros.core.calibration.errors_by_landmarks import fit_to_landmarks
from fej_slam_ros.core.calibration.observation_errors import fit_observations, given_observations
from fej_slam_ros.core.calibration.odometry_errors import fit_to_truth, given_odometry
from fej_slam_ros.core.calibration.shown_errors import ErrorEstimate, MIN_SIGMAS, suffice
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.calibration.true_motions import true_motions, TrueMotions
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Received, TruePose
from fej_slam_ros.core.settings import Settings

#: Maximum number of times that errors of headings and of odometry are fitted in turn, and the
#: change of the heading [rad] after which they are not.
MAX_ALIGNMENTS, MAX_CHANGE = 20, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class SystematicErrors:
    """Systematic errors by robot, of those with enough data."""

    odometry_by_truth: Mapping[str, ErrorEstimate] = field(default_factory=dict)
    odometry_by_landmarks: Mapping[str, ErrorEstimate] = field(default_factory=dict)
    observations_by_truth: Mapping[str, ErrorEstimate] = field(default_factory=dict)
    observations_by_landmarks: Mapping[str, ErrorEstimate] = field(default_factory=dict)
    #: (2,) arrays, positions of sensors ahead and to the left of the given ones [m]
    sensor_positions: Mapping[str, Array] = field(default_factory=dict)
    #: by which stamps of observations are too late [s]
    sensor_delays: Mapping[str, float] = field(default_factory=dict)
    #: of the headings of true poses, with their standard errors [rad]
    headings: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def with_error_of_ranges(self, robot: str) -> 'SystematicErrors':
        """Return errors in which a wrong scale of distances is one of ranges instead."""
        odometry = self.odometry_by_landmarks[robot]
        observations = self.observations_by_landmarks[robot]
        distance, *others = odometry.values
        (scale, bias), (_, sigma), (_, is_known) = (
            observations.values, observations.sigma, observations.is_known)
        observations = replace(
            observations, values=np.array([scale / distance, bias]),
            sigma=np.array([scale * odometry.sigma[0] / distance ** 2, sigma]),
            is_known=np.array([True, is_known]))
        odometry = replace(odometry, values=np.array([1.0, *others]))
        return replace(
            self, odometry_by_landmarks={**self.odometry_by_landmarks, robot: odometry},
            observations_by_landmarks={**self.observations_by_landmarks, robot: observations})

    def odometry(self) -> dict[str, ErrorEstimate]:
        """Return the errors of odometry from either source."""
        return {**self.odometry_by_truth, **self.odometry_by_landmarks}

    def observations(self) -> dict[str, ErrorEstimate]:
        """Return the errors of observations, by ground truth where they are known from both."""
        return {**self.observations_by_landmarks, **self.observations_by_truth}


def errors_by_truth(records: Sequence[Received], settings: Settings) -> SystematicErrors:
    """Return the errors that ground truth shows."""
    team = TeamRecords(records, settings)
    odometry, headings, heading_sigmas = {}, {}, {}
    for robot in settings.robots:
        motions = true_motions(team.odometry[robot.name], team.truth)
        if motions is not None:
            errors, heading, sigma = _with_heading_error(motions, given_odometry(robot))
            heading_sigmas[robot.name] = sigma
            if heading:
                headings[robot.name] = heading, sigma
            if suffice(motions.firsts):
                odometry[robot.name] = errors
    if headings:
        team = TeamRecords(with_corrected_headings(records, headings), settings)
    landmarks = team.truth.landmarks if settings.shared_landmark_ids else {}
    observations = {}
    for robot in settings.robots:
        of_observations = fit_observations(
            [*team.scans[robot.name], *team.robot_scans[robot.name]], landmarks, team.near,
            heading_sigmas.get(robot.name, math.inf), given_observations(robot))
        if of_observations is not None:
            observations[robot.name] = of_observations
    return SystematicErrors(
        odometry_by_truth=odometry, observations_by_truth=observations, headings=headings)


def _with_heading_error(
    motions: TrueMotions, given: Array
) -> tuple[ErrorEstimate, float, float]:
    """Return the errors of odometry, that of headings, 0 if not shown, and its sigma [rad]."""
    as_recorded = fit_to_truth(motions, given)
    errors, heading = as_recorded, 0.0
    for _ in range(MAX_ALIGNMENTS):
        change, sigma = motions.with_headings(heading).heading_error(errors.values)
        heading += change
        errors = fit_to_truth(motions.with_headings(heading), given)
        if abs(change) < MAX_CHANGE:
            break
    if abs(heading) > MIN_SIGMAS * sigma:
        return errors, heading, sigma
    return as_recorded, 0.0, sigma


def with_errors_by_landmarks(
    found: SystematicErrors, records: Sequence[Received], settings: Settings
) -> SystematicErrors:
    """Return errors with those of other robots, which landmarks show."""
    team = TeamRecords(records, settings)
    errors = {
        robot.name: fit_to_landmarks(team.odometry[robot.name], team.scans[robot.name], robot)
        for robot in settings.robots if robot.name not in found.odometry_by_truth}
    by_landmarks = {robot: fit for robot, fit in errors.items() if fit is not None}
    return replace(
        found,
        odometry_by_landmarks={robot: fit.odometry for robot, fit in by_landmarks.items()},
        observations_by_landmarks={
            robot: fit.observations for robot, fit in by_landmarks.items()},
        sensor_positions={
            robot: fit.position for robot, fit in by_landmarks.items() if fit.position.any()},
        sensor_delays={robot: fit.delay for robot, fit in by_landmarks.items() if fit.delay})


def with_corrected_headings(
    records: Sequence[Received], errors: Mapping[str, tuple[float, float]]
) -> list[Received]:
    """Return records in which true headings have no errors, given with their sigmas [rad]."""
    return [
        (replace(record, pose=record.pose - [0.0, 0.0, errors[record.robot][0]])
         if isinstance(record, TruePose) and record.robot in errors else record, received)
        for record, received in records]
