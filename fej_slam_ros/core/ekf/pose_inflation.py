# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Inflation of the covariance of a robot that is farther from its estimate than that says.

After a slip of wheels, or an update that was linearised far from the true pose, most of a scan
fails the gate although its observations agree with each other. None of them corrects the pose, so
that the next scans fail, too, until the noise of odometry has made the covariance large enough. So
do single observations in a row, where a robot has few landmarks in view.
"""

from collections.abc import Callable, Sequence
import math

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.ekf.consecutive_rejections import ConsecutiveRejections, pairs
from fej_slam_ros.core.ekf.filter import Filter, Innovation
from fej_slam_ros.core.ekf.gating import Association, StatisticsByRobot
from fej_slam_ros.core.ekf.state import (
    JointState, Landmark, position_indices, Robot, Variables)
from fej_slam_ros.core.geometry import (
    Array, pose_difference, poses_plus, rigid_fit, rotation, transform)
from fej_slam_ros.core.models import F

#: Probability with which a correct scan counts as one that fits the map nowhere.
MISFIT_PROBABILITY = 1e-3
#: Largest error of the heading [rad]: a robot that is turned further is not located by an update
#: of first order, and two landmarks with exchanged IDs turn a pose by half a turn.
MAX_HEADING_ERROR = 0.6


def inflate_poses(
    filter_: Filter, innovation: Innovation, statistics: StatisticsByRobot,
    rejections: ConsecutiveRejections, may_have_slipped: Callable[[str], bool],
) -> None:
    """
    Inflate the covariance of robots most of whose scans failed the gate in an update.

    So are robots of which several observations in a row failed, unless their headings would be too
    uncertain to be linearised. Scans that contradict the estimate, whose observations fit the map
    under no pose, or whose robots have not slipped, are left to the detection of lost robots.

    """
    if not innovation.rejected:
        return
    state = filter_.state
    associations = [*innovation.used, *(gated.association for gated in innovation.rejected)]
    for name, scan in statistics.items():
        if scan.mostly_gated() and not scan.mostly_failed() and may_have_slipped(name):
            robot = state.robots[name]
            of_landmarks = [
                a for a in associations
                if a.observer is robot and isinstance(a.observed, Landmark)]
            pose = _fitted_pose(state, of_landmarks)
            if pose is not None:
                _inflate_to(state, robot, [a.observed for a in of_landmarks], pose)
    for gated in innovation.rejected:
        for robot, other in pairs(gated.association):
            factor = rejections.factor(robot.name)
            if factor > 1.0 and may_have_slipped(robot.name):
                relative = _relative_covariance(state, robot, [other])
                if math.sqrt(factor * relative[2, 2]) <= filter_.linearization.max_turn_sigma:
                    _inflate(state, robot, relative, factor)
                    rejections.forget(robot.name)


def _fitted_pose(state: JointState, scan: Sequence[Association]) -> Array | None:
    """Return the pose (3,) under which a scan fits the map, None if there is none."""
    _, landmarks, observations = zip(*scan)
    z = np.array([observation.z for observation in observations])
    f = state.estimates_of(position_indices(landmarks))
    pose = rigid_fit(z, f)
    C, expected = rotation(pose[2]), transform(pose, z)
    D = np.vstack([*map(F, expected - pose[:2])])
    S = state.marginal(landmarks) + block_diag(*(C @ o.R @ C.T for o in observations))
    L = np.linalg.cholesky(S)
    y, H = (solve_triangular(L, rows, lower=True) for rows in ((f - expected).ravel(), D))
    dx = np.linalg.lstsq(H, y, rcond=None)[0]
    chi2, dof = np.sum((y - H @ dx) ** 2), len(y) - len(dx)
    fitted: Array = poses_plus(pose[None], dx)[0]
    return fitted if chi2 <= chi_square_limit(dof, MISFIT_PROBABILITY) else None


def _inflate_to(state: JointState, robot: Robot, landmarks: Variables, pose: Array) -> None:
    """Make the squared distance of a robot from a pose (3,) in the map the expected one."""
    relative = _relative_covariance(state, robot, landmarks)
    error = pose_difference(pose, state.pose(robot))
    # A pose that is known exactly has no covariance.
    factor = float(error @ np.linalg.lstsq(relative, error, rcond=None)[0]) / len(error)
    if abs(error[2]) < MAX_HEADING_ERROR:
        _inflate(state, robot, relative, factor)


def _relative_covariance(state: JointState, robot: Robot, others: Variables) -> Array:
    """Return the covariance (3, 3) of a robot under the condition that others are known."""
    P = state.marginal([robot, *others])
    relative: Array = P[:3, :3] - P[:3, 3:] @ np.linalg.lstsq(
        P[3:, 3:], P[3:, :3], rcond=None)[0]
    return relative


def _inflate(state: JointState, robot: Robot, relative: Array, factor: float) -> None:
    """Multiply a part (3, 3) of the covariance of a robot by a factor, if that is above 1."""
    if factor > 1.0:
        state.covariance.propagate(robot.slot, np.eye(3), (factor - 1.0) * relative)
