# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of trajectories: APE and RPE, as evo defines them, and the errors of landmarks.

APE is the distance of each pose from the truth at its stamp. RPE is what is wrong with the way
from one pose to another that comes a given length of the estimated path later; each such piece
begins where the one before has ended. A rigid motion of the whole estimate does not change RPE.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, rigid_fit, transform_poses, wrap_all
from fej_slam_ros.core.models import h_pose
from fej_slam_ros.evaluation.run_result import MatchedPoses


@dataclass(frozen=True, slots=True)
class Statistics:
    """What errors amount to; the unit is theirs."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


def statistics(errors: Array) -> Statistics:
    """Return what errors (n,), of which there are some, amount to."""
    return Statistics(
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
    Return by what pieces of the way are wrong, distances [m] and angles [rad], (m,) arrays.

    Parameters
    ----------
    poses, true : (n, 3) arrays
    length : of the estimated path in each piece, at least [m]

    """
    ends = _ends(poses[:, :2], length)
    estimated, actual = (h_pose(x[ends[:-1]], x[ends[1:]]) for x in (poses, true))
    wrong = h_pose(actual, estimated)
    return np.linalg.norm(wrong[:, :2], axis=1), np.abs(wrong[:, 2])


def fit(of: Iterable[MatchedPoses]) -> Array | None:
    """Return the pose (3,) that moves all estimated positions nearest to the true ones."""
    told = [*of]
    positions = np.vstack([np.empty((0, 2)), *(c.poses[:, :2] for c in told)])
    true = np.vstack([np.empty((0, 2)), *(c.true[:, :2] for c in told)])
    # What never moved tells no heading.
    if len(positions) < 2 or not np.ptp(true, axis=0).any():
        return None
    return rigid_fit(positions, true)


def aligned(poses: Array, alignment: Array | None) -> Array:
    """Return poses (n, 3) moved by an alignment (3,), NaN where there is none."""
    if alignment is None:
        return np.full_like(poses, np.nan)
    return transform_poses(alignment, poses)


def _ends(positions: Array, length: float) -> list[int]:
    """Return the indices at which the pieces of a way begin and end."""
    ends, gone = [0], 0.0
    for k, step in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1).tolist(), 1):
        gone += step
        if gone >= length:
            ends.append(k)
            gone = 0.0
    return ends
