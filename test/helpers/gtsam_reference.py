# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same problems as factors of GTSAM, with independent residuals and Jacobians."""

import gtsam
import numpy as np
from numpy.testing import assert_allclose
import pytest

from helpers.core import pose_difference, quarter_turn, turn, wrapped

#: More than Gauss-Newton needs from the truth.
ITERATIONS = 15


class Reference:
    """
    Minimum of GTSAM from a start, and its covariances, in plain coordinates.

    Attributes
    ----------
    poses, points : the minimum, by index
    cost : its chi-square

    """

    def __init__(self, problem, start):
        self._fixed = {pose: start.poses[pose] for pose in problem.fixed_poses}
        self._graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for pose in set(range(len(start.poses))) - self._fixed.keys():
            values.insert(pose_key(pose), start.poses[pose])
        for landmark, point in enumerate(start.points):
            values.insert(landmark_key(landmark), point)
        self._add_factors(problem)
        optimizer = gtsam.GaussNewtonOptimizer(self._graph, values)
        for _ in range(ITERATIONS):
            optimizer.iterate()
        self._values = optimizer.values()
        self._marginals = gtsam.Marginals(self._graph, self._values)
        self.cost = 2.0 * self._graph.error(self._values)
        self.poses = np.array([
            self._value(self._values, pose_key(k)) for k in range(len(start.poses))])
        self.points = np.array([
            self._values.atVector(landmark_key(k)) for k in range(len(start.points))])

    def joint(self, poses, points):
        """Return the joint covariance of free poses, then landmarks."""
        keys = [*map(pose_key, poses), *map(landmark_key, points)]
        joint = self._marginals.jointMarginalCovariance(keys)
        return np.block([[joint.at(a, b) for b in keys] for a in keys])

    def covariance(self, key):
        """Return the marginal covariance of a free variable."""
        return self._marginals.marginalCovariance(key)

    def _add_factors(self, problem):
        odometry, landmarks, rendezvous = problem.odometry, problem.landmarks, problem.rendezvous
        for begin, end, u, Q in each(
                odometry.pose, odometry.target, odometry.z, odometry.R):
            self._add(increment(u), Q, pose_key(begin), pose_key(end))
        for pose, landmark, z, R in each(
                landmarks.pose, landmarks.target, landmarks.z, landmarks.R):
            self._add(observation(z, 2), R, pose_key(pose), landmark_key(landmark))
        for pose, other, z, R in each(
                rendezvous.pose, rendezvous.target, rendezvous.z, rendezvous.R):
            self._add(observation(z, 3), R, pose_key(pose), pose_key(other))

    def _add(self, residual, covariance, *keys):
        free = [key for key in keys if key not in map(pose_key, self._fixed)]

        def error(_factor, values, jacobians):
            e, by_key = residual(*(self._value(values, key) for key in keys))
            if jacobians is not None:
                for k, key in enumerate(free):
                    jacobians[k] = by_key[keys.index(key)]
            return e

        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._graph.add(gtsam.CustomFactor(noise, free, error))

    def _value(self, values, key):
        fixed = {pose_key(pose): x for pose, x in self._fixed.items()}
        return fixed[key] if key in fixed else values.atVector(key)


def pose_key(number):
    return gtsam.symbol('x', int(number))


def landmark_key(number):
    return gtsam.symbol('l', int(number))


def each(first, second, values, covariance):
    """Yield measurements one by one; a single covariance holds for all."""
    shape = (len(values), *covariance.shape[-2:])
    return zip(first, second, values, np.broadcast_to(covariance, shape))


def increment(u):
    def residual(begin, end):
        Ct, d = turn(begin[2]).T, end[:2] - begin[:2]
        by_begin, by_end = -np.eye(3), np.eye(3)
        by_begin[:2, :2], by_begin[:2, 2], by_end[:2, :2] = -Ct, -Ct @ quarter_turn(d), Ct
        return np.array([*(Ct @ d - u[:2]), wrapped(end[2] - begin[2] - u[2])]), (by_begin, by_end)
    return residual


def observation(z, size):
    """Return the residual of an observation of a landmark (size 2) or of a pose (size 3)."""
    def residual(pose, observed):
        Ct, d = turn(pose[2]).T, observed[:2] - pose[:2]
        by_pose = np.column_stack([-Ct, -Ct @ quarter_turn(d)])
        by_observed = np.zeros((2, size))
        by_observed[:, :2] = Ct
        return Ct @ d - z, (by_pose, by_observed)
    return residual


def assert_is_minimum(joint, reference):
    """Check a joint map and all its covariances against those of gtsam."""
    assert joint.chi_square == pytest.approx(reference.cost, rel=1e-9)
    assert_allclose(pose_difference(joint.values.poses, reference.poses), 0.0, atol=1e-8)
    assert_allclose(joint.values.points, reference.points, rtol=0.0, atol=1e-8)
    poses, points = joint.information().marginals()
    keys = [*map(pose_key, range(1, len(poses))), *map(landmark_key, range(len(points)))]
    for P, key in zip([*poses[1:], *points], keys):
        expected = reference.covariance(key)
        assert_allclose(P, expected, rtol=1e-8, atol=1e-8 * expected.max())
