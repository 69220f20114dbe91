# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Planar geometry: angles, rotations and poses [x, y, phi] in m, m, rad.

A pose is also the transform it stands for: ``compose(T_a_b, T_b_c)`` is ``T_a_c``. All functions
broadcast over leading dimensions where their docstring says so.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]


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
    """Return C(phi), the (2, 2) matrix that turns a vector by phi [rad]."""
    c, s = math.cos(phi), math.sin(phi)
    return np.array([[c, -s], [s, c]])


def pose_rotation(phi: float) -> Array:
    """Return blkdiag(C(phi), 1), which turns the position part of a pose error."""
    c, s = math.cos(phi), math.sin(phi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def perpendicular(vectors: Array) -> Array:
    """
    Return J v for each vector v of a (..., 2) array.

    J = [[0, -1], [1, 0]] generates planar rotations: d C(phi) / d phi = J C(phi), eq. (6) of
    [Liu].

    """
    turned = np.empty_like(vectors)
    turned[..., 0] = -vectors[..., 1]
    turned[..., 1] = vectors[..., 0]
    return turned


def ellipse(P: Array) -> tuple[float, float, float]:
    """Return both half axes and the angle [rad] of the 1-sigma ellipse of P (2, 2)."""
    variances, axes = np.linalg.eigh(P)
    # Of a position that is known exactly a variance may be rounded to below zero.
    minor, major = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return major, minor, math.atan2(axes[1, 1], axes[0, 1])


def compose(a: Array, b: Array) -> Array:
    """Return the pose a o b: b, given in the frame of a, seen from the frame of a's parent."""
    # Arithmetic with Python's floats gives the same bits in a third of the time.
    (x_a, y_a, phi_a), (x_b, y_b, phi_b) = a.tolist(), b.tolist()
    c, s = math.cos(phi_a), math.sin(phi_a)
    return np.array([x_a + c * x_b - s * y_b, y_a + s * x_b + c * y_b, wrap(phi_a + phi_b)])


def between(a: Array, b: Array) -> Array:
    """Return a^-1 o b: pose b seen from pose a, both given in one frame."""
    (x_a, y_a, phi_a), (x_b, y_b, phi_b) = a.tolist(), b.tolist()
    c, s = math.cos(phi_a), math.sin(phi_a)
    dx, dy = x_b - x_a, y_b - y_a
    return np.array([c * dx + s * dy, -s * dx + c * dy, wrap(phi_b - phi_a)])


def transform(pose: Array, points: Array) -> Array:
    """Return (..., 2) points, given in the frame of the pose, in the frame of its parent."""
    moved: Array = points @ rotation(pose[2]).T + pose[:2]
    return moved


def corrected(poses: Array, dx: Array) -> Array:
    """Return poses (n, 3) plus a correction dx (3 n,), the headings wrapped."""
    sums = poses + dx.reshape(-1, 3)
    sums[:, 2] = wrap_all(sums[:, 2])
    return sums


def transform_poses(pose: Array, poses: Array) -> Array:
    """Return (n, 3) poses, given in the frame of the pose, as `compose` does, bit for bit."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y, phi = poses.T
    return np.column_stack([
        pose[0] + c * x - s * y, pose[1] + s * x + c * y, wrap_all(pose[2] + phi)])


def poses_at(stamps: NDArray[np.int64], known: NDArray[np.int64], poses: Array) -> Array:
    """Return poses (m, 3) at stamps (m,) between those (n,) of which poses (n, 3) are known."""
    x, y, phi = poses.T
    return np.column_stack([
        np.interp(stamps, known, x), np.interp(stamps, known, y),
        wrap_all(np.interp(stamps, known, np.unwrap(phi)))])


def rigid_fit(source: Array, target: Array, weights: Array | None = None) -> Array:
    """
    Return the pose (3,) that moves points nearest to others.

    Parameters
    ----------
    source, target : (k, 2) arrays, the points and where they belong [m], k >= 2
    weights : (k,) array, one over the variance of each; None where all are alike

    """
    middle, there = (np.average(points, axis=0, weights=weights) for points in (source, target))
    a, b = source - middle, target - there
    weighted = b if weights is None else weights[:, None] * b
    turned = float(np.sum(a[:, 0] * weighted[:, 1] - a[:, 1] * weighted[:, 0]))
    alpha = float(np.arctan2(turned, np.sum(a * weighted)))
    t = there - transform(np.array([0.0, 0.0, alpha]), middle)
    return np.array([t[0], t[1], alpha])
