# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What says the same has the same fingerprint, whatever order it is told in."""

from dataclasses import replace

import numpy as np
import pytest
from stream_helpers import robot_scan, scan

from fej_slam_ros.core.records import fingerprint, merged

ROBOTS = robot_scan('r1', 0, [('r2', (1.0, 2.0)), ('r3', (3.0, 4.0))])
LANDMARKS = scan('r1', 0, [(2, (1.0, 2.0)), (3, (3.0, 4.0))])


@pytest.mark.parametrize('seen', [ROBOTS, LANDMARKS])
def test_the_order_of_sightings_says_nothing(seen):
    turned = replace(seen, sightings=seen.sightings[::-1])

    assert fingerprint(turned) == fingerprint(seen)
    assert merged([turned]).sightings == seen.sightings


@pytest.mark.parametrize('change', [
    {'seen': 'r4'}, {'seen': 'r22'}, {'z': np.array([1.0, np.nextafter(2.0, 3.0)])},
    {'R': 0.02 * np.eye(2)}])
def test_who_was_seen_and_where_says_something(change):
    first, second = ROBOTS.sightings
    other = replace(ROBOTS, sightings=(replace(first, **change), second))

    assert len({fingerprint(r) for r in (ROBOTS, other, replace(ROBOTS, sightings=()))}) == 3
