# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
True trajectories of a team: closed curves, driven at equal steps of the curve's parameter.

A curve is one loop, a (steps + 1, 3) array of poses [m, m, rad] with the heading along the
tangent that begins and ends at [0, 0, 0]. Its length is that of the polyline through its poses,
as are the loop lengths of the worlds of [Liu].
"""

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, transform_poses, wrap_all


class Pair(NamedTuple):
    """The curves of two robots; the second starts `gap` [m] to the right of the first, abreast."""

    first: Array
    second: Array
    gap: float


def circle(length: float, steps: int, turn: int) -> Array:
    """Return one loop of the given length [m] on a circle, to the left (turn 1) or right (-1)."""
    angle = turn * 2.0 * np.pi * np.arange(steps) / steps
    radius = turn * length / (2.0 * steps * math.sin(math.pi / steps))
    return _closed(radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle)


def figure_eight(length: float, steps: int) -> Array:
    """Return one loop of the given length [m] on Gerono's lemniscate, which lies to the right."""
    t = 2.0 * np.pi * np.arange(steps) / steps
    x, y = np.sin(t) * np.cos(t), np.cos(t) - 1.0
    unit = _closed(x, y, np.arctan2(-np.sin(t), np.cos(2.0 * t)))
    scale = length / polyline_length(unit)
    return unit * [scale, scale, 1.0]


def polyline_length(poses: Array) -> float:
    """Return the length [m] of the straight lines that join successive poses."""
    return float(np.sum(np.hypot(*np.diff(poses[:, :2], axis=0).T)))


def intersecting_circles(lengths: tuple[float, float], steps: int) -> Pair:
    """Return two circles whose robots start on opposite sides of the area that both enclose."""
    gap = 0.8 * min(lengths) / (2.0 * math.pi)
    return Pair(circle(lengths[0], steps, -1), circle(lengths[1], steps, 1), gap)


def eight_in_circle(lengths: tuple[float, float], steps: int) -> Pair:
    """Return a circle for the first robot and, about the same centre, an eight for the second."""
    first, second = circle(lengths[0], steps, -1), figure_eight(lengths[1], steps)
    gap = (np.min(second[:, 1]) - np.min(first[:, 1])) / 2.0
    return Pair(first, second, float(gap))


#: The environments of [Liu], section 4.1: how a pair of robots drives, from the two loop lengths
#: [m] and the steps of a loop.
LAYOUTS: dict[str, Callable[[tuple[float, float], int], Pair]] = {
    'circles': intersecting_circles,
    'figure_eight': eight_in_circle,
}


def team_loops(pair: Pair, robots: int) -> tuple[list[Array], Array]:
    """
    Return one loop for each robot of a team, and the point around which they all start.

    Robots 1 and 2 drive the given curves. Every further two drive the same curves, turned about
    the middle between the first two starts, pair k = 0, 1, ... of n by pi k / n: however many they
    are, all robots start equally far from that point, so all can see what stands near it.

    Parameters
    ----------
    pair : Pair
        Curves of robots 1 and 2.
    robots : int
        How many robots there are.

    Returns
    -------
    list of (steps + 1, 3) array, (2,) array
        The loops and the middle of the starts, in the frame of the first robot's start [m].

    """
    middle = np.array([0.0, -pair.gap / 2.0])
    curves = (pair.first, transform_poses(np.array([0.0, -pair.gap, 0.0]), pair.second))
    pairs = (robots + 1) // 2
    turns = [_turn_about(middle, math.pi * k / pairs) for k in range(pairs)]
    return [transform_poses(turns[i // 2], curves[i % 2]) for i in range(robots)], middle


def _closed(x: Array, y: Array, heading: Array) -> Array:
    open_loop = np.column_stack([x, y, wrap_all(heading)])
    return np.vstack([open_loop, open_loop[:1]])


def _turn_about(point: Array, angle: float) -> Array:
    """Return the pose whose transform turns the plane by the angle [rad] and keeps the point."""
    return np.append(point - rotation(angle) @ point, angle)
