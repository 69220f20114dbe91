# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Objects that another program has found, such as tags, as planar observations of a robot."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array


class DetectedObject(NamedTuple):
    """An object in the data of a sensor."""

    name: str  #: what it is recognised by, '' if by nothing
    pose: Array  #: (4, 4) array, transform of its frame to the frame of the sensor [m]
    P: Array | None  #: (3, 3) covariance of its position in the frame of the sensor, if known


class PlanarObservation(NamedTuple):
    """The position of an object on the plane, in the base frame of a robot."""

    z: Array  #: (2,) array [m]
    R: Array  #: (2, 2) covariance


@dataclass(frozen=True)
class ObjectNoise:
    """
    Standard deviations of a position, for detections that have no covariance.

    A camera measures the direction of a tag well, and its distance d by its size in the image,
    with a standard deviation that grows with the square of the distance.
    """

    range_sigma: float  #: of the distance, near the sensor [m]
    range_sigma_growth: float  #: its growth by the square of the distance [1/m]
    bearing_sigma: float  #: of the direction [rad]
    orientation_sigma: float  #: of the orientation of an object [rad]

    def covariance(self, position: Array) -> Array:
        """Return that of a position (3,) as a matrix (3, 3), both in the frame of the sensor."""
        d2 = float(position @ position)
        along = np.outer(position, position) / max(d2, 1e-12)
        range_variance = self.range_sigma**2 + (self.range_sigma_growth * d2) ** 2
        across_variance = max(self.bearing_sigma**2 * d2, 1e-8)
        return range_variance * along + across_variance * (np.eye(3) - along)


def behind(detected: DetectedObject, depth: float, noise: ObjectNoise) -> DetectedObject:
    """
    Return the point at a depth [m] behind the face of a tag, seen from the sensor.

    The normal of the tag is the z axis of its frame, which points out of its face or into it.
    """
    R, t = detected.pose[:3, :3], detected.pose[:3, 3]
    inward = R[:, 2] if R[:, 2] @ t >= 0.0 else -R[:, 2]
    pose = detected.pose.copy()
    pose[:3, 3] = t + depth * inward
    P = noise.covariance(t) if detected.P is None else detected.P
    turned = (depth * noise.orientation_sigma) ** 2 * (np.eye(3) - np.outer(inward, inward))
    return detected._replace(pose=pose, P=P + turned)


def mirrored(detected: DetectedObject, axis: int) -> DetectedObject:
    """Return an object of a left-handed frame, one axis of which is turned round."""
    M = np.eye(4)
    M[axis, axis] = -1.0
    P = None if detected.P is None else M[:3, :3] @ detected.P @ M[:3, :3]
    return detected._replace(pose=M @ detected.pose @ M, P=P)


def on_plane(detected: DetectedObject, sensor: Array, noise: ObjectNoise) -> PlanarObservation:
    """Return the observation of an object by a sensor with a pose (4, 4) in the base frame."""
    position, C = detected.pose[:3, 3], sensor[:3, :3]
    P = noise.covariance(position) if detected.P is None else detected.P
    return PlanarObservation(
        (C @ position + sensor[:3, 3])[:2], (C @ P @ C.T)[:2, :2])
