# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the odometry of a robot for systematic errors, by the landmarks that it observes."""

from collections.abc import Iterator, Sequence

import numpy as np

from fej_slam_ros.core.calibration.odometry_errors import fit_to_landmarks
from fej_slam_ros.core.calibration.systematic_errors import given_odometry
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.findings import Finding, warning

#: Smallest errors that are reported: of distances, of turns, and of the turn rate [rad/s]. In
#: simulated runs with noise that lasts for seconds, correct odometry had up to 0.023 and 0.004.
REPORTED = np.array([0.03, 0.03, 0.005])


def check(
    robot: RobotSettings, odometry: Sequence[Odometry], scans: Sequence[Scan]
) -> Iterator[Finding]:
    """Yield the errors that `calibrate` would correct; odometry and scans are by stamps."""
    given = given_odometry(robot)
    errors = fit_to_landmarks(odometry, scans, given)
    if errors is None:
        return
    is_wrong = errors.is_known & (np.abs(errors.values - given) > REPORTED)
    distance, turn, bias = errors.values - given
    texts = (
        f'distances {abs(distance):.1%} too {_size(distance, "long", "short")} for its ranges',
        f'turns {abs(turn):.1%} too {_size(turn, "large", "small")}',
        f'the turn rate {abs(bias):.3f} rad/s too {_size(-bias, "high", "low")}')
    if is_wrong.any():
        yield warning(
            'systematic_errors', f'{robot.name}/odom',
            'by the landmarks that it observes, odometry has '
            + ', '.join(text for text, wrong in zip(texts, is_wrong) if wrong),
            'run fej_slam calibrate; check the radius of wheels, their distance, and the units of'
            ' ranges', errors.pairs)


def _size(correction: float, above: str, below: str) -> str:
    """Return how a value is that needs a correction."""
    return above if correction < 0.0 else below
