# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Of several rendezvous of two maps, those that agree align them."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES
from fej_slam_ros.core.csam.map_merging import join_maps
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous_alignment import largest_agreement, RendezvousAligner
from fej_slam_ros.core.geometry import compose, inverse, transform, transform_poses
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS
from helpers.csam import joined_maps, Met, true_base_node, with_exact_odometry


def with_false_steps(team, steps):
    """Return the measurements, those at some steps as if the other map was 5 m away and turned."""
    p, q = team.maps
    false = compose(np.array([4.0, -3.0, 0.5]), true_base_node(team, 'r1', 'r2'))
    poses = {'r1': p.values.poses, 'r2': transform_poses(false, q.values.poses)}
    return [
        replace(m, z=transform(inverse(poses[m.observer][m.pose]), poses[m.observed][m.pose, :2]))
        if m.pose in steps else m for m in team.measurements]


SESSIONS = [range(3, 9), range(30, 36), range(60, 66)]


@pytest.mark.parametrize('wrong', [0, 1, 2])
def test_one_wrong_rendezvous_of_three_does_not_join_the_maps_whenever_it_was(wrong):
    met = [(0, 1, k) for session in SESSIONS for k in session]
    team = Met(9, met, steps=66)

    (joint,), failed, *_ = joined_maps(team.maps, with_false_steps(team, SESSIONS[wrong]))

    alone = [m for m in team.measurements if m.pose not in SESSIONS[wrong]]
    (expected,), *_ = joined_maps(team.maps, alone)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert [failure.robots for failure in failed] == [('r1', 'r2')]
    assert 'inconsistent' in failed[0].reason


def test_a_rendezvous_that_aligns_nothing_is_compared_with_no_other(monkeypatch):
    align, aligned = RendezvousAligner.align, []
    monkeypatch.setattr(
        RendezvousAligner, 'align',
        lambda aligner, p, q, measurements: aligned.append(measurements) or align(
            aligner, p, q, measurements))
    # Single observations, which determine no heading.
    team = Met(9, [(0, 1, k) for k in range(0, 60, 4)], steps=66)
    measured = [
        replace(m, stamp=30 * NS * k) for k, m in enumerate(team.measurements)]

    joined_maps(team.maps, measured)

    # Each by itself, and once more to be joined; each with each others would be over a hundred.
    assert len(aligned) <= 3 * len(measured)


# From 5 m on, the iteration does not converge with the wrong one.
@pytest.mark.parametrize('error', [(2.0, 0.0), (0.0, 5.0), (-20.0, 5.0), (100.0, 0.0)])
@pytest.mark.parametrize(('count', 'is_aligned'), [(9, False), (10, True)])
def test_one_observation_of_ten_may_be_wrong(count, is_aligned, error):
    team = Met(9, [(0, 1, k) for k in range(3, 3 + count)], steps=20)
    measured = [
        replace(m, z=m.z + np.array(error)) if m.pose == 5 else m for m in team.measurements]

    found = RendezvousAligner(measured, DEFAULT_RULES).align(
        *map(JointMap.of, team.maps), measured)

    assert isinstance(found, JoinFailure) != is_aligned
    if is_aligned:
        _, kept = found
        assert [m.pose for m in kept] == [3, 4, *range(6, 13)]


def test_three_rendezvous_that_agree_outvote_two_earlier_ones_with_one_lie():
    starts = range(3, 153, 30)
    team = Met(9, [(0, 1, k) for start in starts for k in range(start, start + 6)], steps=130)

    (joint,), failed, *_ = joined_maps(team.maps, with_false_steps(team, range(60)))

    true = [m for m in team.measurements if m.pose > 60]
    (expected,), *_ = joined_maps(team.maps, true)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert len(failed) > 0


def test_glimpses_that_align_nothing_take_no_part_in_the_vote():
    glimpses = [(0, 1, k) for k in range(3, 13, 2)]
    starts = range(20, 140, 30)
    team = Met(9, [*glimpses, *((0, 1, k) for a in starts for k in range(a, a + 6))], steps=120)
    apart = [
        replace(m, stamp=m.stamp - 1000 * NS * (20 - m.pose)) if m.pose < 20 else m
        for m in with_false_steps(team, range(20, 30))]

    (joint,), *_ = joined_maps(team.maps, apart)

    base_node = true_base_node(team, 'r1', 'r2')
    assert_allclose(joint.base_nodes(joint.information())['r2'].pose, base_node, atol=1.0)


def test_of_two_rendezvous_that_contradict_each_other_the_first_joins_the_maps():
    """Either may be wrong; the second is reported."""
    met = [(0, 1, k) for session in SESSIONS[:2] for k in session]
    team = Met(9, met, steps=40)

    (joint,), failed, *_ = joined_maps(team.maps, with_false_steps(team, SESSIONS[1]))

    (expected,), *_ = joined_maps(team.maps, [m for m in team.measurements if m.pose < 9])
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert [failure.robots for failure in failed] == [('r1', 'r2')]


def test_a_map_with_singular_information_stays_alone_while_the_others_are_joined():
    team = Met(9, [(a, 2, k) for a in (0, 1) for k in SESSIONS[0]], robots=3)
    p, q, r = map(JointMap.of, team.maps)
    without = replace(q, problem=JointMap.unsolved(with_exact_odometry(team.maps[1])).problem)

    maps, failed, *_ = join_maps([p, without, r], team.measurements)

    assert [joint.robots for joint in maps] == [('r1', 'r3'), ('r2',)]
    assert [failure.robots for failure in failed] == [('r2', 'r3')]
    assert 'cannot align' in failed[0].reason


P = np.diag([0.04, 0.04, 0.0025])


def base_nodes(seed, places):
    """Return base nodes near poses that are given by number."""
    rng = np.random.default_rng(seed)
    means = [np.array([5.0 * place, -place, np.pi - 0.01]) for place in places]
    return [BaseNode(wrapped(mean + rng.multivariate_normal(np.zeros(3), P)), P) for mean in means]


def wrapped(pose):
    """Return a pose whose heading is in the range of headings, near to its end."""
    return np.array([*pose[:2], (pose[2] + np.pi) % (2.0 * np.pi) - np.pi])


@pytest.mark.parametrize(('places', 'expected'), [
    ([0, 0, 0], (0, 1, 2)), ([1, 0, 0], (1, 2)), ([0, 1, 0, 1, 1], (1, 3, 4)),
    ([0, 1, 2], (0,)), ([0, 1, 0, 1], (0, 2)), ([], ())])
def test_the_largest_set_is_found_and_of_equal_ones_the_first(places, expected):
    assert largest_agreement(base_nodes(1, places), DEFAULT_RULES) == expected


def test_correct_base_nodes_agree_as_often_as_the_rules_state():
    """Three pairs of each of 3,000 triples: at most 9,000 times 1e-4 disagree by chance."""
    sets = [largest_agreement(base_nodes(seed, [0, 0, 0]), DEFAULT_RULES) for seed in range(3000)]

    assert sum(len(chosen) < 3 for chosen in sets) <= 4


def test_any_two_of_a_set_agree():
    """A chain of base nodes, each near the next one only."""
    chain = [BaseNode(np.array([0.9 * k, 0.0, 0.0]), P) for k in range(5)]

    chosen = largest_agreement(chain, DEFAULT_RULES)

    limit = np.sqrt(0.08 * DEFAULT_RULES.limit(3))
    assert len(chosen) == 2
    assert all(0.9 * (k - i) < limit for i, k in combinations(chosen, 2))
