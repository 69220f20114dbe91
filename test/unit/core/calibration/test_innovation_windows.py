# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors from innovations over some seconds, where errors persist and where not."""

from dataclasses import replace
import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_innovations import most_likely_scales, with_scans_apart
from fej_slam_ros.core.calibration.innovation_windows import scales_over_windows
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import NS, Odometry, RobotScan, Scan
from helpers.calibration import error, received, simulated
from helpers.records import claiming, odometry, scan, team

#: Number of messages for which an error persists, and number of messages in 5 s at 5 Hz.
LENGTH, WINDOW = 12, 25
#: Factor on the standard deviation of a sum over 5 s, for blocks of equal errors that begin at any
#: message: the covariance of two errors k messages apart is that of one times 1 - k / LENGTH.
FACTOR = math.sqrt(1.0 + 2.0 * sum(
    (1.0 - k / WINDOW) * (1.0 - k / LENGTH) for k in range(1, LENGTH)))


def errors_in_blocks(rng, sigma):
    """Yield errors of which LENGTH are equal, from any within a block on."""
    count = int(rng.integers(1, LENGTH + 1))
    while True:
        error = rng.normal(0.0, sigma)
        for _ in range(count):
            yield error
        count = LENGTH


def with_persistent_odometry_errors(records, sigma):
    """Return records with errors of odometry, stated as independent ones of the same size."""
    rng, errors, before, integrated = np.random.default_rng(0), {}, {}, {}

    def with_error(record):
        if not isinstance(record, Odometry):
            return record
        robot = record.robot
        if robot in before:
            u = between(before[robot], record.pose)
            integrated[robot] = compose(integrated[robot], u + next(errors[robot]))
        else:
            errors[robot], integrated[robot] = errors_in_blocks(rng, sigma), record.pose
        before[robot] = record.pose
        return replace(
            record, pose=integrated[robot], twist_covariance=np.diag(np.square(sigma)) / 0.2 ** 2)

    return [*map(with_error, records)]


def with_persistent_observation_errors(records, sigma):
    """Return records with errors of observations that persist for each robot and landmark."""
    rng, errors = np.random.default_rng(0), {}

    def with_errors(record):
        if not isinstance(record, Scan):
            return record
        for o in record.observations:
            errors.setdefault((record.robot, o.id), errors_in_blocks(rng, [sigma, sigma]))
        return replace(record, observations=tuple(
            replace(o, z=o.z + next(errors[record.robot, o.id]), R=sigma ** 2 * np.eye(2))
            for o in record.observations))

    return [*map(with_errors, records)]


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_factors_of_independent_errors_equal_those_of_the_simulation(seed):
    records = received(claiming(
        simulated(seed, loops=8, rate=1, robot_sigma=[0.2, 0.2]), {Scan: 2.0, RobotScan: 0.5}))

    found = scales_over_windows(team(), records, {'landmark': 1.0, 'robot': 1.0})

    assert error(found['landmark'], 0.5) < 4.0
    assert error(found['robot'], 2.0) < 4.0
    assert all(scale.is_known() for scale in found.values())


def test_errors_of_odometry_that_persist_count_over_5_s():
    records = received(with_persistent_odometry_errors(
        simulated(
            1, loops=6, rate=5, odometry_sigma=[1e-6, 1e-6, 1e-6], landmark_sigma=[0.03, 0.03]),
        np.array([0.03, 0.03, 0.01])))
    kinds = ['odometry', 'landmark']

    over_5_s = most_likely_scales(team(), with_scans_apart(records, 5 * NS), kinds)['odometry']
    single = most_likely_scales(team(), records, kinds)['odometry']

    assert over_5_s.is_known()
    assert error(over_5_s, FACTOR) < 4.0
    assert single.scale < 0.8 * FACTOR


def test_errors_of_observations_that_persist_count_over_5_s_but_for_what_the_map_follows():
    records = received(with_persistent_observation_errors(
        simulated(2, loops=6, rate=5, landmark_sigma=[1e-6, 1e-6]), 0.1))

    over_5_s = scales_over_windows(team(), records, {'landmark': 1.0})['landmark']
    single = most_likely_scales(team(), records, ['landmark'])['landmark']

    assert over_5_s.is_known()
    assert 0.65 * FACTOR < over_5_s.scale < FACTOR
    assert single.scale < 0.4 * FACTOR


def test_scans_apart_are_one_of_each_kind_and_robot_in_the_time():
    scans = [scan(robot, ms, [(1, (2.0, 0.0))]) for ms in range(0, 12_000, 500)
             for robot in ('r1', 'r2')]
    messages = [odometry('r1', ms) for ms in range(0, 12_000, 500)]

    kept = [record for record, _ in with_scans_apart(received([*messages, *scans]), 5 * NS)]

    assert kept[:len(messages)] == messages
    assert [(record.robot, record.stamp // NS) for record in kept[len(messages):]] == [
        (robot, s) for s in (0, 5, 10) for robot in ('r1', 'r2')]


def test_without_observations_of_a_kind_its_factor_is_not_known():
    records = received([odometry('r1', ms) for ms in range(0, 2000, 100)])

    found = scales_over_windows(team('r1'), records, {'landmark': 1.0})

    assert not found['landmark'].is_known()
