# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots with the same logs have the same union, whatever limits of their own input they have."""

from fej_slam_ros.core.peers.union import unsolved
from helpers.records import odometry, robot_scan, team


def test_the_union_does_not_depend_on_max_delay():
    """Nor where robots were silent for about the sum of it and stale_after."""
    measurements = [
        odometry('q', 2973), robot_scan('q', 3000, [('r', (1.0, 2.0))]), odometry('p', 3045),
        robot_scan('q', 3171, [('p', (1.0, 2.0))]), odometry('q', 3173), odometry('p', 3245),
        odometry('r', 3777), odometry('p', 5017), robot_scan('q', 5025, [('r', (1.0, 2.0))])]

    used = {
        tuple(m.stamp for m in unsolved(
            team('p', 'q', 'r', max_delay=max_delay), measurements).task().measurements)
        for max_delay in (0.0, 0.1, 0.5, 2.0)}

    assert used == {(3_171_000_000,)}
