# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GTSAM's incremental smoother iSAM2, if the extra ``benchmark`` is installed."""

from collections.abc import Sequence
import math

import gtsam
import numpy as np

from fej_slam_ros.benchmark.synthetic_drive import DRIVE_ROBOTS
from fej_slam_ros.core.geometry import Array, compose, transform
from fej_slam_ros.core.records import Motion, Observation, Scan


class Isam2:
    """
    iSAM2 with its default parameters except for relinearizeSkip.

    It keeps all poses, and searches for variables to relinearise in every `skip`-th update.
    Observations are GTSAM's bearing-range factors in C++, with the covariance of x and y
    propagated to bearing and range.
    """

    def __init__(self, skip: int) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = skip
        self._isam = gtsam.ISAM2(parameters)
        self._poses: dict[str, tuple[int, Array]] = {}
        self._landmarks: set[int] = set()
        self._clear()

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> None:
        """Add a robot whose pose is known with covariance P (3, 3) in the next step."""
        key = self._key(name, stamp)
        self._graph.add(gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), _noise(P)))
        self._new.insert(key, gtsam.Pose2(*pose))
        self._poses[name] = key, pose

    def step(
        self, motions: Sequence[Motion], scans: Sequence[Scan]
    ) -> dict[str, tuple[Array, Array]]:
        """Add the measurements of one stamp; return the robots' poses and covariances."""
        for motion in motions:
            self._add_motion(motion)
        for scan in scans:
            key, pose = self._poses[scan.robot]
            for observation in scan.observations:
                self._add_observation(key, pose, observation)
        self._isam.update(self._graph, self._new)
        self._clear()
        estimates = {}
        for name, (key, _) in self._poses.items():
            x = self._isam.calculateEstimatePose2(key)
            pose = np.array([x.x(), x.y(), x.theta()])
            self._poses[name] = key, pose
            estimates[name] = pose, self._isam.marginalCovariance(key)
        return estimates

    def _clear(self) -> None:
        self._graph, self._new = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def _add_motion(self, motion: Motion) -> None:
        last, pose = self._poses[motion.robot]
        key, predicted = self._key(motion.robot, motion.stamp), compose(pose, motion.u)
        increment = gtsam.Pose2(*motion.u)
        self._graph.add(gtsam.BetweenFactorPose2(last, key, increment, _noise(motion.Q)))
        self._new.insert(key, gtsam.Pose2(*predicted))
        self._poses[motion.robot] = key, predicted

    def _add_observation(self, pose_key: int, pose: Array, observation: Observation) -> None:
        key = gtsam.symbol('l', observation.id)
        if observation.id not in self._landmarks:
            self._landmarks.add(observation.id)
            self._new.insert(key, transform(pose, observation.z))
        x, y = observation.z.tolist()
        r = math.hypot(x, y)
        D = np.array([[-y / r ** 2, x / r ** 2], [x / r, y / r]])
        self._graph.add(gtsam.BearingRangeFactor2D(
            pose_key, key, gtsam.Rot2(math.atan2(y, x)), r, _noise(D @ observation.R @ D.T)))

    def _key(self, name: str, stamp: int) -> int:
        return gtsam.symbol(chr(ord('A') + DRIVE_ROBOTS.index(name)), stamp)


def _noise(covariance: Array) -> gtsam.noiseModel.Gaussian:
    return gtsam.noiseModel.Gaussian.Covariance(covariance)
