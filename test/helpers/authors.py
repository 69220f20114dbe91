# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Reader of the stored runs of the authors of [Liu]: measurements and estimates.

Rows of measurements hold step, id and value, rows of the map id and value, x before y; results
are errors against the truth. r1 is given from step 1, r2 from step 0.
"""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import Motion, Observation, Scan, TrueLandmarks, TruePose


@dataclass
class AuthorsRun:
    """
    A run of the authors of [Liu]: measurements and estimates.

    Attributes
    ----------
    steps : K, so that stamps are 0 to K
    truth : ground truth
    anchor, P_anchor : initial pose of r1 and its covariance
    guess : initial guess of the pose of r2

    """

    data: dict

    def __post_init__(self):
        data = self.data
        self.steps = len(data['R1OdoSet']) // 3
        self.anchor, self.P_anchor = data['R1Xp0Set'][:, 0], np.diag(data['P_anchor_diag'])
        self.guess = {'r2': data['R2Xp0Set'][:, 0]}
        self.truth = RecordedTruth()
        self.truth.add(TrueLandmarks(dict(_pairs(data['XfTrueAll']))))
        self._Q = np.diag([data['sigma_u'], data['sigma_u'], data['sigma_phi']]) ** 2
        self._R = np.eye(2) * data['sigma_z'] ** 2
        self._u, self._observations = {}, {}
        for name, i in (('r1', 1), ('r2', 2)):
            positions = data[f'R{i}XrTrue'][:, 1].reshape(-1, 2)
            for stamp, (p, phi) in enumerate(zip(positions, data[f'R{i}XphiT'][:, 1])):
                self.truth.add(TruePose(name, stamp, np.array([*p, phi])))
            self._u[name] = data[f'R{i}OdoSet'][:, 2].reshape(-1, 3)
            self._observations[name] = _by_stamp(data[f'R{i}ObsSet'], self._R)

    def motions(self, stamp):
        """Return the motions of the robots to a stamp."""
        return [Motion(name, stamp, u[stamp - 1], self._Q) for name, u in self._u.items()]

    def scans(self, stamp):
        """Return the scans of the robots at a stamp."""
        return [
            Scan(name, stamp, tuple(observations.get(stamp, ())))
            for name, observations in self._observations.items()]

    def poses(self, kind):
        """Return the authors' estimates (K, 3) and (K + 1, 3) of the robots."""
        return {
            name: self._true_poses(name, first) + self.data[f'{kind}_DeltaR{i}Xp'][:, 1].reshape(
                -1, 3)
            for name, i, first in (('r1', 1, 1), ('r2', 2, 0))}

    def covariances(self, kind):
        """Return the covariances of these poses, (K, 3, 3) and (K + 1, 3, 3)."""
        return {
            name: self.data[f'{kind}_R{i}P'].reshape(-1, 3, 3)
            for name, i in (('r1', 1), ('r2', 2))}

    def landmarks(self, kind):
        """Return the IDs, the estimates (n, 2) and the covariance of the final map."""
        errors = _pairs(self.data[f'{kind}_DeltaXf'])
        points = [self.truth.landmarks[id_] + error for id_, error in errors]
        return [n for n, _ in errors], np.array(points), self.data[f'{kind}_Pf']

    def _true_poses(self, name, first):
        return np.array([self.truth.pose(name, k) for k in range(first, self.steps + 1)])


def authors_run(path):
    """Return the run in a file of the authors."""
    with np.load(path) as data:
        return AuthorsRun(dict(data))


def _pairs(rows):
    """Return (id, (2,) value) of rows (2 n, 2) that hold id and value, x before y."""
    return [(int(rows[k, 0]), rows[k:k + 2, 1]) for k in range(0, len(rows), 2)]


def _by_stamp(rows, R):
    """Return the observations at each stamp, of rows (2 m, 3) that hold stamp, id and value."""
    observations = {}
    for k in range(0, len(rows), 2):
        observations.setdefault(int(rows[k, 0]), []).append(
            Observation(int(rows[k, 1]), rows[k:k + 2, 2], R))
    return observations
