# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batch least squares by GTSAM, if the extra ``benchmark`` is installed."""

from time import perf_counter

import gtsam
import numpy as np

from fej_slam_ros.benchmark.batch import MAX_ITERATIONS, RELATIVE_DECREASE, TimedSolution
from fej_slam_ros.benchmark.isam2 import bearing_range_factor
from fej_slam_ros.core.geometry import pose_rotation
from fej_slam_ros.core.smoothing.factors import concatenated, Values
from fej_slam_ros.core.smoothing.problem import Problem


def solve(problem: Problem, start: Values) -> TimedSolution:
    """Return the minimum that GTSAM reaches; its factors are created before the time begins."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = [gtsam.symbol('x', k) for k in range(len(start.poses))]
    points = [gtsam.symbol('l', k) for k in range(len(start.points))]
    for key, pose in zip(poses, start.poses):
        values.insert(key, gtsam.Pose2(*pose))
    for key, point in zip(points, start.points):
        values.insert(key, point)
    first, = problem.fixed_poses
    graph.add(gtsam.NonlinearEqualityPose2(poses[first], gtsam.Pose2(*start.poses[first])))
    odometry, landmarks = concatenated(problem.odometry), concatenated(problem.landmarks)
    for i, j, u, Q in zip(odometry.pose, odometry.target, odometry.z, odometry.R):
        # GTSAM has the error in the frame of the end.
        C = pose_rotation(u[2])
        graph.add(gtsam.BetweenFactorPose2(
            poses[i], poses[j], gtsam.Pose2(*u),
            gtsam.noiseModel.Gaussian.Covariance(C.T @ Q @ C)))
    for i, j, z, R in zip(landmarks.pose, landmarks.target, landmarks.z, landmarks.R):
        graph.add(bearing_range_factor(poses[i], points[j], z, R))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(RELATIVE_DECREASE)
    parameters.setMaxIterations(MAX_ITERATIONS)

    begin = perf_counter()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    found = optimizer.optimize()
    seconds = perf_counter() - begin
    poses_found = map(found.atPose2, poses)
    return TimedSolution(
        Values(
            np.array([(x.x(), x.y(), x.theta()) for x in poses_found]),
            np.array([found.atPoint2(key) for key in points]).reshape(-1, 2)),
        seconds, optimizer.iterations())
