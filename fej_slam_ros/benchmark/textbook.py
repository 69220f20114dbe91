# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The standard EKF in textbook form, with every matrix of the size of the state.

For comparison only: F P F^T, the inverse of S, the gain, and Joseph's form.
"""

from collections.abc import Sequence

import numpy as np

from fej_slam_ros.benchmark.synthetic_drive import RobotEstimates
from fej_slam_ros.core import models
from fej_slam_ros.core.geometry import Array, wrap
from fej_slam_ros.core.records import Motion, Observation, Scan

#: Slots of robot and landmark in the state, and the observation.
KnownObservation = tuple[int, int, Observation]


class Textbook:
    """An EKF over robots and landmarks, which are added at their first observation."""

    def __init__(self) -> None:
        self._x: Array = np.empty(0)
        self._P: Array = np.empty((0, 0))
        self._robots: dict[str, int] = {}
        self._landmarks: dict[int, int] = {}

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> None:
        """Add a robot whose pose is known with covariance P (3, 3)."""
        n = self._robots[name] = len(self._x)
        self._x = np.append(self._x, pose)
        self._P = np.block([[self._P, np.zeros((n, 3))], [np.zeros((3, n)), P]])

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Predict, start landmarks, update; return the robots' poses and covariances."""
        self._predict(motions)
        known = []
        for scan in scans:
            robot = self._robots[scan.robot]
            for observation in scan.observations:
                if observation.id in self._landmarks:
                    known.append((robot, self._landmarks[observation.id], observation))
                else:
                    self._start_landmark(robot, observation)
        if known:
            self._update(known)
        return {
            name: (self._x[i:i + 3].copy(), self._P[i:i + 3, i:i + 3].copy())
            for name, i in self._robots.items()}

    def _predict(self, motions: Sequence[Motion]) -> None:
        F, Q = np.eye(len(self._x)), np.zeros_like(self._P)
        for motion in motions:
            i = self._robots[motion.robot]
            x = self._x[i:i + 3]
            x_pred, G = models.f(x, motion.u), models.G(x[2])
            F[i:i + 3, i:i + 3] = models.Phi(x_pred[:2] - x[:2])
            Q[i:i + 3, i:i + 3] = G @ motion.Q @ G.T
            self._x[i:i + 3] = x_pred
        self._P = F @ self._P @ F.T + Q

    def _start_landmark(self, robot: int, observation: Observation) -> None:
        n = self._landmarks[observation.id] = len(self._x)
        x = self._x[robot:robot + 3]
        C = models.G(x[2])[:2, :2]
        F = np.zeros((2, n))
        F[:, robot:robot + 3] = models.F(C @ observation.z)
        cross = F @ self._P
        self._x = np.append(self._x, x[:2] + C @ observation.z)
        self._P = np.block([
            [self._P, cross.T], [cross, cross @ F.T + C @ observation.R @ C.T]])

    def _update(self, known: Sequence[KnownObservation]) -> None:
        m, n = len(known), len(self._x)
        H, R, r = np.zeros((2 * m, n)), np.zeros((2 * m, 2 * m)), np.empty(2 * m)
        for k, (robot, landmark, observation) in enumerate(known):
            rows = slice(2 * k, 2 * k + 2)
            pose, point = self._x[None, robot:robot + 3], self._x[None, landmark:landmark + 2]
            block = models.H(pose, point)[0]
            H[rows, robot:robot + 3], H[rows, landmark:landmark + 2] = block[:, :3], block[:, 3:]
            R[rows, rows] = observation.R
            r[rows] = observation.z - models.h(pose, point)[0]
        K = self._P @ H.T @ np.linalg.inv(H @ self._P @ H.T + R)
        A = np.eye(n) - K @ H
        self._x = self._x + K @ r
        self._P = A @ self._P @ A.T + K @ R @ K.T
        for i in self._robots.values():
            self._x[i + 2] = wrap(self._x[i + 2])
