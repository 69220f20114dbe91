# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth tells by which factors noise is claimed wrongly."""

from dataclasses import replace
import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_truth import (
    DOF, noise_scale, noise_scales, normalized_errors)
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.ros.session import simulation
from helpers.records import claiming, odometry, team, true_pose

#: Messages claim a half, double, and all of the noise.
TRUE_FACTORS = {'odometry': 2.0, 'landmark': 0.5, 'robot': 1.0}
CLAIMED = {Odometry: 0.5, Scan: 2.0}


def simulated(seed, **changes):
    return [*simulation.parse({
        'loops': 5, 'rate': 1, 'landmarks': 40, 'robot_sigma': [0.2, 0.3], 'seed': seed,
        **changes}).records()]


def told(records, **changes):
    errors = normalized_errors(records, team(**changes))
    return {kind: noise_scales(of, DOF[kind]) for kind, of in errors.items()}


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_factors_are_those_of_the_simulation(seed):
    found = told(claiming(simulated(seed), CLAIMED))

    for kind, true in TRUE_FACTORS.items():
        team_factor = found[kind]['']
        # Twelve normal numbers: one is beyond 4 standard errors in a thousand such tests.
        off = math.log(team_factor.scale / true)
        assert abs(off) < 4.0 * team_factor.relative_error, kind


def test_the_standard_error_is_the_spread_of_the_factor():
    found = [
        noise_scale(np.random.default_rng(seed).chisquare(3, 100), 3) for seed in range(400)]

    spread = np.std([np.log(f.scale) for f in found])

    # The spread of 400 is known to 1 / sqrt(800) = 3.5 %.
    assert spread == pytest.approx(found[0].relative_error, rel=0.15)


def test_a_robot_with_other_noise_has_a_factor_of_its_own():
    of_r2 = {Odometry: 0.25, Scan: 1.0}
    records = [
        claiming([r], of_r2 if getattr(r, 'robot', '') == 'r2' else CLAIMED)[0]
        for r in simulated(1, loops=10)]

    found = told(records)

    for robot, kind, true in [
            ('r1', 'odometry', 2.0), ('r2', 'odometry', 4.0), ('r1', 'landmark', 0.5),
            ('r2', 'landmark', 1.0)]:
        own = found[kind][robot]
        assert abs(math.log(own.scale / true)) < 4.0 * own.relative_error, (robot, kind)


def test_a_robot_with_little_data_has_the_factor_of_the_team():
    assert told(simulated(1, loops=1))['odometry'].keys() == {''}


def test_gross_errors_change_no_factor():
    right = told(simulated(1))['landmark']['']
    moved = [
        replace(record, observations=(
            replace(record.observations[0], z=record.observations[0].z + 20.0), *record.observations[1:]))
        if isinstance(record, Scan) and record.observations and record.stamp % 20 == 0 else record
        for record in simulated(1)]

    robust = told(moved)['landmark']['']

    assert abs(math.log(robust.scale / right.scale)) < right.relative_error


def test_errors_that_last_count_in_full():
    # 10 % too slow at 1 m/s all the time, with independent errors of 0.1 m/s claimed.
    times = range(0, 60_001, 100)
    truth = [true_pose('r1', ms, (ms / 1000.0, 0.0, 0.0)) for ms in times]
    slow = [odometry('r1', ms, (0.9 * ms / 1000.0, 0.0, 0.0), 0.01 * np.eye(3)) for ms in times]

    errors = normalized_errors([*slow, *truth], team())['odometry']['r1']

    # In 5 s 0.5 m, against sqrt(50) times 0.1 m/s for 0.1 s.
    assert errors == pytest.approx([50.0] * 12)


def test_numbers_that_are_each_robots_own_tell_nothing_of_landmarks():
    found = told(simulated(1), shared_landmark_ids=False)

    assert found.keys() == {'odometry', 'robot'}


def test_without_truth_nothing_is_told():
    measured = [r for r in simulated(1) if isinstance(r, (Odometry, Scan, RobotScan))]

    assert not normalized_errors(measured, team())
