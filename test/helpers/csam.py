# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small teams with local maps and rendezvous."""

from dataclasses import replace

import numpy as np

from fej_slam_ros.core.csam.map_merging import join_maps
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.csam.rendezvous_alignment import alignment_input
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.geometry import compose, transform
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from helpers.core import SmallTeam, turn, wrapped
from helpers.records import team

#: Covariance of robot-to-robot observations [m^2].
R_ROBOT = np.array([[4e-4, 1e-4], [1e-4, 2e-4]])


class Met:
    """
    Local maps and rendezvous of a small team.

    Attributes
    ----------
    maps, measurements : input of `join_maps`
    true_poses : (steps + 1, 3) array of each robot
    true_points : position of each landmark by its key

    """

    def __init__(self, seed, met, robots=2, steps=12, landmarks=6, noise=1.0, shared=False):
        """
        Simulate robots that observe all landmarks at every step.

        Parameters
        ----------
        met : (observer, observed, step) of robot-to-robot observations, robots by index
        shared : whether landmark IDs are the same for all robots

        """
        team = SmallTeam(seed, robots, landmarks, noise)
        self.maps, self.true_poses, self.true_points = [], {}, {}
        for name in team.names:
            smoother = IncrementalSmoother(team.look(name).observations)
            for k in range(1, steps + 1):
                motion = team.drive(name, k)
                smoother.add(motion.u, motion.Q, team.look(name).observations)
            smoother.solve()
            owner = '' if shared else name
            self.maps.append(LocalMap(
                name, smoother.problem(), smoother.values(),
                tuple((owner, id_) for id_ in smoother.landmark_index)))
            self.true_poses[name] = np.array([
                team.truth.pose(name, k) for k in range(steps + 1)])
            self.true_points |= {
                (owner, id_): point for id_, point in team.truth.landmarks.items()}
        rng = np.random.default_rng(seed)
        self.measurements = [
            self._measurement(team.names[a], team.names[b], k, noise, rng) for a, b, k in met]

    def _measurement(self, observer, observed, k, noise, rng):
        x, y = self.true_poses[observer][k], self.true_poses[observed][k]
        error = noise * rng.multivariate_normal(np.zeros(2), R_ROBOT)
        z = turn(x[2]).T @ (y - x)[:2] + error
        return RendezvousMeasurement(observer, k, observed, k, z, R_ROBOT, k * NS)


def joined_maps(maps, measurements):
    """Return the joined maps of robots, and the failures."""
    return join_maps([*map(JointMap.of, maps)], measurements)


def in_another_frame(local, frame):
    """Return a map in another frame, given the pose of its own frame in that."""
    values = Values(
        np.array([compose(frame, pose) for pose in local.values.poses]),
        transform(frame, local.values.points))
    return LocalMap(local.robot, local.problem, values, local.landmarks)


def with_exact_odometry(local):
    """Return a map with odometry of no covariance, of which there is no information."""
    odometry = replace(local.problem.odometry, R=np.zeros((3, 3)))
    return replace(local, problem=replace(local.problem, odometry=odometry))


def true_base_node(team, first, robot):
    """Return the true start of a robot in the frame of the start of the first one."""
    a, b = team.true_poses[first][0], team.true_poses[robot][0]
    return np.array([*(turn(a[2]).T @ (b - a)[:2]), wrapped(b[2] - a[2])])


def smoothed(records, settings=None, solved=True, **options):
    """Return a smoother after some records, and the poses that it yielded."""
    smoother, poses = TeamSmoother(settings or team(), **options), []
    for record in records:
        smoother.add(record)
        poses += smoother.take()
    poses += smoother.close()
    if solved:
        smoother.adopt(solve(smoother.task()))
    return smoother, poses


def rendezvous_of(maps, measurements):
    """Return the input of `align` for the local maps of two robots."""
    return alignment_input(
        *map(JointMap.of, maps), measurements, JointMap.rendezvous_information)
