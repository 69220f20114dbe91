# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two frames that share landmarks and rendezvous points."""

import numpy as np

from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.records import RendezvousKey
from helpers.core import turn


def two_maps(seed=1, noise=0.05, shared=4, g=(3.0, -2.0, 0.7)):
    """Return the states of a team and of a robot that share landmarks, and the frame's pose g."""
    rng, g = np.random.default_rng(seed), np.array(g)
    points = rng.uniform(-6.0, 6.0, (shared + 2, 2))
    team, group = JointState(), JointState()
    for state, name, seen, origin in (
        (team, 'r1', range(shared + 1), np.zeros(3)),
        (group, 'r2', [*range(shared), shared + 1], g),
    ):
        A = rng.normal(0.0, noise, (3, 3))
        robot = state.insert_robot(name, 5, rng.normal(0.0, noise, 3), A @ A.T)
        for number in seen:
            point = turn(origin[2]).T @ (points[number] - origin[:2])
            B = rng.normal(0.0, noise, (2, 2)) + noise * np.eye(2)
            state.augment(
                ('', number), robot, point + rng.multivariate_normal(np.zeros(2), B @ B.T),
                rng.normal(0.0, 1.0, (2, 3)), B @ B.T)
    # First estimates of their own, as after some updates.
    team.x_first = team.x_hat + rng.normal(0.0, noise, len(team.x_hat))
    group.x_first = group.x_hat + rng.normal(0.0, noise, len(group.x_hat))
    return team, group, g


def add_rendezvous_points(team, group, count):
    """Add positions of the robot of the group at some stamps to both states."""
    rng = np.random.default_rng(9)
    for stamp in range(count):
        key = RendezvousKey('r1', 'r2', stamp)
        for state, name in ((team, 'r1'), (group, 'r2')):
            state.augment_rendezvous_point(
                key, state.robots[name], rng.uniform(-6.0, 6.0, 2), rng.normal(size=(2, 3)),
                0.01 * np.eye(2))
