# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fingerprints and merged scans do not depend on the order of observations."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.records import fingerprint, merged
from helpers.records import robot_scan, scan

ROBOTS = robot_scan('r1', 0, [('r2', (1.0, 2.0)), ('r3', (3.0, 4.0))])
LANDMARKS = scan('r1', 0, [(2, (1.0, 2.0)), (3, (3.0, 4.0))])


@pytest.mark.parametrize('seen', [ROBOTS, LANDMARKS])
def test_the_order_of_observations_does_not_change_the_fingerprint(seen):
    turned = replace(seen, observations=seen.observations[::-1])

    assert fingerprint(turned) == fingerprint(seen)
    assert merged([turned]).observations == seen.observations


@pytest.mark.parametrize('change', [
    {'observed': 'r4'}, {'observed': 'r22'}, {'z': np.array([1.0, np.nextafter(2.0, 3.0)])},
    {'R': 0.02 * np.eye(2)}])
def test_observed_robot_and_position_change_the_fingerprint(change):
    first, second = ROBOTS.observations
    other = replace(ROBOTS, observations=(replace(first, **change), second))

    assert len({fingerprint(r) for r in (ROBOTS, other, replace(ROBOTS, observations=()))}) == 3


def test_observations_without_id_are_last_in_the_given_order():
    seen = scan('r1', 0, [(-1, (9.0, 0.0)), (3, (1.0, 2.0)), (-1, (1.0, 0.0)), (2, (5.0, 5.0))])

    found = [(s.id, s.z[0]) for s in merged([seen]).observations]

    assert found == [(2, 5.0), (3, 1.0), (-1, 9.0), (-1, 1.0)]


def test_scans_of_one_stamp_merge_independently_of_their_order():
    one = scan('r1', 0, [(-1, (9.0, 0.0)), (-1, (2.0, 0.0))])
    other = scan('r1', 0, [(-1, (5.0, 0.0))])

    values = [
        [s.z[0] for s in merged(scans).observations] for scans in ([one, other], [other, one])]

    assert values[0] == values[1]
