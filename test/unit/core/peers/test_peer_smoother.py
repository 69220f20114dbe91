# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The trajectory of a robot continues from the solution of all that it knows of others."""

import numpy as np
from numpy.testing import assert_allclose

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.peers.peer_smoother import PeerSmoother
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.peers.union import smoothed_union
from helpers.records import odometry, scan, team

#: Landmarks around the straight path of the robot.
POINTS = {1: (4.0, 3.0), 2: (5.0, -2.0), 3: (1.0, -4.0)}


def seen(ms):
    """Return a scan from the true pose at a time, at 1 m/s along x."""
    return scan('r1', ms, [(id_, (x - ms / 1000.0, y)) for id_, (x, y) in POINTS.items()])


def moved(ms):
    return odometry('r1', ms, (ms / 1000.0, 0.0, 0.0))


def test_a_scan_that_was_in_flight_is_used_with_the_landmarks_known_before():
    settings = team('r1', 'r2')
    own = PeerSmoother(settings, 'r1', TeamLogs('r1', 1, settings.robots[0]), 10**9)
    central = TeamSmoother(settings)
    before = [record for ms in range(0, 3000, 100) for record in (seen(ms), moved(ms))]
    later = [seen(2850), *map(moved, range(3000, 3300, 100))]

    for record in before:
        own.add(record)
        list(own.take())
    task = own.union_task()
    for record in later:
        own.add(record)
        list(own.take())
    own.adopt_union(smoothed_union(task))
    for record in sorted([*before, *later], key=lambda record: record.stamp):
        central.add(record)
    list(central.release())
    central.adopt(solve(central.task()))

    newest, smoothed = own.trajectories['r1'].newest(), [*central.trajectories['r1'].estimates()]
    expected = next(of for of in smoothed if of.stamp == newest.stamp)
    # The filter linearises where it is, on a nearly noise-free path: a percent.
    assert_allclose(np.diag(newest.P), np.diag(expected.P), rtol=0.01)
