# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors against ground truth, normalised by the stated noise.

Errors are those over a window: of odometry, of the relative pose; of observations, the sum of the
errors with which a robot observes one landmark or robot. Errors of wheels, gyros and detectors
persist for longer than a message, so that single ones would give too small a noise scale.

A landmark whose true position is not recorded is where it is observed on average from true poses.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, compress, pairwise
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.calibration.scales_of_errors import Errors, inliers
from fej_slam_ros.core.calibration.team_records import NearTruth, TeamRecords
from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.definiteness import is_definite
from fej_slam_ros.core.geometry import Array, between, pose_difference, rotation, transform
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.corrected_observations import without_observation_errors
from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, Record, RobotScan, Scan)
from fej_slam_ros.core.settings import NoiseSettings, Settings

#: Degrees of freedom of an error by kind of noise, as in the parameters ``<kind>_noise_scale``.
DOF = {'odometry': 3, 'landmark': 2, 'robot': 2}

#: Length [ns] of the window of an error, and the longest one between sparse true poses.
ERROR_WINDOW, MAX_ODOMETRY_WINDOW = 5 * NS, 60 * NS

#: Minimum number of windows whose mean gives the position of a landmark.
MIN_POSITION_WINDOWS = 5


def normalized_errors(records: Iterable[Record], settings: Settings) -> dict[str, Errors]:
    """
    Return the normalised errors squared of each kind of noise with ground truth.

    The settings give the noise of measurements without covariance, and systematic errors; noise
    scales are not used.

    """
    team = TeamRecords(records, [robot.name for robot in settings.robots])
    scans = {
        robot.name: [without_observation_errors(scan, robot) for scan in team.scans[robot.name]]
        for robot in settings.robots}
    landmarks = _landmark_positions(
        chain.from_iterable(scans.values()), team.truth, team.near, settings.shared_landmark_ids)

    def observation_errors(of_kind: Iterable[Scan | RobotScan]) -> list[float]:
        return [*_in_windows([
            e for scan in of_kind for e in _observation_errors(scan, landmarks, team.near)])]

    errors = {
        'odometry': {
            robot.name: [*_odometry_errors(team.odometry[robot.name], team.truth, robot)]
            for robot in settings.robots},
        'landmark': {
            robot.name: observation_errors(scans[robot.name]) for robot in settings.robots},
        'robot': {
            robot.name: observation_errors(
                without_observation_errors(scan, robot) for scan in team.robot_scans[robot.name])
            for robot in settings.robots}}
    return {kind: by_robot for kind, by_robot in errors.items() if any(by_robot.values())}


def _odometry_errors(
    odometry: Sequence[Odometry], truth: RecordedTruth, settings: NoiseSettings
) -> Iterator[float]:
    """Yield the normalised error squared of each window with motion between known true poses."""
    begin, x, P = None, np.zeros(3), np.zeros((3, 3))
    for earlier, later in pairwise(odometry):
        if later.stamp - earlier.stamp > MAX_ODOMETRY_WINDOW:
            continue
        if begin is None or later.stamp - begin.stamp > MAX_ODOMETRY_WINDOW:
            if not truth.covers(earlier.robot, earlier.stamp):
                continue
            begin, x, P = earlier, np.zeros(3), np.zeros((3, 3))
        x, P = models.composed_increment(x, P, *increment(earlier, later, settings))
        if later.stamp - begin.stamp >= ERROR_WINDOW and truth.covers(
                later.robot, later.stamp):
            # Standing still shows nothing about the noise of driving.
            if x.any() and is_definite(P):
                true = between(*(truth.pose(end.robot, end.stamp) for end in (begin, later)))
                yield float(nees(pose_difference(x, true), P))
            begin, x, P = later, np.zeros(3), np.zeros((3, 3))


class _Position(NamedTuple):
    """Position of a landmark."""

    point: Array  #: (2,) [m]
    #: factor on errors, above 1 for the mean of few windows, nearer to them than the truth
    scale: float


