# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Circles through the beams that met round posts.

A beam at the angle delta from the centre, which is at a distance D, meets a circle of radius rho
at the range

    r = D cos(delta) - s,    s = sqrt(rho^2 - D^2 sin^2(delta)).

Noise of ranges alone determines the radius of a short arc badly, and with it the distance of the
centre. The beams beside the arc determine it well: those that pass show that the edges of the
circle, at the angles theta -+ asin(rho / D), are between the last beam that met it and the next.
"""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.detection.segments import Segments

ITERATIONS = 6
#: Largest b / rho of beams whose range is used: a range near the edge, where it changes without
#: limit, adds nothing to the edge itself.
MAX_OFFSET = 0.75
#: Limits of the radius during the iteration: its ratio to the smallest one, and rho / D.
MIN_RADIUS_RATIO, MAX_SIN = 0.2, 0.8
#: The same of the distance of the centre behind the nearest range, over the largest radius, and of
#: its direction beside the edges [rad].
MAX_DEPTH_RATIO, MAX_ASIDE = 3.0, 1.0
#: Share of the diagonal that is added to an information matrix: beams of a scan without any object
#: may determine nothing.
RIDGE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Circles:
    """m fitted circles."""

    #: (m, 3) array, distance D [m] and angle theta [rad] of the centre, and radius rho [m]
    x: Array
    P: Array  #: (m, 3, 3) array, its covariance
    #: chi_square, dof: (m,) arrays, weighted sum of squared residuals, and degrees of freedom
    chi_square: Array
    dof: Indices
    #: (m,) array, largest distance of a beam from the centre beyond the radius [m]
    overhang: Array

    def centres(self) -> tuple[Array, Array]:
        """Return the points (m, 2) in the middle [m] and their covariances (m, 2, 2)."""
        D, theta = self.x[:, 0], self.x[:, 1]
        c, s = np.cos(theta), np.sin(theta)
        J = np.stack([np.stack([c, -D * s], 1), np.stack([s, D * c], 1)], 1)
        return np.stack([D * c, D * s], 1), J @ self.P[:, :2, :2] @ J.transpose(0, 2, 1)


def fit_circles(
    segments: Segments, free: Flags, range_sigma: float, radius_limits: tuple[float, float]
) -> Circles:
    """
    Return the least-squares circles of segments.

    Parameters
    ----------
    segments : at least one, each with at least three beams
    free : (m, 2) array, whether the edges are seen
    range_sigma : standard deviation of a range [m]
    radius_limits : smallest and largest radius [m], of which the mean and the standard deviation
        sqrt(1/12) (max - min) of a uniform distribution are used

    """
    beams, is_beam = segments.padded()
    angles, first, last = segments.beams.angles, segments.first, segments.last
    a, r = angles[beams], segments.beams.ranges[beams]
    gaps = np.stack([angles[first] - angles[first - 1], angles[last + 1] - angles[last]], 1)
    edges = np.stack([angles[first], angles[last]], 1)
    edges += gaps / 2.0 * (-1.0, 1.0)
    # The edge is anywhere between two beams.
    edge_weight = free * 12.0 / gaps**2
    low, high = radius_limits
    radius, radius_weight = (low + high) / 2.0, 12.0 / max(high - low, 1e-3) ** 2
    x, nearest = _start(r, is_beam, edges), r.min(axis=1)
    for _ in range(ITERATIONS):
        problem = _linearized(x, a, r, is_beam, edges)
        information, gradient, _ = _normal(problem, range_sigma, edge_weight)
        information[:, 2, 2] += radius_weight
        gradient[:, 2] += radius_weight * (radius - x[:, 2])
        x = x + np.linalg.solve(_regular(information), gradient[:, :, None])[:, :, 0]
        # The laser is outside of the circle, whose near side is where the ranges are.
        x[:, 0] = np.clip(x[:, 0], nearest, nearest + MAX_DEPTH_RATIO * high)
        x[:, 1] = np.clip(x[:, 1], edges[:, 0] - MAX_ASIDE, edges[:, 1] + MAX_ASIDE)
        x[:, 2] = np.clip(x[:, 2], MIN_RADIUS_RATIO * low, MAX_SIN * x[:, 0])
    problem = _linearized(x, a, r, is_beam, edges)
    information, _, chi_square = _normal(problem, range_sigma, edge_weight)
    information = _regular(information)
    information[:, 2, 2] += radius_weight
    used = np.count_nonzero(problem.is_used, axis=1)
    dof: Indices = used + np.count_nonzero(free, axis=1) - 2
    return Circles(
        x, np.linalg.inv(information).astype(np.float64), chi_square, dof,
        problem.offsets.max(axis=1, where=is_beam, initial=0.0) - x[:, 2])


def line_chi_squares(segments: Segments, range_sigma: float) -> Array:
    """
    Return the chi-squares (m,) of the ranges of segments on straight lines.

    The inverse of the range on a line is 1 / r = A cos(a) + B sin(a) at an angle a.

    """
    beams, is_beam = segments.padded()
    a, r = segments.beams.angles[beams], segments.beams.ranges[beams]
    inverse, weight = 1.0 / r, is_beam * (r**2 / range_sigma) ** 2
    H = np.stack([np.cos(a), np.sin(a)], 2)
    wH = weight[:, :, None] * H
    x = np.linalg.solve(H.transpose(0, 2, 1) @ wH, np.einsum('mnk,mn->mk', wH, inverse)[..., None])
    chi_squares: Array = np.sum(weight * (inverse - (H @ x)[:, :, 0]) ** 2, axis=1)
    return chi_squares


@dataclass(frozen=True, slots=True, eq=False)
class _Linearized:
    """Residuals and Jacobians of ranges (m, n) and edges (m, 2)."""

    is_used: Flags
    offsets: Array  #: distances of the beams (m, n) from the centre
    r: Array
    H: Array
    r_edge: Array
    H_edge: Array


def _start(r: Array, is_beam: Flags, edges: Array) -> Array:
    """Return (D, theta, rho) (m, 3) by the edges and the mean range."""
    half = np.minimum((edges[:, 1] - edges[:, 0]) / 2.0, 1.4)
    mean = np.sum(r, axis=1, where=is_beam) / np.count_nonzero(is_beam, axis=1)
    # The mean of cos over the arc is close to 0.8 of the radius before the centre.
    D = mean / (1.0 - 0.8 * np.sin(half))
    return np.stack([D, edges.mean(axis=1), D * np.sin(half)], 1)


def _linearized(x: Array, a: Array, r: Array, is_beam: Flags, edges: Array) -> _Linearized:
    D, theta, rho = x.T[:, :, None]
    sin, cos = np.sin(a - theta), np.cos(a - theta)
    b = D * sin
    offset = np.where(is_beam, np.abs(b), np.inf)
    # At least the beam nearest to the centre.
    is_used = is_beam & (offset <= np.maximum(MAX_OFFSET * rho, offset.min(1, keepdims=True)))
    s = np.sqrt(np.maximum(rho**2 - b**2, (1.0 - MAX_OFFSET**2) * rho**2))
    H = np.stack([cos + b * sin / s, b - b * D * cos / s, -rho / s + 0.0 * b], 2)
    # Edges: theta -+ asin(rho / D).
    k = np.sqrt(D**2 - rho**2)
    sign = np.array([-1.0, 1.0])
    r_edge = edges - theta - sign * np.arcsin(rho / D)
    H_edge = np.stack([-sign * rho / (D * k), np.ones((len(x), 2)), sign / k], 2)
    return _Linearized(is_used, np.abs(b), r - (D * cos - s), H, r_edge, H_edge)


def _regular(information: Array) -> Array:
    """Return an information matrix (m, 3, 3) that can be inverted."""
    diagonal = np.einsum('mii->mi', information)
    regular: Array = information + np.eye(3) * (RIDGE * (1.0 + diagonal))[:, :, None]
    return regular


def _normal(
    problem: _Linearized, range_sigma: float, edge_weight: Array
) -> tuple[Array, Array, Array]:
    """Return the information (m, 3, 3), gradient (m, 3) and chi-square (m,)."""
    w = problem.is_used / range_sigma**2
    wH, wH_edge = w[:, :, None] * problem.H, edge_weight[:, :, None] * problem.H_edge
    information = problem.H.transpose(0, 2, 1) @ wH + problem.H_edge.transpose(0, 2, 1) @ wH_edge
    gradient = (
        np.einsum('mnk,mn->mk', wH, problem.r)
        + np.einsum('mnk,mn->mk', wH_edge, problem.r_edge))
    chi_square = np.sum(w * problem.r**2, 1) + np.sum(edge_weight * problem.r_edge**2, 1)
    return information, gradient, chi_square
