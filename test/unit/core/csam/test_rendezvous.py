# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robot-to-robot observations, grouped into rendezvous of two robots."""

from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous import rendezvous_of
from helpers.csam import Met


def test_robots_that_observe_each_other_and_share_landmarks_have_one_rendezvous():
    """Its robots are in the order of the maps, whoever observed first and whatever their names."""
    team = Met(9, [(0, 1, 3), (1, 0, 3), (1, 0, 4), (0, 1, 5)], shared=True)
    maps = [JointMap.of(local) for local in reversed(team.maps)]

    rendezvous, = rendezvous_of(maps, team.measurements)

    assert rendezvous.robots == ('r2', 'r1')
    assert rendezvous.measurements == team.measurements
