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
from dataclasses import replace
from itertools import chain, compress, pairwise
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.calibration.noise_growth import ErrorAtRange, noise_growth
from fej_slam_ros.core.calibration.odometry_sigma import MotionError, sigma_factors
from fej_slam_ros.core.calibration.scales_of_errors import Errors, inliers
from fej_slam_ros.core.calibration.team_records import NearTruth, TeamRecords
from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.definiteness import is_definite
from fej_slam_ros.core.geometry import Array, between, pose_difference, rotation, transform
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.corrected_observations import (
    with_noise, without_observation_errors)
from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, RobotScan, Scan, ScanT)
from fej_slam_ros.core.settings import NoiseSettings, Settings, Triple, with_equal_noise

#: Degrees of freedom of an error by kind of noise, as in the parameters ``<kind>_noise_scale``.
DOF = {'odometry': 3, 'landmark': 2, 'robot': 2}

#: Length [ns] of the window of an error, and the longest one between sparse true poses.
ERROR_WINDOW, MAX_ODOMETRY_WINDOW = 5 * NS, 60 * NS

#: Minimum number of windows whose mean gives the position of a landmark.
MIN_POSITION_WINDOWS = 5


def normalized_errors(team: TeamRecords, settings: Settings) -> dict[str, Errors]:
    """
    Return the normalised errors squared of each kind of noise with ground truth.

    The settings give the noise of measurements without covariance, its growth, and systematic
    errors; noise scales are not used.

    """
    errors: dict[str, Errors] = {'odometry': {
        robot.name: [
            float(nees(*error))
            for error in _motion_errors(team.odometry[robot.name], team.truth, robot)]
        for robot in settings.robots}}
    errors |= {
        kind: {robot: [error.d2 for error in of_robot] for robot, of_robot in of_kind.items()}
        for kind, of_kind in _errors_of_observations(team, settings).items()}
    return {kind: by_robot for kind, by_robot in errors.items() if any(by_robot.values())}


def growth_by_truth(team: TeamRecords, settings: Settings) -> float | None:
    """
    Return the growth of the noise of observations [1/m], as of `noise_growth`.

    Settings as of `normalized_errors`, but for the growth that they have.

    """
    constant = with_equal_noise(settings, observation_noise_growth=0.0)
    return noise_growth([
        [*chain.from_iterable(of_kind.values())]
        for of_kind in _errors_of_observations(team, constant).values()])


def _errors_of_observations(
    team: TeamRecords, settings: Settings
) -> dict[str, dict[str, list[ErrorAtRange]]]:
    """Return the errors of windows, by kind of observations and robot."""
    def errors_of(scans: Iterable[ScanT], growth: float) -> list[ErrorAtRange]:
        return [*_in_windows([
            error for scan in scans for error in _observation_errors(
                with_noise(scan, 1.0, growth), landmarks, team.near)])]

    robots = {robot.name: robot for robot in settings.robots}
    scans = {
        name: [without_observation_errors(scan, robot) for scan in team.scans[name]]
        for name, robot in robots.items()}
    landmarks = _landmark_positions(
        chain.from_iterable(scans.values()), team.truth, team.near, settings.shared_landmark_ids)
    return {
        'landmark': {
            name: errors_of(scans[name], robot.observation_noise_growth)
            for name, robot in robots.items()},
        'robot': {
            name: errors_of(
                (without_observation_errors(scan, robot) for scan in team.robot_scans[name]),
                robot.observation_noise_growth)
            for name, robot in robots.items()}}


def odometry_sigmas(team: TeamRecords, settings: Settings) -> dict[str, Triple]:
    """Return odometry_sigma of robots without covariance for which one factor does not do."""
    found = {}
    for robot in settings.robots:
        odometry, (x, y, phi) = team.odometry[robot.name], robot.odometry_sigma
        if any(message.twist_covariance is not None for message in odometry):
            continue
        factors = sigma_factors(*(
            [*_motion_errors(odometry, team.truth, replace(robot, odometry_sigma=sigma))]
            for sigma in ((x, y, phi), (x, y, 2.0 * phi))))
        if factors is not None:
            position, turn = factors
            found[robot.name] = (position * x, position * y, turn * phi)
    return found


def _motion_errors(
    odometry: Sequence[Odometry], truth: RecordedTruth, settings: NoiseSettings
) -> Iterator[MotionError]:
    """Yield the error of each window with motion between known true poses."""
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
                yield MotionError(pose_difference(x, true), P)
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
    range: float  #: [m]


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
            yield ObservationError(
                observed, scan.stamp, position.scale * e, o.R, math.hypot(*o.z))


def _in_windows(errors: Sequence[ObservationError]) -> Iterator[ErrorAtRange]:
    """Yield the sum of the errors of each window, without outliers."""
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
        ranges = [error.range for error in window]
        yield ErrorAtRange(sum(ranges) / len(ranges), float(nees(e, R)))
