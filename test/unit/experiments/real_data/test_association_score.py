# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of matches and false matches."""

from dataclasses import replace

from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.experiments.real_data.association_score import AssociationScore
from helpers.records import scan

#: True landmarks in four scans, and the numbers that were given.
TRUE = [(1, 2), (1, 2), (2, 1), (1, NO_ID)]
GIVEN = [(-2, -3), (-2, -3), (-2, -4), (-2, -3)]


def judged(true, given):
    """Return the matches of scans in which the k-th thing is at (k, 0)."""
    matches = AssociationScore()
    for step, (names, numbers) in enumerate(zip(true, given)):
        seen = scan('r1', step, [(n, (float(k), 0.0)) for k, n in enumerate(names)])
        unnamed = matches.without_ids(seen)
        assert {s.id for s in unnamed.observations} == {NO_ID}
        matches.add([replace(unnamed, observations=tuple(
            replace(s, id=n) for s, n in zip(unnamed.observations, numbers)))])
    return matches


def test_a_match_is_false_if_most_observations_with_its_id_are_of_another_landmark():
    matches = judged(TRUE, GIVEN)

    # Of the four with -2 one is of landmark 2; the one without a true ID is no match of -3.
    assert (matches.false(), matches.count()) == (1, 4)


def test_a_landmark_with_two_assigned_ids_is_counted_twice():
    assert judged(TRUE, GIVEN).landmarks([-2, -3, -4, -9]) == {1: 2, 2: 1, NO_ID: 1}
