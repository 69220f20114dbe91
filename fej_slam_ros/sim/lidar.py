# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of a planar laser by ray casting, among discs and walls."""

from dataclasses import dataclass
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags

#: Smallest range of the laser [m].
MIN_RANGE = 0.05


@dataclass(frozen=True)
class LidarSettings:
    """The laser of every robot, at the origin of its base frame; lengths in m, angles in rad."""

    #: Standard deviations of the increment (x, y, phi) of one step.
    odometry_sigma: tuple[float, float, float] = (0.002, 0.002, 0.001)
    range: float = 12.0  #: Maximum range
    field_of_view: float = 2.0 * math.pi  #: Full angle, centred straight ahead
    beams: int = 720  #: Number of beams of a scan
    range_sigma: float = 0.02  #: Standard deviation of a range
    dropouts: float = 0.005  #: Fraction of beams that have no return by chance
    scan_rate: float = 10.0  #: Scans per second [Hz]; each takes the whole time to the next

    @property
    def increment(self) -> float:
        """Return the angle between neighbouring beams."""
        is_closed = self.field_of_view >= 2.0 * math.pi
        return self.field_of_view / (self.beams if is_closed else self.beams - 1)

    @property
    def angles(self) -> Array:
        """Return the direction (n,) of each beam, counterclockwise."""
        return -self.field_of_view / 2.0 + self.increment * np.arange(float(self.beams))


def true_ranges(poses: Array, angles: Array, discs: Array, walls: Array) -> Array:
    """
    Return the distances (n,) at which beams meet the first object, inf where there is none.

    Parameters
    ----------
    poses : (n, 3) array, pose of the laser at the time of each beam
    angles : (n,) array, direction of each beam in the frame of the laser
    discs : (d, 3) array, centre and radius [m]
    walls : (w, 4) array, both ends [m]

    """
    heading = poses[:, 2] + angles
    d = np.stack([np.cos(heading), np.sin(heading)], 1)
    return np.minimum(
        _disc_distances(poses[:, :2], d, discs), _wall_distances(poses[:, :2], d, walls))


def measured(true: Array, settings: LidarSettings, rng: np.random.Generator) -> Array:
    """Return ranges with noise and dropouts; beyond the maximum range they are inf."""
    ranges = true + rng.normal(0.0, settings.range_sigma, len(true))
    is_dropout: Flags = rng.random(len(true)) < settings.dropouts
    ranges[is_dropout | (ranges > settings.range)] = np.inf
    return ranges


def _disc_distances(origins: Array, d: Array, discs: Array) -> Array:
    to_centre = discs[:, :2] - origins[:, None]
    along = np.einsum('nk,ndk->nd', d, to_centre)
    h2 = discs[:, 2] ** 2 - (np.sum(to_centre**2, axis=2) - along**2)
    distances = along - np.sqrt(np.maximum(h2, 0.0))
    distances[(h2 < 0.0) | (distances <= 0.0)] = np.inf
    nearest: Array = distances.min(axis=1, initial=np.inf)
    return nearest


def _wall_distances(origins: Array, d: Array, walls: Array) -> Array:
    to_begin, along = walls[:, :2] - origins[:, None], walls[:, 2:] - walls[:, :2]
    with np.errstate(divide='ignore', invalid='ignore'):
        # origin + t d = begin + s along
        determinant = d[:, None, 0] * along[:, 1] - d[:, None, 1] * along[:, 0]
        t = (to_begin[..., 0] * along[:, 1] - to_begin[..., 1] * along[:, 0]) / determinant
        s = (to_begin[..., 0] * d[:, None, 1] - to_begin[..., 1] * d[:, None, 0]) / determinant
        distances = np.where((t > 0.0) & (s >= 0.0) & (s <= 1.0), t, np.inf)
    nearest: Array = distances.min(axis=1, initial=np.inf)
    return nearest
