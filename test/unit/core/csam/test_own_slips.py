# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot with landmarks is found again after it was carried."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.own_slips import own_map
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.smoothing.factors import rows_of
from helpers.csam import Met
from helpers.smoothing import dense_minimum

STEPS = 45
#: Probability that no correct observation is removed, and limit of d2 of odometry.
RULES = 0.999, 21.0
#: What odometry measures too much in a step in which the robot is carried.
CARRIED = np.array([6.0, 0.0, 3.0])
#: Steps in which it is: once, at two places, and for a time in which it observes landmarks.
ONCE, TWICE, FOR_SOME_TIME = [30], [20, 40], [12, 13, 14]


def local_map(seed):
    local, _ = Met(seed, [], steps=STEPS).maps
    return local


def carried(local, steps):
    """Return a map in which odometry is wrong in some steps."""
    odometry = local.problem.odometry
    z = odometry.z.copy()
    z[steps] = [compose(CARRIED, u) for u in z[steps]]
    return replace(local, problem=replace(local.problem, odometry=replace(odometry, z=z)))


def with_wrong_observations(local, is_wrong, error):
    factors = local.problem.landmarks
    z = factors.z + is_wrong[:, None] * error
    return replace(local, problem=replace(local.problem, landmarks=replace(factors, z=z)))


def with_scans_of_two(local):
    """Return a map with the observations of two landmarks from each pose, in turn."""
    factors = local.problem.landmarks
    is_kept = (factors.target - factors.pose) % 6 < 2
    return replace(local, problem=replace(
        local.problem, landmarks=rows_of(factors, np.flatnonzero(is_kept))))


def batch(local, steps):
    """Return all poses by dense least squares without the odometry of some steps."""
    odometry = local.problem.odometry
    R = np.broadcast_to(odometry.R, (STEPS, 3, 3)).copy()
    R[steps] *= 1e8
    return dense_minimum(
        replace(local.problem, odometry=replace(odometry, R=R)), local.values).poses


@pytest.mark.parametrize('steps', [ONCE, TWICE, FOR_SOME_TIME])
@pytest.mark.parametrize('seed', range(3))
def test_the_map_is_that_of_batch_least_squares_without_the_odometry_of_the_slip(seed, steps):
    local = local_map(seed)

    own = own_map(JointMap.unsolved(carried(local, steps)), *RULES)

    assert own.outliers == []
    released = {pose for begin, end in own.released.intervals for pose in range(begin, end)}
    assert released >= {*steps}
    # Of odometry that fits, 5 % between the slips is released too.
    assert len(released) <= len(steps) + 3
    error = own.joint.values.poses - batch(local, sorted(released))
    # What was slipped is one standard deviation of the released odometry, not 1e4 of them: that
    # moves poses by a few mm; by 11 mm where it is noise of three standard deviations. The noise
    # of an observation is 100 to 200 mm.
    assert np.abs(error).max() < 0.015


@pytest.mark.parametrize('seed', range(3))
def test_scans_that_are_too_small_to_show_a_slip_alone_are_used(seed):
    own = own_map(JointMap.unsolved(carried(with_scans_of_two(local_map(seed)), ONCE)), *RULES)

    assert own.outliers == []
    assert (ONCE[0], ONCE[0] + 1) in own.released.intervals


@pytest.mark.parametrize('seed', range(3))
def test_wrong_observations_are_left_out_beside_a_slip(seed):
    local = local_map(seed)
    is_wrong = np.random.default_rng(seed).random(len(local.problem.landmarks.z)) < 0.03

    own = own_map(JointMap.unsolved(carried(
        with_wrong_observations(local, is_wrong, [0.0, 8.0]), ONCE)), *RULES)

    assert (ONCE[0], ONCE[0] + 1) in own.released.intervals
    assert len(own.outliers) == is_wrong.sum()


def test_the_covariance_of_released_odometry_has_the_size_of_the_slip():
    local = local_map(0)

    own = own_map(JointMap.unsolved(carried(local, ONCE)), *RULES)

    R, before = own.joint.problem.odometry.R, local.problem.odometry.R[ONCE[0]]
    slip = CARRIED @ np.linalg.solve(before, CARRIED)
    # The frame of the slip, its begin or its end, and the noise of odometry change d2.
    assert R[ONCE[0], 2, 2] / before[2, 2] == pytest.approx(slip, rel=0.3)
    assert np.delete(R, ONCE, axis=0) == pytest.approx(np.delete(
        np.broadcast_to(local.problem.odometry.R, R.shape), ONCE, axis=0))


@pytest.mark.parametrize('seed', range(3))
def test_observations_that_are_wrong_for_a_while_are_left_out(seed):
    local = local_map(seed)
    poses = local.problem.landmarks.pose
    is_wrong = (poses >= 20) & (poses < 26)

    own = own_map(JointMap.unsolved(
        with_wrong_observations(local, is_wrong, [0.0, 8.0])), *RULES)

    assert own.released is None
    assert {outlier.pose for outlier in own.outliers} == {*range(20, 26)}


@pytest.mark.parametrize('seed', range(3))
def test_single_wrong_observations_release_no_odometry(seed):
    local = local_map(seed)
    is_wrong = np.random.default_rng(seed).random(len(local.problem.landmarks.z)) < 0.1

    own = own_map(JointMap.unsolved(
        with_wrong_observations(local, is_wrong, [0.0, 8.0])), *RULES)

    assert own.released is None
    assert len(own.outliers) == is_wrong.sum()
