# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of odometry."""

import numpy as np
import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor.odometry import check
from fej_slam_ros.ros.doctor.survey import OdometrySeries


def checked(topic):
    return check(topic, RobotSettings('r1', 1))


def findings_of(x, stamps=None):
    """Return the names of findings in odometry along x (n,), at 10 Hz by default."""
    if stamps is None:
        stamps = np.arange(len(x)) * NS // 10
    covariances = [np.diag([1e-2, 1e-2, 1e-3])] * len(x)
    return [finding.name for finding in checked(OdometrySeries(
        stamps.tolist(), stamps.tolist(), poses=[(at, 0.0, 0.0) for at in x.tolist()],
        covariances=covariances))]


def test_driving_after_a_minute_of_rest_is_not_a_jump():
    # 1.5 m/s for 2 s.
    assert findings_of(np.maximum(0.0, np.arange(620) - 599.0) * 0.15) == []


@pytest.mark.parametrize('index', [1, 50, 99])
def test_a_displaced_robot_at_rest_has_jumped(index):
    x = np.zeros(100)
    x[index:] = 0.5

    assert findings_of(x) == ['jump']


def test_the_cure_of_a_jump_names_the_limits_by_which_a_recorded_one_is_used():
    x = np.repeat([0.0, 0.5], 50)
    stamps = (np.arange(100) * NS // 10).tolist()

    (finding,) = checked(OdometrySeries(
        stamps, stamps, poses=[(at, 0.0, 0.0) for at in x.tolist()],
        covariances=[np.diag([1e-2, 1e-2, 1e-3])] * 100))

    assert '<robot>.max_speed and <robot>.max_turn_rate' in finding.cure


def test_stamps_in_bursts_are_not_jumps():
    k = np.arange(200)
    # Every fortieth message has a stamp 0.1 ms after the one before it.
    stamps = k * NS // 10 - np.where(k % 40 == 39, NS // 10 - NS // 10_000, 0)

    assert findings_of(0.1 * k, stamps) == []


@pytest.mark.parametrize(('at_rest', 'driving', 'expected'), [
    (1e-9, 1e-2, []), (1e-2, 1e-9, ['absurd_covariance']), (1e3, 1e-2, ['absurd_covariance'])])
def test_a_robot_at_rest_may_be_almost_certain_of_its_speed(at_rest, driving, expected):
    x = 0.05 * np.maximum(0.0, np.arange(100) - 50.0)
    stamps = (np.arange(100) * NS // 10).tolist()
    covariances = [(driving if at > 0.0 else at_rest) * np.eye(3) for at in x.tolist()]

    found = [*checked(OdometrySeries(
        stamps, stamps, poses=[(at, 0.0, 0.0) for at in x.tolist()], covariances=covariances))]

    assert [finding.name for finding in found] == expected
    assert [finding.count for finding in found] == [49 if driving < at_rest == 1e-2 else 50][
        :len(found)]


@pytest.mark.parametrize(('diagonal', 'beside', 'expected'), [
    (1e-3, 1e-3, ['singular_covariance']), (1e-3, 5e-3, []), (1e-3, np.nan, []),
    (np.inf, 0.0, [])])
def test_covariances_that_are_rejected_are_not_called_singular(diagonal, beside, expected):
    stamps = (np.arange(100) * NS // 10).tolist()
    P = np.where(np.eye(3), diagonal, beside)

    found = checked(OdometrySeries(
        stamps, stamps, poses=[(0.1 * k, 0.0, 0.0) for k in range(100)], covariances=[P] * 100))

    assert [finding.name for finding in found] == expected


def findings_on_a_drive(of_yaw, direction=0.0, dt=0.1):
    """Return the findings of a drive at 0.5 m/s in winding curves, with a wrong yaw."""
    t = dt * np.arange(1000)
    yaw = 1.5 * np.sin(0.1 * t) + 0.15 * t
    courses = yaw[:-1] + direction
    x, y = (
        0.5 * dt * np.append(0.0, np.cumsum(part(courses))) for part in (np.cos, np.sin))
    stamps = (t * NS).astype(int).tolist()
    wrong = np.angle(np.exp(1j * of_yaw(yaw)))
    return [finding.what for finding in checked(OdometrySeries(
        stamps, stamps, poses=[*zip(x, y, wrong)],
        covariances=[np.diag([1e-2, 1e-2, 1e-3])] * 1000))]


# At 0.8 s, each step is longer than the compared distance.
@pytest.mark.parametrize(('of_yaw', 'dt', 'fault'), [
    (np.negative, 0.1, 'have the other sign'), (np.negative, 0.8, 'have the other sign'),
    (np.degrees, 0.1, 'be in radians, not degrees')])
def test_yaw_that_is_not_the_direction_of_travel_is_named(of_yaw, dt, fault):
    assert findings_on_a_drive(of_yaw, dt=dt) == [
        f'it does not drive in the direction of its yaw, as it would if that were to {fault}']


@pytest.mark.parametrize('direction', [0.0, np.pi, np.pi / 2.0])
def test_a_robot_may_drive_backwards_or_sideways(direction):
    assert findings_on_a_drive(lambda yaw: yaw, direction) == []
