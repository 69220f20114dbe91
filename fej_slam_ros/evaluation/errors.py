# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
APE and RPE of trajectories, as evo defines them.

APE is the distance of each estimated pose from the true pose at its stamp. RPE is the error of the
relative pose between the ends of consecutive segments, each of a given length along the estimated
path; a rigid motion of the whole estimate does not change it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, rigid_fit, transform_poses, wrap_all
from fej_slam_ros.core.models import h_pose
from fej_slam_ros.evaluation.run_result import MatchedPoses


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of a series of errors, in their unit."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


def statistics(errors: Array) -> ErrorStatistics:
    """Return the statistics of errors (n,), n >= 1."""
    return ErrorStatistics(
        float(np.sqrt(np.mean(np.square(errors)))), float(np.mean(errors)),
        float(np.median(errors)), float(np.std(errors)), float(np.min(errors)),
        float(np.max(errors)))


def ape(poses: Array, true: Array) -> tuple[Array, Array]:
    """Return distances [m] and angles [rad], (n,) arrays, of poses (n, 3) from true ones."""
    return (
        np.linalg.norm(poses[:, :2] - true[:, :2], axis=1),
        np.abs(wrap_all(poses[:, 2] - true[:, 2])))


def rpe(poses: Array, true: Array, length: float) -> tuple[Array, Array]:
    """
    Return the errors of relative poses, distances [m] and angles [rad], (m,) arrays.

    Parameters
    ----------
    poses, true : (n, 3) arrays
    length : minimum length of a segment of the estimated path [m]

    """
    ends = _segment_ends(poses[:, :2], length)
    estimated, actual = (h_pose(x[ends[:-1]], x[ends[1:]]) for x in (poses, true))
    error = h_pose(actual, estimated)
    return np.linalg.norm(error[:, :2], axis=1), np.abs(error[:, 2])


def alignment(robots: Iterable[MatchedPoses]) -> Array | None:
    """Return the rigid motion (3,) that best fits all estimated positions to the true ones."""
    matched = [*robots]
    positions = np.vstack([np.empty((0, 2)), *(m.poses[:, :2] for m in matched)])
    true = np.vstack([np.empty((0, 2)), *(m.true[:, :2] for m in matched)])
    # Identical positions do not determine the heading.
    if len(positions) < 2 or not np.ptp(true, axis=0).any():
        return None
    return rigid_fit(positions, true)


def aligned_ape(matched: MatchedPoses, motion: Array) -> tuple[Array, Array]:
    """Return `ape` after a rigid motion (3,) of the estimated poses."""
    return ape(transform_poses(motion, matched.poses), matched.true)


def _segment_ends(positions: Array, length: float) -> list[int]:
    """Return the indices at which the segments of a path begin and end."""
    ends, travelled = [0], 0.0
    for k, step in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1).tolist(), 1):
        travelled += step
        if travelled >= length:
            ends.append(k)
            travelled = 0.0
    return ends
