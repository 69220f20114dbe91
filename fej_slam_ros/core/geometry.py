# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Planar geometry: angles, rotations and poses [x, y, phi] in m, m, rad.

The pose of frame b in frame a is also the transform T_a_b of coordinates from b to a:
``compose(T_a_b, T_b_c)`` is ``T_a_c``.
"""

from bisect import bisect_left
from collections.abc import Sequence
import math
from operator import attrgetter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Stamps = NDArray[np.int64]  #: [ns]


def wrap(angle: float) -> float:
    """Return the angle [rad] in (-pi, pi]; an angle already there keeps every bit."""
    if -math.pi < angle <= math.pi:
        return angle
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))


def wrap_all(angles: Array) -> Array:
    """Return an array of angles [rad], each in (-pi, pi]."""
    inside = (angles > -np.pi) & (angles <= np.pi)
    if inside.all():
        return angles.copy()
    turns = np.ceil((angles - np.pi) / (2.0 * np.pi))
    return np.where(inside, angles, angles - 2.0 * np.pi * turns)


def rotation(phi: float) -> Array:
    """Return C(phi), the (2, 2) rotation matrix of an angle phi [rad]."""
    c, s = math.cos(phi), math.sin(phi)
    return np.array([[c, -s], [s, c]])


def rotations(angles: Array) -> Array:
    """Return the rotation matrices (n, 2, 2) of angles (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    return np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)


def products(matrices: Array, vectors: Array) -> Array:
    """Return matrices (n, 2, 2) times vectors (n, 2), an (n, 2) array."""
    products: Array = np.einsum('nij,nj->ni', matrices, vectors)
    return products


