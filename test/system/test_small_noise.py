# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The less noise, the less the kinds of filter differ: they are one filter to first order.

Mutations, each tried once in a copy of the sources, that fail here: innovation of the first
iterate in all, H dx left out, each iterate added to the last one, owners of before a removal.
"""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.sim.environments import ENVIRONMENTS
from helpers.core import circles, estimate, pose_difference, whole_state

KINDS = ['standard', 'fej', 'ideal', 'invariant']
NOISES = np.array([1e-2, 1e-3, 1e-4])

#: Whether robots look for each other, and whether they share landmarks; where they do not, their
#: frames join by what they see of each other.
WORLDS = {
    'landmarks': (False, True), 'landmarks and robots': (True, True), 'joined': (True, False)}


def sensors(noise, meeting):
    """Return the sensors of [Liu] with all sigmas smaller, without or with those for robots."""
    of_paper = ENVIRONMENTS['circles'].sensors
    sigma = tuple(noise * np.array(of_paper.landmark_sigma))
    return replace(
        of_paper, odometry_sigma=tuple(noise * np.array(of_paper.odometry_sigma)),
        landmark_sigma=sigma, robot_sigma=sigma if meeting else None)


@cache
def final_estimates(noise, world):
    """Return poses and points of each kind of filter at the end of one loop."""
    meeting, shared = WORLDS[world]
    records = circles(seed=1, landmarks=20, sensors=sensors(noise, meeting))
    return {
        kind: whole_state(estimate(
            records, filter=kind, gate_probability=1.0, join_probability=1.0,
            shared_landmark_ids=shared)[0])
        for kind in KINDS}


@pytest.mark.parametrize('world', WORLDS)
@pytest.mark.parametrize(('one', 'other'), [*combinations(KINDS, 2)])
def test_the_differences_shrink_with_the_square_of_the_noise(one, other, world):
    differences = []
    for noise in NOISES:
        a, b = (final_estimates(noise, world)[kind] for kind in (one, other))
        assert len(a[0]) == len(b[0]) == 2
        differences.append([
            np.abs(pose_difference(a[0], b[0])).max(), np.abs(a[1] - b[1]).max()])

    slopes = np.diff(np.log(differences), axis=0) / np.diff(np.log(NOISES))[:, None]
    # Where the noise is largest the third order is 2 % of the second.
    assert_allclose(slopes, 2.0, atol=0.03)
