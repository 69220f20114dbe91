# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dense and compressed filter are timed with equal results."""

import numpy as np
import pytest

from fej_slam_ros.benchmark import step_speed
from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.step_speed import CompressedTime, exponent, step_time, StepTime
from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance

ANY = Times(1.0, 1.0, 1.0, 1.0)


def test_the_compressed_filter_equals_the_dense_one_over_several_submaps(monkeypatch):
    monkeypatch.setattr(step_speed, 'STEP_LENGTH', 2.0)

    timed = step_time(500, 10, 60)

    assert (timed.states, timed.observations, timed.steps) == (500, 10, 60)
    assert timed.compressed.regions > 3
    assert 0.0 < timed.compressed.difference <= 1e-10


def test_small_states_are_timed_dense_only():
    assert step_time(50, 2, 5).compressed is None


def test_a_compressed_filter_that_differs_is_an_error(monkeypatch):
    leave = CompressedCovariance.leave

    def forgetful(self, x_hat, may_end=False):
        whole, x_expanded = leave(self, x_hat, may_end)
        return whole, x_hat + 0.999 * (x_expanded - x_hat)
    monkeypatch.setattr(CompressedCovariance, 'leave', forgetful)

    with pytest.raises(ArithmeticError, match='500 states the compressed filter is off by'):
        step_time(500, 10, 20)


@pytest.mark.parametrize('p', [0.25, 0.0])
def test_exponent_of_a_power_law(p):
    times = [
        StepTime(n, 10, 5, ANY, ANY, CompressedTime(Times(3.0 * n ** p, *3 * [1.0]), 1, 0.0))
        for n in (500, 1000, 5000)]

    # Rounding of a straight line through logarithms.
    assert exponent(times) == pytest.approx(p, abs=1e-12)


def test_a_step_of_a_drive_is_the_stride_and_observations_are_of_the_nearest():
    course = step_speed.drive(50, 20, 0.5, 4, np.random.default_rng(3))

    increments = np.diff(course.poses[:, :, :2], axis=0)
    np.testing.assert_allclose(np.linalg.norm(increments, axis=-1), 0.5)
    assert {len(scan.observations) for _, scans in course.steps for scan in scans} == {4}
    # Four of one landmark per 20 m^2 are within some metres.
    far = [
        np.hypot(*s.z) for _, scans in course.steps for scan in scans for s in scan.observations]
    assert np.median(far) < 7.0
