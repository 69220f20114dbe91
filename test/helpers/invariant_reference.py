# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Textbook right-invariant EKF, which keeps its covariance in the error coordinates.

The state of a robot and of the n landmarks that it observed first is one matrix of SE_n+1(2),

    X = [C  p  f_1 ... f_n; 0  I],    the truth is exp(xi^) X,    xi^ = [theta J  xi_p ...; 0  0],

so that to first order xi_p = p_true - p - J p theta and the same of each f. Motions then leave xi
alone, Phi = I, whatever the estimate; and so does a turn of everything but for all theta alike.
It is slow: a motion adds noise to every landmark of the robot.
"""

import numpy as np
from scipy.linalg import block_diag, expm

J = np.array([[0.0, -1.0], [1.0, 0.0]])


class InvariantReference:
    """
    The filter, dense and with the matrix exponential.

    Parameters
    ----------
    starts : (name, pose, covariance in plain coordinates) of each robot
    iterations : of Gauss-Newton in xi at each update

    Attributes
    ----------
    groups : for each robot its X
    P : covariance of xi, in which each robot has (xi_p, theta) and each landmark xi_f

    """

    def __init__(self, starts, iterations=1):
        self._iterations = iterations
        self.groups, self._places, self._owners = {}, {}, {}
        for name, pose, _ in starts:
            self.groups[name] = np.eye(3)
            self.groups[name][:2, :2] = expm(pose[2] * J)
            self.groups[name][:2, 2] = pose[:2]
            self._enter(name, name, 2, 3)
        self.P = block_diag(*(P for *_, P in starts))
        to_xi = np.linalg.inv(self._plain_by_xi())
        self.P = to_xi @ self.P @ to_xi.T

    def step(self, motions, scans, meetings):
        """Predict, start landmarks, update."""
        for motion in motions:
            self._predict(motion)
        seen = []
        for scan in scans:
            for observation in scan.observations:
                if observation.id in self._places:
                    seen.append((scan.robot, observation.id, observation))
                else:
                    self._start(scan.robot, observation)
        seen += [(scan.robot, s.observed, s) for scan in meetings for s in scan.observations]
        if seen:
            self._update(seen)

    def poses(self):
        """Return the pose of each robot."""
        return [
            np.array([*X[:2, 2], np.arctan2(X[1, 0], X[0, 0])]) for X in self.groups.values()]

    def points(self):
        """Return the landmarks in the order of their first observation."""
        return [self._point(key) for key in self._places if key not in self.groups]

    def plain_covariance(self):
        """Return the covariance of plain errors, in the order in which variables were added."""
        by_xi = self._plain_by_xi()
        return by_xi @ self.P @ by_xi.T

    def _enter(self, key, owner, column, size):
        n = max((place.stop for place, _ in self._places.values()), default=0)
        self._places[key], self._owners[key] = (slice(n, n + size), column), owner

    def _point(self, key):
        return self.groups[self._owners[key]][:2, self._places[key][1]].copy()

    def _position(self, key):
        """Return the indices of the two coordinates of a robot or landmark in xi."""
        start = self._places[key][0].start
        return slice(start, start + 2)

    def _theta(self, key):
        """Return the index of the heading error of the owner in xi."""
        return self._places[self._owners[key]][0].stop - 1

    def _plain_by_xi(self):
        """Return d(plain error) / d(xi): p_true - p = xi_p + J p theta."""
        matrix = np.eye(len(self.P))
        for key in self._places:
            matrix[self._position(key), self._theta(key)] = J @ self._point(key)
        return matrix

    def _predict(self, motion):
        X = self.groups[motion.robot]
        C = X[:2, :2].copy()
        X[:2, 2] += C @ motion.u[:2]
        X[:2, :2] = C @ expm(motion.u[2] * J)
        B = np.zeros((len(self.P), 3))
        B[self._position(motion.robot), :2] = C
        B[self._theta(motion.robot), 2] = 1.0
        for key, owner in self._owners.items():
            if owner == motion.robot:
                B[self._position(key), 2] = -J @ self._point(key)
        self.P = self.P + B @ motion.Q @ B.T

    def _start(self, robot, observation):
        X = self.groups[robot]
        C, n = X[:2, :2], len(self.P)
        grown = np.eye(len(X) + 1)
        grown[:len(X), :len(X)] = X
        grown[:2, -1] = X[:2, 2] + C @ observation.z
        A = np.vstack([np.eye(n), np.eye(n)[self._position(robot)]])
        self.P = A @ self.P @ A.T
        self.P[n:, n:] += C @ observation.R @ C.T
        self.groups[robot] = grown
        self._enter(observation.id, robot, len(X), 2)

    def _update(self, seen):
        prior, xi = self.groups, np.zeros(len(self.P))
        R = block_diag(*(observation.R for *_, observation in seen))
        for _ in range(self._iterations):
            H = np.vstack([self._H(observer, observed) for observer, observed, _ in seen])
            r = np.concatenate([
                observation.z - self.groups[observer][:2, :2].T @ (
                    self._point(observed) - self._point(observer))
                for observer, observed, observation in seen])
            K = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
            xi = K @ (r + H @ xi)
            self.groups = {
                name: expm(self._wedge(name, xi)) @ X for name, X in prior.items()}
        A = np.eye(len(xi)) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T

    def _H(self, observer, observed):
        """Return C^T [xi_observed - xi_observer + J p_observed (theta_owner - theta_observer)]."""
        H = np.zeros((2, len(self.P)))
        H[:, self._position(observed)] += np.eye(2)
        H[:, self._position(observer)] -= np.eye(2)
        H[:, self._theta(observed)] += J @ self._point(observed)
        H[:, self._theta(observer)] -= J @ self._point(observed)
        return self.groups[observer][:2, :2].T @ H

    def _wedge(self, name, xi):
        wedge = np.zeros_like(self.groups[name])
        wedge[:2, :2] = xi[self._theta(name)] * J
        for key, owner in self._owners.items():
            if owner == name:
                wedge[:2, self._places[key][1]] = xi[self._position(key)]
        return wedge
