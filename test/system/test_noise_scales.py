# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A noise scale is as good as records that claim so much more noise."""

from dataclasses import replace

import pytest

from fej_slam_ros.core.calibration.from_innovations import with_scales
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.ros.session import simulation
from helpers import csam
from helpers.records import claiming, team

#: Factors that are powers of two change no digit.
FACTORS = {'odometry': 2.0, 'landmark': 0.5, 'robot': 4.0}
BY_TYPE = dict(zip((Odometry, Scan, RobotScan), FACTORS.values()))

RECORDS = [*simulation.parse({
    'loops': 1, 'steps_per_loop': 20, 'landmarks': 12, 'robot_sigma': [0.2, 0.3]}).records()]
WITHOUT_COVARIANCE = [
    replace(record, twist_covariance=None) if isinstance(record, Odometry) else record
    for record in RECORDS]


def estimated(settings, records):
    estimator = Estimator(settings)
    for record in records:
        estimator.add(record)
    list(estimator.close())
    return estimator.state_hash()


def smoothed(settings, records):
    return csam.smoothed(records, settings)[0].state_hash()


@pytest.mark.parametrize('result', [estimated, smoothed])
def test_a_noise_scale_equals_scaled_covariances(result):
    scaled = result(with_scales(team(), FACTORS), RECORDS)

    assert scaled == result(team(), claiming(RECORDS, BY_TYPE))
    assert scaled != result(team(), RECORDS)


@pytest.mark.parametrize('kind', FACTORS)
def test_each_noise_scale_applies_to_its_own_kind_of_input(kind):
    of_type = dict(zip(FACTORS, BY_TYPE))[kind]

    scaled = estimated(with_scales(team(), {kind: 2.0}), RECORDS)

    assert scaled == estimated(team(), claiming(RECORDS, {of_type: 2.0}))


def test_a_noise_scale_also_applies_to_noise_from_parameters():
    sigma = (0.1, 0.2, 0.3)
    given = replace(team(), robots=tuple(
        replace(robot, odometry_sigma=sigma) for robot in team().robots))
    doubled = replace(team(), robots=tuple(
        replace(robot, odometry_sigma=tuple(2.0 * s for s in sigma)) for robot in team().robots))

    scaled = estimated(with_scales(given, {'odometry': 2.0}), WITHOUT_COVARIANCE)

    assert scaled == estimated(doubled, WITHOUT_COVARIANCE)


def test_each_robot_has_its_own_noise_scales():
    r1, r2 = team().robots
    only_r2 = replace(team(), robots=(r1, replace(r2, odometry_noise_scale=2.0)))
    records = [
        *claiming([r for r in RECORDS if getattr(r, 'robot', '') == 'r2'], {Odometry: 2.0}),
        *(r for r in RECORDS if getattr(r, 'robot', '') != 'r2')]

    assert estimated(only_r2, RECORDS) == estimated(team(), records)
