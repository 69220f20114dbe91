# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
True trajectories of a team: closed curves, sampled at equal steps of the curve's parameter.

A loop is a (steps + 1, 3) array of poses [m, m, rad] that begins and ends at [0, 0, 0], the
heading along the tangent. Its length is that of the polyline through its poses, like the loop
lengths published in [Liu].
"""

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, transform_poses, wrap_all


class LoopPair(NamedTuple):
    """Loops of two robots; the second starts `gap` [m] to the right of the first, abreast."""

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
    scale = length / float(np.hypot(*np.diff(unit[:, :2], axis=0).T).sum())
    return unit * [scale, scale, 1.0]


def intersecting_circles(lengths: tuple[float, float], steps: int) -> LoopPair:
    """Return two overlapping circles; the robots start on opposite sides of the overlap."""
    gap = 0.8 * min(lengths) / (2.0 * math.pi)
    return LoopPair(circle(lengths[0], steps, -1), circle(lengths[1], steps, 1), gap)


def eight_in_circle(lengths: tuple[float, float], steps: int) -> LoopPair:
    """Return a circle for the first robot and a figure eight about its centre for the second."""
    first, second = circle(lengths[0], steps, -1), figure_eight(lengths[1], steps)
    gap = (np.min(second[:, 1]) - np.min(first[:, 1])) / 2.0
    return LoopPair(first, second, float(gap))


#: The environments of [Liu], section 4.1: loops of two robots from their lengths [m] and the
#: number of steps in a loop.
LAYOUTS: dict[str, Callable[[tuple[float, float], int], LoopPair]] = {
    'circles': intersecting_circles,
    'figure_eight': eight_in_circle,
}


def team_loops(pair: LoopPair, robots: int) -> tuple[list[Array], Array]:
    """
    Return one loop for each robot of a team, and the centre (2,) of their starts [m].

    Both are in the frame of the first robot's start. Robots 1 and 2 drive the given loops. Each
    further pair drives the same loops rotated about the centre, pair k = 0, 1, ... of n by
    pi k / n: all robots of a team of any size start equally far from the centre and can observe
    landmarks near it.
    """
    centre = np.array([0.0, -pair.gap / 2.0])
    loops = (pair.first, transform_poses(np.array([0.0, -pair.gap, 0.0]), pair.second))
    pairs = (robots + 1) // 2
    # The pose whose transform is the rotation C about the centre is (centre - C centre, angle).
    turns = [
        np.append(centre - rotation(angle) @ centre, angle)
        for angle in (math.pi * k / pairs for k in range(pairs))]
    return [transform_poses(turns[i // 2], loops[i % 2]) for i in range(robots)], centre


def _closed(x: Array, y: Array, heading: Array) -> Array:
    open_loop = np.column_stack([x, y, wrap_all(heading)])
    return np.vstack([open_loop, open_loop[:1]])
