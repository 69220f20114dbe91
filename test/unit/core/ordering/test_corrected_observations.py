# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ranges, bearings and covariances of observations are corrected as the parameters state."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ordering.corrected_observations import corrected, without_observation_errors
from fej_slam_ros.core.records import Observation, RobotObservation, RobotScan, Scan
from fej_slam_ros.core.settings import NoiseSettings

WRONG = NoiseSettings(
    observation_range_scale=1.25, observation_bearing_bias=0.1, landmark_noise_scale=2.0,
    robot_noise_scale=3.0)
R = np.array([[0.04, 0.01], [0.01, 0.09]])


def polar(r, bearing):
    return r * np.array([np.cos(bearing), np.sin(bearing)])


@pytest.mark.parametrize(('scan', 'noise_scale'), [
    (Scan('r', 5, (Observation(3, polar(4.0, 0.7), R),)), 2.0),
    (RobotScan('r', 5, (RobotObservation('q', polar(4.0, 0.7), R),)), 3.0)])
def test_range_is_multiplied_and_bearing_reduced(scan, noise_scale):
    observation, = corrected(scan, WRONG).observations
    unscaled, = without_observation_errors(scan, WRONG).observations

    for found, factor in (observation, noise_scale), (unscaled, 1.0):
        assert_allclose(found.z, polar(5.0, 0.6), rtol=1e-14)
        # The axes of the covariance turn with the observation, and its sigmas grow with the range.
        w, V = np.linalg.eigh(found.R)
        w_0, V_0 = np.linalg.eigh(R)
        assert_allclose(w, (1.25 * factor) ** 2 * w_0, rtol=1e-14)
        turn = np.arctan2(*V[::-1, 0]) - np.arctan2(*V_0[::-1, 0])
        assert np.sin(turn + 0.1) == pytest.approx(0.0, abs=1e-14)


def test_observations_without_stated_errors_stay_as_they_are():
    scan = Scan('r', 5, (Observation(3, polar(4.0, 0.7), R),))

    assert corrected(scan, NoiseSettings()) is scan


@pytest.mark.parametrize('scan', [
    Scan('r', 5, (Observation(3, polar(4.0, 0.7), R),)),
    RobotScan('r', 5, (RobotObservation('q', polar(4.0, 0.7), R),))])
def test_standard_deviations_grow_with_the_corrected_range(scan):
    growing = replace(WRONG, observation_noise_growth=0.5)

    (constant,), (observation,) = (
        corrected(scan, settings).observations for settings in (WRONG, growing))

    # At 5 m: 1 + 0.5 * 5.
    assert_allclose(observation.R, 3.5 ** 2 * constant.R, rtol=1e-14)
    assert_allclose(observation.z, constant.z, rtol=0.0, atol=0.0)
