# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
APE and RPE of trajectories, as evo defines them.

APE is the distance of each estimated pose from the true pose at its stamp. RPE is the error of the
relative pose of the ends of each segment of the estimated path; it needs no alignment.
"""

from collections.abc import Iterable

import numpy as np

from fej_slam_ros.core.geometry import Array, pose_difference, rigid_fit, transform_poses
from fej_slam_ros.core.models import h_pose
from fej_slam_ros.evaluation.run_result import MatchedPoses


def statistics(errors: Array) -> dict[str, float]:
    """Return the statistics of errors (n,), n >= 1, in their unit."""
    return {
        'rmse': float(np.sqrt(np.mean(np.square(errors)))), 'mean': float(np.mean(errors)),
        'median': float(np.median(errors)), 'std': float(np.std(errors)),
        'min': float(np.min(errors)), 'max': float(np.max(errors))}


def ape(matched: MatchedPoses, motion: Array | None = None) -> tuple[Array, Array]:
    """Return APE [m] and [rad], (n,) arrays, after a rigid motion (3,) of the estimated poses."""
    poses = matched.poses if motion is None else transform_poses(motion, matched.poses)
    return _magnitudes(pose_difference(poses, matched.true))


def rpe(matched: MatchedPoses, length: float) -> tuple[Array, Array]:
    """Return RPE [m] and [rad], (m,) arrays, over segments of at least a length [m]."""
    ends = _segment_ends(matched.poses[:, :2], length)
    estimated, actual = (h_pose(x[ends[:-1]], x[ends[1:]]) for x in (matched.poses, matched.true))
    return _magnitudes(h_pose(actual, estimated))


def alignment(robots: Iterable[MatchedPoses]) -> Array | None:
    """Return the rigid motion (3,) that best fits all estimated positions to the true ones."""
    matched = [*robots]
    positions = np.vstack([np.empty((0, 2)), *(m.poses[:, :2] for m in matched)])
    true = np.vstack([np.empty((0, 2)), *(m.true[:, :2] for m in matched)])
    # Identical positions do not determine the heading.
    if len(positions) < 2 or not np.ptp(true, axis=0).any():
        return None
    return rigid_fit(positions, true)


def _magnitudes(errors: Array) -> tuple[Array, Array]:
    return np.linalg.norm(errors[:, :2], axis=1), np.abs(errors[:, 2])


def _segment_ends(positions: Array, length: float) -> list[int]:
    ends, travelled = [0], 0.0
    for k, step in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1).tolist(), 1):
        travelled += step
        if travelled >= length:
            ends.append(k)
            travelled = 0.0
    return ends
