# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GTSAM's incremental smoothers, if the extra ``benchmark`` is installed."""

from collections.abc import Sequence
import math
from typing import Any

import gtsam
import numpy as np

from fej_slam_ros.benchmark.synthetic_drive import DRIVE_ROBOTS, RobotEstimates
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
        self._isam: Any = self._smoother(_parameters(skip))
        self._poses: dict[str, tuple[int, Array]] = {}
        self._landmarks: dict[int, int] = {}  # keys by ID
        self._observed: dict[int, int] = {}  # stamps of their latest observations
        self._count = 0
        self._clear()

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> None:
        """Add a robot whose pose is known with covariance P (3, 3) in the next step."""
        key = self._key(name, stamp)
        self._graph.add(gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), _noise(P)))
        self._new.insert(key, gtsam.Pose2(*pose))
        self._poses[name] = key, pose

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Add the measurements of one stamp; return the robots' poses and covariances."""
        for motion in motions:
            self._add_motion(motion)
        for scan in scans:
            key, pose = self._poses[scan.robot]
            for observation in scan.observations:
                self._add_observation(key, pose, observation)
                self._observed[observation.id] = scan.stamp
        self._update()
        self._clear()
        estimates = {}
        for name, (key, _) in self._poses.items():
            x = self._isam.calculateEstimatePose2(key)
            pose = np.array([x.x(), x.y(), x.theta()])
            self._poses[name] = key, pose
            estimates[name] = pose, self._isam.marginalCovariance(key)
        return estimates

    def _smoother(self, parameters: gtsam.ISAM2Params) -> object:
        return gtsam.ISAM2(parameters)

    def _update(self) -> None:
        self._isam.update(self._graph, self._new)

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
        key = self._landmarks.get(observation.id)
        if key is None:
            key = self._landmarks[observation.id] = gtsam.symbol('l', self._count)
            self._count += 1
            self._new.insert(key, transform(pose, observation.z))
        self._graph.add(bearing_range_factor(pose_key, key, observation.z, observation.R))

    def _key(self, name: str, stamp: int) -> int:
        return gtsam.symbol(chr(ord('A') + DRIVE_ROBOTS.index(name)), stamp)


class FixedLag(Isam2):
    """
    The same over the latest steps only.

    Older poses are marginalised out, and so are landmarks that were not observed since: these are
    forgotten, and new ones when they are observed again.

    """

    def __init__(self, skip: int, lag: int) -> None:
        self._lag = lag  # in steps
        super().__init__(skip)

    def _smoother(self, parameters: gtsam.ISAM2Params) -> object:
        parameters.findUnusedFactorSlots = True
        return gtsam.IncrementalFixedLagSmoother(float(self._lag), parameters)

    def _update(self) -> None:
        now = max(self._observed.values())
        stamps = dict.fromkeys(self._new.keys(), now)
        stamps |= {self._landmarks[id_]: stamp for id_, stamp in self._observed.items()}
        self._isam.update(self._graph, self._new, stamps)
        for id_ in [id_ for id_, stamp in self._observed.items() if stamp < now - self._lag]:
            del self._observed[id_], self._landmarks[id_]


def bearing_range_factor(
    pose: int, point: int, z: Array, R: Array
) -> gtsam.BearingRangeFactor2D:
    """Return an observation z (2,) of a point by a pose, given by keys, with covariance R."""
    x, y = z.tolist()
    r = math.hypot(x, y)
    D = np.array([[-y / r ** 2, x / r ** 2], [x / r, y / r]])
    return gtsam.BearingRangeFactor2D(
        pose, point, gtsam.Rot2(math.atan2(y, x)), r, _noise(D @ R @ D.T))


def _parameters(skip: int) -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    parameters.relinearizeSkip = skip
    return parameters


def _noise(covariance: Array) -> gtsam.noiseModel.Gaussian:
    return gtsam.noiseModel.Gaussian.Covariance(covariance)
