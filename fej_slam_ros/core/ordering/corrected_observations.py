# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of landmarks and robots without the errors that the parameters of a robot state."""

from dataclasses import replace
import math

from fej_slam_ros.core.geometry import rotation
from fej_slam_ros.core.records import AnyScan, RobotScan, ScanT
from fej_slam_ros.core.settings import NoiseSettings


def without_observation_errors(scan: ScanT, settings: NoiseSettings) -> ScanT:
    """Return a scan with corrected ranges and bearings; its noise is not corrected."""
    if settings.observation_range_scale == 1.0 and settings.observation_bearing_bias == 0.0:
        return scan
    A = settings.observation_range_scale * rotation(-settings.observation_bearing_bias)
    return replace(scan, observations=tuple(
        replace(o, z=A @ o.z, R=A @ o.R @ A.T) for o in scan.observations))


def corrected(scan: AnyScan, settings: NoiseSettings) -> AnyScan:
    """Return a scan with corrected ranges, bearings, and covariances."""
    if isinstance(scan, RobotScan):
        return corrected_robot_scan(scan, settings)
    return _corrected(scan, settings, settings.landmark_noise_scale)


def corrected_robot_scan(scan: RobotScan, settings: NoiseSettings) -> RobotScan:
    """Return a scan of robots with corrected ranges, bearings, and covariances."""
    return _corrected(scan, settings, settings.robot_noise_scale)


def _corrected(scan: ScanT, settings: NoiseSettings, scale: float) -> ScanT:
    """Return a scan with corrected ranges, bearings, and covariances by a noise scale."""
    unbiased = without_observation_errors(scan, settings)
    return with_noise(unbiased, scale, settings.observation_noise_growth)


def with_noise(scan: ScanT, scale: float, growth: float) -> ScanT:
    """Return a scan with standard deviations times scale * (1 + growth * range)."""
    if scale == 1.0 and growth == 0.0:
        return scan
    return replace(scan, observations=tuple(
        replace(o, R=(scale * (1.0 + growth * math.hypot(*o.z))) ** 2 * o.R)
        for o in scan.observations))