def pose_rotation(phi: float) -> Array:
    """Return blkdiag(C(phi), 1), which rotates the position part of a pose error."""
    c, s = math.cos(phi), math.sin(phi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def perpendicular(vectors: Array) -> Array:
    """
    Return J v for each vector v of a (..., 2) array.

    J = [[0, -1], [1, 0]] of eq. (5) of [Liu] generates rotations: d C(phi) / d phi = J C(phi).

    """
    turned = np.empty_like(vectors)
    turned[..., 0] = -vectors[..., 1]
    turned[..., 1] = vectors[..., 0]
    return turned


def mean_rotation(theta: Array, angle_of: Indices, vectors: Array) -> Array:
    """
    Return V(theta) v of vectors (m, 2), where V is the mean of C over the angles from 0 to theta.

    The angle [rad] of each vector is theta (k,) at its index `angle_of` (m,).

    """
    along = np.sinc(theta / np.pi)[angle_of, None]
    # (1 - cos theta) / theta
    across = (0.5 * theta * np.sinc(0.5 * theta / np.pi) ** 2)[angle_of, None]
    return along * vectors + across * perpendicular(vectors)


def upper_triangular(upper: Sequence[float] | Array) -> Array:
    """Return the matrix with some numbers, row by row, in its upper triangle and zeros below."""
    size = math.isqrt(2 * len(upper))
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix


def symmetric(upper: Sequence[float] | Array) -> Array:
    """Return the symmetric matrix with some numbers, row by row, in its upper triangle."""
    matrix = upper_triangular(upper)
    return matrix + np.triu(matrix, 1).T


def ellipse(P: Array) -> tuple[float, float, float]:
    """Return semi-major and semi-minor axis and angle [rad] of the 1-sigma ellipse of P (2, 2)."""
    variances, axes = np.linalg.eigh(P)
    # An eigenvalue 0 of an exactly known position may be rounded to below zero.
    minor, major = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return major, minor, math.atan2(axes[1, 1], axes[0, 1])


def compose(a: Array, b: Array) -> Array:
    """Return a o b, the pose b of frame a in the parent frame of a."""
    # Arithmetic with Python's floats gives the same bits in a third of numpy's time.
    (x_a, y_a, phi_a), (x_b, y_b, phi_b) = a.tolist(), b.tolist()
    c, s = math.cos(phi_a), math.sin(phi_a)
    return np.array([x_a + c * x_b - s * y_b, y_a + s * x_b + c * y_b, wrap(phi_a + phi_b)])


def inverse(pose: Array) -> Array:
    """Return T_b_a of a pose T_a_b."""
    return between(pose, np.zeros(3))


def between(a: Array, b: Array) -> Array:
    """Return a^-1 o b, pose b in the frame of pose a, of two poses in one frame."""
    (x_a, y_a, phi_a), (x_b, y_b, phi_b) = a.tolist(), b.tolist()
    c, s = math.cos(phi_a), math.sin(phi_a)
    dx, dy = x_b - x_a, y_b - y_a
    return np.array([c * dx + s * dy, -s * dx + c * dy, wrap(phi_b - phi_a)])


def interpolated(a: Array, b: Array, fraction: float) -> Array:
    """Return the pose at a fraction of the motion from pose a to pose b."""
    return compose(a, fraction * between(a, b))


def interpolated_all(a: Array, b: Array, fractions: Array) -> Array:
    """Return `interpolated` of m pairs of poses (m, 3): their positions lie on straight lines."""
    return poses_plus(a, fractions[:, None] * pose_difference(b, a))


def transform(pose: Array, points: Array) -> Array:
    """Return points (..., 2) of the frame of a pose (3,) in its parent frame."""
    return points @ rotation(pose[2]).T + pose[:2]


def poses_plus(poses: Array, dx: Array) -> Array:
    """Return poses (n, 3) plus a correction dx (3 n,), with wrapped headings."""
    sums = poses + dx.reshape(-1, 3)
    sums[:, 2] = wrap_all(sums[:, 2])
    return sums


def pose_difference(a: Array, b: Array) -> Array:
    """Return a - b of poses (..., 3), with wrapped headings."""
    difference: Array = a - b
    difference[..., 2] = wrap_all(difference[..., 2])
    return difference


def transform_poses(pose: Array, poses: Array) -> Array:
    """Return poses (n, 3) of the frame of a pose in its parent frame, bit for bit as `compose`."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y, phi = poses.T
    return np.column_stack([
        pose[0] + c * x - s * y, pose[1] + s * x + c * y, wrap_all(pose[2] + phi)])


class StampedPose(Protocol):
    """A pose (3,) at a stamp [ns]."""

    @property
    def stamp(self) -> int:
        """Return the stamp [ns]."""

    @property
    def pose(self) -> Array:
        """Return the pose, a (3,) array."""


def pose_at(stamp: int, known: Sequence[StampedPose], longest_gap: int) -> Array | None:
    """
    Return the pose (3,) at a stamp [ns] by interpolation; None outside of poses in their order.

    Also None between two poses that are further apart than the longest gap [ns].

    """
    after = bisect_left(known, stamp, key=attrgetter('stamp'))
    if after < len(known) and known[after].stamp == stamp:
        return known[after].pose
    if after in (0, len(known)):
        return None
    first, last = known[after - 1:after + 1]
    if last.stamp - first.stamp > longest_gap:
        return None
    return interpolated(
        first.pose, last.pose, (stamp - first.stamp) / (last.stamp - first.stamp))


def poses_at(stamps: Stamps, known: Stamps, poses: Array) -> Array:
    """Return poses (m, 3) at stamps (m,) by interpolation of poses (n, 3) at stamps `known`."""
    poses = turning_poses_at(stamps, known, poses)
    poses[:, 2] = wrap_all(poses[:, 2])
    return poses


def turning_poses_at(stamps: Stamps, known: Stamps, poses: Array) -> Array:
    """Return the same with headings that are not wrapped, which count whole turns."""
    # Floats do not resolve nanoseconds since 1970.
    stamps, known = stamps - known[0], known - known[0]
    x, y, phi = poses.T
    return np.column_stack([
        np.interp(stamps, known, column) for column in (x, y, np.unwrap(phi))])


def motion_to_begin(stamp: int, stamps: Stamps, poses: Array) -> Array:
    """Return the motion (3,) from a stamp back to the first of poses (n, 3) at stamps (n,)."""
    (reached,) = poses_at(np.array([stamp]), stamps, poses)
    return between(reached, poses[0])


def rigid_fit(source: Array, target: Array, weights: Array | None = None) -> Array:
    """
    Return the pose (3,) that maps points to others with the least squared distances.

    Parameters
    ----------
    source, target : (k, 2) arrays, corresponding points [m], k >= 2
    weights : (k,) array, one over the variance of each; None for equal weights

    """
    source_mean, target_mean = (
        np.average(points, axis=0, weights=weights) for points in (source, target))
    a, b = source - source_mean, target - target_mean
    weighted = b if weights is None else weights[:, None] * b
    sine = float(np.sum(a[:, 0] * weighted[:, 1] - a[:, 1] * weighted[:, 0]))
    alpha = float(np.arctan2(sine, np.sum(a * weighted)))
    t = target_mean - transform(np.array([0.0, 0.0, alpha]), source_mean)
    return np.array([t[0], t[1], alpha])


def distinct(indices: Indices) -> Indices:
    """Return the sorted distinct indices; np.unique hashes first, which takes ten times longer."""
    ascending = np.sort(indices)
    return ascending[np.diff(ascending, prepend=-1) > 0]


def starts_of(lengths: Indices) -> Indices:
    """Return where runs of some lengths start, each at the end of the one before."""
    starts: Indices = np.cumsum(lengths) - lengths
    return starts


def runs(starts: Indices, lengths: Indices) -> Indices:
    """Return the concatenated ranges start, ..., start + length - 1."""
    runs: Indices = np.arange(lengths.sum()) + np.repeat(starts - starts_of(lengths), lengths)
    return runs