#: Position by ID, and by robot if each has IDs of its own, else by ''.
_Positions = dict[tuple[str, int], _Position]


class _Observed(NamedTuple):
    """A landmark as observed from a true pose."""

    robot: str
    stamp: int  #: [ns]
    point: Array  #: (2,) [m]
    P: Array  #: (2, 2) [m^2]


def _landmark_positions(
    scans: Iterable[Scan], truth: RecordedTruth, near: Mapping[str, NearTruth],
    has_shared_ids: bool,
) -> _Positions:
    """Return the true positions of landmarks, and the means of observations of others."""
    # If each robot has IDs of its own, it is not known whose the true landmarks have.
    positions: _Positions = {
        ('', id_): _Position(point[:2], 1.0) for id_, point in truth.landmarks.items()
        if has_shared_ids}
    observed: defaultdict[tuple[str, int], list[_Observed]] = defaultdict(list)
    for scan in scans:
        owner = '' if has_shared_ids else scan.robot
        unknown = [o for o in scan.observations if (owner, o.id) not in positions]
        pose = near[scan.robot].pose(scan.stamp) if unknown else None
        if pose is not None:
            C = rotation(pose[2])
            for o in unknown:
                observed[owner, o.id].append(_Observed(
                    scan.robot, scan.stamp, transform(pose, o.z[None])[0], C @ o.R @ C.T))
    for key, of_landmark in observed.items():
        windows = len({(o.robot, o.stamp // ERROR_WINDOW) for o in of_landmark})
        if windows >= MIN_POSITION_WINDOWS:
            positions[key] = _Position(
                _mean_position(of_landmark), math.sqrt(windows / (windows - 1)))
    return positions


def _mean_position(observed: Sequence[_Observed]) -> Array:
    """Return the weighted mean (2,) of observations without outliers."""
    points, P = np.array([o.point for o in observed]), np.array([o.P for o in observed])
    kept = inliers(nees(points - np.median(points, axis=0), P))
    weights = np.linalg.inv(P[kept])
    return np.linalg.solve(
        weights.sum(axis=0), np.einsum('kij,kj->i', weights, points[kept]))


class ObservationError(NamedTuple):
    """Error of an observation of a landmark or robot, in the robot's frame."""

    observed: int | str  #: ID or name
    stamp: int  #: [ns]
    e: Array  #: (2,) [m]
    R: Array  #: stated covariance (2, 2) [m^2]


def _observation_errors(
    scan: Scan | RobotScan, landmarks: _Positions, near: Mapping[str, NearTruth]
) -> Iterator[ObservationError]:
    """Yield the error of each observation of a known position."""
    pose = near[scan.robot].pose(scan.stamp)
    if pose is None:
        return
    for o in scan.observations:
        observed: int | str
        if isinstance(o, Observation):
            observed = o.id
            position = landmarks.get(('', o.id)) or landmarks.get((scan.robot, o.id))
        else:
            observed = o.observed
            other = near[observed].pose(scan.stamp)
            position = None if other is None else _Position(other[:2], 1.0)
        if position is not None:
            e = o.z - models.h(pose[None], position.point[None])[0]
            yield ObservationError(observed, scan.stamp, position.scale * e, o.R)


def _in_windows(errors: Sequence[ObservationError]) -> Iterator[float]:
    """Yield the sum of the errors of each window, normalised and squared, without outliers."""
    if not errors:
        return
    kept = inliers(np.array([float(nees(error.e, error.R)) for error in errors]))
    windows: dict[int | str, list[list[ObservationError]]] = defaultdict(list)
    for error in compress(errors, kept):
        of_observed = windows[error.observed]
        if not of_observed or error.stamp - of_observed[-1][0].stamp >= ERROR_WINDOW:
            of_observed.append([])
        of_observed[-1].append(error)
    for window in chain.from_iterable(windows.values()):
        e = np.sum([error.e for error in window], axis=0)
        R = np.sum([error.R for error in window], axis=0)
        yield float(nees(e, R))
