# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of odometry and bearings for systematic errors, by the landmarks that a robot observes."""

from collections.abc import Iterator, Sequence

import numpy as np

from fej_slam_ros.core.calibration.errors_by_landmarks import (
    ErrorsByLandmarks, fit_to_landmarks)
from fej_slam_ros.core.calibration.odometry_errors import given_odometry
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.findings import Finding, warning

#: Smallest errors that are reported: of distances, of turns, and of the turn rate [rad/s]. In
#: simulated runs with noise that lasts for seconds, correct odometry had up to 0.023 and 0.004.
REPORTED = np.array([0.03, 0.03, 0.005])
#: Smallest bearing bias [rad] that is reported.
REPORTED_BEARING = 0.017
#: What the pose of a sensor and its stamps need where they are wrong.
POSE_CURE = 'correct the static transform of the sensor or its sensor_pose'
DELAY_CURE = (
    'stamp observations with the time of the scan or image, not with that of its processing, or'
    ' set sensor_delay of the robot to {:.2f}, and max_delay to more')


def check(
    robot: RobotSettings, odometry: Sequence[Odometry], scans: Sequence[Scan]
) -> Iterator[Finding]:
    """Yield the errors that `calibrate` would correct; odometry and scans are by stamps."""
    errors = fit_to_landmarks(odometry, scans, robot)
    if errors is not None:
        yield from _of_odometry(robot, errors)
        yield from _of_bearings(robot, errors)
        yield from _of_sensor(robot, errors)


def _of_odometry(robot: RobotSettings, errors: ErrorsByLandmarks) -> Iterator[Finding]:
    change = errors.odometry.values - given_odometry(robot)
    is_wrong = errors.odometry.is_known & (np.abs(change) > REPORTED)
    distance, turn, bias = change
    texts = (
        f'distances {abs(distance):.1%} too {_size(distance, "long", "short")} for its ranges',
        f'turns {abs(turn):.1%} too {_size(turn, "large", "small")}',
        f'the turn rate {abs(bias):.3f} rad/s too {_size(-bias, "high", "low")}')
    if is_wrong.any():
        yield warning(
            'systematic_errors', f'{robot.name}/odom',
            'by the landmarks that it observes, odometry has '
            + ', '.join(text for text, wrong in zip(texts, is_wrong) if wrong),
            'run fej_slam calibrate; check the radius of wheels, their distance, the units of'
            ' ranges and the pitch of a camera', errors.odometry.samples)


def _of_bearings(robot: RobotSettings, errors: ErrorsByLandmarks) -> Iterator[Finding]:
    turned = errors.observations.values[1] - robot.observation_bearing_bias
    if errors.observations.is_known[1] and abs(turned) > REPORTED_BEARING:
        yield warning(
            'systematic_errors', f'{robot.name}/landmarks',
            f'by its direction of travel, bearings are {abs(turned):.3f} rad too far to the'
            f' {"left" if turned > 0.0 else "right"}',
            'run fej_slam calibrate; check the yaw of the sensor',
            errors.observations.samples)


def _of_sensor(robot: RobotSettings, errors: ErrorsByLandmarks) -> Iterator[Finding]:
    """Yield where the sensor is, and when it measures, by its observations."""
    where, count = f'{robot.name}/landmarks', errors.observations.samples
    if errors.position.any():
        x, y = errors.position
        yield warning(
            'sensor_pose', where,
            f'while the robot turns, the sensor seems to be {x:+.2f} m further ahead and'
            f' {y:+.2f} m further to the left than it should be', POSE_CURE, count)
    if errors.delay:
        yield warning(
            'sensor_time', where,
            f'where speeds change, its stamps seem to be {abs(errors.delay):.2f} s too'
            f' {"late" if errors.delay > 0.0 else "early"}',
            DELAY_CURE.format(robot.sensor_delay + errors.delay), count)


def _size(correction: float, above: str, below: str) -> str:
    """Return how a value is that needs a correction."""
    return above if correction < 0.0 else below
