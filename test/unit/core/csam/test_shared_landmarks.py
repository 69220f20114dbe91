# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps with common landmarks are aligned by their covariances, which also estimates the noise."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES, JoinRules
from fej_slam_ros.core.csam.maps import JointMap, merged
from fej_slam_ros.core.csam.shared_landmarks import SharedLandmarks, variance_factor
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.point_consensus import OUTLIER_D2
from fej_slam_ros.core.smoothing.factors import Values
from helpers.csam import in_another_frame, Met, true_base_node


def maps(seed, robots=3, noise=1.0, landmarks=6):
    """Return the maps of a team that shares landmark IDs, each in its own frame."""
    team = Met(seed, (), robots, landmarks=landmarks, noise=noise, shared=True)
    return team, [JointMap.of(local) for local in team.maps]


def test_the_alignment_is_that_of_the_joint_minimum():
    _, (p, q, _) = maps(1)

    aligned = SharedLandmarks(p, q, 3).align()
    joint = merged(p, q, aligned.base_node).solved()

    # Chi-square of a linear problem; the curvature of these maps changes it by a few percent.
    assert aligned.dof == joint.dof - p.dof - q.dof
    assert aligned.chi_square == pytest.approx(
        joint.chi_square - p.chi_square - q.chi_square, rel=0.1)


def test_the_frame_of_a_map_changes_its_base_node_only():
    team, (p, q, _) = maps(1)
    frame = np.array([3.0, -4.0, 2.0])
    expected = SharedLandmarks(p, q, 3).align()

    aligned = SharedLandmarks(p, JointMap.of(in_another_frame(team.maps[1], frame)), 3).align()

    assert aligned.chi_square == pytest.approx(expected.chi_square, rel=1e-6)
    assert_allclose(compose(aligned.base_node, frame), expected.base_node, atol=1e-6)


def test_exact_maps_are_aligned_exactly():
    team, (p, q, _) = maps(2, noise=0.0)

    aligned = SharedLandmarks(p, q, 3).align()

    assert_allclose(aligned.base_node, true_base_node(team, 'r1', 'r2'), atol=1e-6)
    assert aligned.chi_square == pytest.approx(0.0, abs=1e-6)


def test_too_few_landmarks_do_not_align_maps():
    _, (p, q, _) = maps(3)

    others = tuple((('other', k),) for k in range(len(q.landmarks) - 2))
    failure = SharedLandmarks(p, replace(q, landmarks=q.landmarks[:2] + others), 3).align()

    assert isinstance(failure, JoinFailure)
    assert failure.reason == '2 shared landmarks, 3 are needed'


@pytest.mark.filterwarnings('error')
def test_landmarks_at_one_place_do_not_align_maps():
    _, (p, q, _) = maps(3)
    at_one_place = Values(q.values.poses, np.ones_like(q.values.points))

    failure = SharedLandmarks(p, replace(q, values=at_one_place), 3).align()

    assert 'shared landmarks is inf rad' in failure.reason


def test_the_factor_of_stated_noise_is_one_and_that_of_a_bias_above():
    white = [variance_factor(maps(seed, robots=4)[1], 3) for seed in range(10)]

    # Each the median of six means of chi-square over 9 degrees of freedom, not below 1.
    assert np.mean(white) < 1.3

    biased = []
    for seed in range(10):
        _, of_team = maps(seed, robots=4)
        # Each robot measures its own distances too long or too short by up to 5 %.
        for k, scale in enumerate((0.95, 1.05, 0.97, 1.03)):
            values = replace(of_team[k].values, points=scale * of_team[k].values.points)
            of_team[k] = replace(of_team[k], values=values)
        biased.append(variance_factor(of_team, 3))
    assert np.mean(biased) > 2.0


def test_the_limits_of_joining_grow_with_the_factor():
    rules = JoinRules(variance_factor=4.0)

    assert rules.limit(9) == 4.0 * DEFAULT_RULES.limit(9)
    assert rules.landmark_limit() == 4.0 * OUTLIER_D2


def test_a_single_wrong_map_does_not_change_the_factor():
    _, of_team = maps(5, robots=5)
    expected = variance_factor(of_team, 3)
    points = of_team[2].values.points + np.random.default_rng(1).normal(
        0.0, 3.0, of_team[2].values.points.shape)
    of_team[2] = replace(of_team[2], values=replace(of_team[2].values, points=points))

    # Four of ten pairs are with this map.
    assert variance_factor(of_team, 3) < 3.0 * expected


def test_a_landmark_that_some_robots_saw_elsewhere_does_not_change_the_factor():
    changes = []
    for seed in range(10):
        _, of_team = maps(seed, robots=4)
        expected = variance_factor(of_team, 3)
        for k in (0, 1):
            index = of_team[k].landmark_index()
            points = of_team[k].values.points.copy()
            points[index[min(index)]] += [3.0, 0.0]
            of_team[k] = replace(of_team[k], values=replace(of_team[k].values, points=points))
        changes.append(variance_factor(of_team, 3) / expected)

    # Four of six pairs have one contradicting landmark of six, left out with two of nine degrees.
    assert np.mean(changes) < 1.3


def test_two_robots_cannot_distinguish_noise_from_a_wrong_map():
    _, of_team = maps(6, robots=2)

    assert variance_factor(of_team, 3) == 1.0


def test_landmarks_that_contradict_all_others_do_not_change_the_factor():
    _, of_team = maps(7, landmarks=18)
    expected = variance_factor(of_team, 3)
    for k, of_robot in enumerate(of_team):
        points = of_robot.values.points.copy()
        points[11:] += np.random.default_rng(k).uniform(-5.0, 5.0, (7, 2))
        of_team[k] = replace(of_robot, values=replace(of_robot.values, points=points))

    assert variance_factor(of_team, 3) < 1.3 * expected
