# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that only others observe is found after its wheels slipped."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.smoothing.factors import concatenated, rows_of, Values
from fej_slam_ros.core.smoothing.problem import Problem
from helpers.csam import joined_maps, Met
from helpers.slow import slow
from helpers.smoothing import dense_minimum

STEPS = 45
#: Rows of the odometry of r3 in which its wheels slip, and what they measure too much.
SLIP = slice(12, 15)
TOO_MUCH = [1.0, 0.0, 0.6]
#: Who observes r3 when: r1 all the time, or r1 before the slip and r2 after it.
ALWAYS = [(0, 2, k) for k in range(3, 43)]
TWICE = [*((0, 2, k) for k in range(1, 11)), *((1, 2, k) for k in range(17, 40))]


def without_landmarks(local):
    """Return the map of a robot that observes no landmarks."""
    none = rows_of(local.problem.landmarks, np.array([], np.intp))
    return LocalMap(
        local.robot, replace(local.problem, landmarks=none),
        Values(local.values.poses, np.zeros((0, 2))), ())


def team_of(seed, met):
    """Return a team of which r3 only is observed, and slips."""
    team = Met(seed, met, robots=3, steps=STEPS, shared=True)
    team.maps[2] = without_landmarks(team.maps[2])
    team.maps[2].problem.odometry.z[SLIP] += TOO_MUCH
    return team


def batch(joint, team):
    """Return all poses by dense least squares over all measurements but odometry in the slip."""
    problem, first = joint.problem, joint.first_poses
    odometry = concatenated(*(
        replace(
            local.problem.odometry, pose=local.problem.odometry.pose + first[local.robot],
            target=local.problem.odometry.target + first[local.robot]) for local in team.maps))
    slipped = (odometry.pose >= first['r3'] + SLIP.start) & (
        odometry.pose < first['r3'] + SLIP.stop)
    odometry.R[slipped] *= 1e8
    everything = Problem(odometry, problem.landmarks, problem.rendezvous)
    return dense_minimum(everything, joint.values).poses


@pytest.mark.parametrize('met', [ALWAYS, TWICE])
@pytest.mark.parametrize('seed', [slow(0), 1, slow(2)])
def test_after_a_slip_the_robot_is_where_batch_least_squares_without_that_odometry_is(seed, met):
    team = team_of(seed, met)

    (joint,), failed, _, (released,), _ = joined_maps(team.maps, team.measurements)

    assert failed == []
    (begin, end), = released.intervals
    assert begin <= SLIP.start
    assert SLIP.stop <= end
    own = joint.poses_of('r3')
    error = joint.values.poses[own] - batch(joint, team)[own]
    # The slip is one standard deviation of the released odometry, not 1e4 of them: that moves
    # observed poses by a few mm, a tenth of the noise of an observation.
    assert np.abs(error[[k for _, _, k in met], :2]).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
def test_observations_that_are_wrong_for_a_while_are_left_out(seed):
    team = team_of(seed, ALWAYS)
    team.maps[2].problem.odometry.z[SLIP] -= TOO_MUCH
    wrong = [
        replace(m, z=m.z + np.array([0.0, 2.0])) if 20 <= m.pose < 32 else m
        for m in team.measurements]

    _, failed, _, released, _ = joined_maps(team.maps, wrong)

    assert released == []
    assert len(failed) == 1


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
def test_of_two_robots_without_landmarks_none_is_taken_as_the_one_that_slipped(seed):
    team = team_of(seed, ALWAYS)
    maps = [without_landmarks(team.maps[0]), team.maps[2]]

    joints, failed, _, released, _ = joined_maps(maps, team.measurements)

    assert (len(joints), released) == (2, [])
    assert [failure.robots for failure in failed] == [('r1', 'r3')]
