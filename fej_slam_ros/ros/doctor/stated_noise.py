# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of covariances: innovations agree with them, and odometry does not claim too much."""

from collections.abc import Iterator
import math

import numpy as np

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding
from fej_slam_ros.ros.doctor.survey import OdometrySeries
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.session.estimator_reports import NIS_ERROR

#: Ranges of NIS/dof: outside the first the noise needs tuning, outside the second it is an error.
NIS_RANGE = (0.2, 2.0)
NIS_PLAUSIBLE_RANGE = (0.01, NIS_ERROR)
#: Minimum degrees of freedom to judge NIS by.
MIN_NIS_DOF = 40
OPTIMISTIC_ODOMETRY = 'optimistic_odometry'
#: Standard deviation of the distance after `STATED_DISTANCE` [m] below which odometry claims to be
#: better than that of wheels, cameras or lasers, 0.03 m or more, and NIS/dof above which
#: observations contradict this: with variances of 1e-5, as simulators fill in, it is 0.002 m.
MIN_STATED_ERROR, STATED_DISTANCE, MAX_NIS = 0.01, 10.0, 1.2
#: Probability with which NIS/dof of consistent covariances is in the band above which it has to be
#: too: in a short bag, it is above 1.2 by chance.
NIS_PROBABILITY = 0.999


def check(robot: RobotSettings, odometry: OdometrySeries, trial: Trial) -> Iterator[Finding]:
    """Yield that the covariances of a robot disagree with its innovations."""
    nis = trial.estimator.innovations.nis[robot.name]
    ratio = nis.total / nis.dof if nis.dof >= MIN_NIS_DOF else 1.0
    stated = _stated_error(odometry, robot)
    limit = max(MAX_NIS, band_per_dof(max(nis.dof, MIN_NIS_DOF), NIS_PROBABILITY)[1])
    if stated < MIN_STATED_ERROR and ratio > limit:
        yield error(
            OPTIMISTIC_ODOMETRY, f'{robot.name}/odom',
            f'by twist.covariance, distances are wrong by {1e3 * stated:.1f} mm after'
            f' {STATED_DISTANCE:g} m, and observations contradict that: NIS/dof is {ratio:.3g}'
            ' instead of 1',
            f'run fej_slam calibrate, or set {robot.name}.use_odometry_covariance to false, to use'
            ' odometry_sigma')
    elif not NIS_RANGE[0] <= ratio <= NIS_RANGE[1]:
        yield error_if(not NIS_PLAUSIBLE_RANGE[0] <= ratio <= NIS_PLAUSIBLE_RANGE[1])(
            'inconsistent_noise', robot.name,
            f'NIS/dof is {ratio:.3g} instead of 1: the covariances of its odometry or observations'
            f' are too {"small" if ratio > 1.0 else "large"}',
            'run fej_slam calibrate after correcting the other errors')


def _stated_error(odometry: OdometrySeries, robot: RobotSettings) -> float:
    """Return the standard deviation of the distance after 10 m [m], infinite if not stated."""
    stamps, first = np.unique(np.array(odometry.stamps, np.int64), return_index=True)
    covariances: Array = np.array(odometry.covariances).reshape(-1, 3, 3)[first][1:]
    steps = np.diff(np.array(odometry.poses).reshape(-1, 3)[first, :2], axis=0)
    driven = np.nansum(np.hypot(*steps.T))
    variances = covariances[:, 0, 0]
    is_stated = robot.use_odometry_covariance and covariances.any(axis=(1, 2)).all()
    if not is_stated or not (variances >= 0.0).all() or driven < STATED_DISTANCE:
        return math.inf
    sigma = robot.odometry_noise_scale * np.sqrt(variances) * np.diff(stamps) / NS
    return float(np.linalg.norm(sigma) * math.sqrt(STATED_DISTANCE / driven))
