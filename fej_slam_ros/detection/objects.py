# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Objects that another program has detected, such as tags, as planar observations of a robot."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.geometry import Array

#: Smallest standard deviation of a position across the line of sight [m].
MIN_SIGMA = 1e-3


class DetectedObject(NamedTuple):
    """An object in the data of a sensor."""

    name: str  #: its identity, '' if it has none
    pose: Array  #: (4, 4) array, transform of its frame to the frame of the sensor [m]
    P: Array | None  #: (3, 3) covariance of its position in the frame of the sensor, if known


class PlanarObservation(NamedTuple):
    """The position of an object on the plane, in the base frame of a robot."""

    z: Array  #: (2,) array [m]
    R: Array  #: (2, 2) covariance [m^2]


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

    def of_position(self, position: Array) -> Array:
        """Return the covariance (3, 3) [m^2] of a position (3,), not 0, in the sensor frame."""
        d2 = float(position @ position)
        line_of_sight = np.outer(position, position) / d2
        range_variance = self.range_sigma**2 + (self.range_sigma_growth * d2) ** 2
        across_variance = max(self.bearing_sigma**2 * d2, MIN_SIGMA**2)
        return range_variance * line_of_sight + across_variance * (np.eye(3) - line_of_sight)


def transform_of(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> Array:
    """Return a pose of lengths [m] and angles [rad] as a homogeneous transform (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler('xyz', [roll, pitch, yaw]).as_matrix(), [x, y, z]
    return T


def carrier_position(tag: DetectedObject, depth: float, noise: ObjectNoise) -> DetectedObject:
    """
    Return the point at a depth [m] behind the face of a tag, on the side away from the sensor.

    The normal of the tag is the z axis of its frame, which points out of its face or into it.
    """
    R, t = tag.pose[:3, :3], tag.pose[:3, 3]
    inward = R[:, 2] if R[:, 2] @ t >= 0.0 else -R[:, 2]
    pose = tag.pose.copy()
    pose[:3, 3] = t + depth * inward
    P = noise.of_position(t) if tag.P is None else tag.P
    # A turn of the tag by an angle moves the point by depth times the angle, on the plane of the
    # tag.
    turned = (depth * noise.orientation_sigma) ** 2 * (np.eye(3) - np.outer(inward, inward))
    return tag._replace(pose=pose, P=P + turned)


def with_axis_negated(detected: DetectedObject, axis: int) -> DetectedObject:
    """Return an object of a left-handed frame in a right-handed one, with one axis negated."""
    M = np.eye(4)
    M[axis, axis] = -1.0
    P = None if detected.P is None else M[:3, :3] @ detected.P @ M[:3, :3]
    return detected._replace(pose=M @ detected.pose @ M, P=P)


def planar_observation(
    detected: DetectedObject, sensor: Array, noise: ObjectNoise
) -> PlanarObservation:
    """
    Return the marginal on the plane of the position of an object; its height is discarded.

    Parameters
    ----------
    detected : the object, not at the origin of the sensor
    sensor : (4, 4) array, pose of the sensor in the base frame of the robot
    noise : of positions without covariance

    """
    position, C = detected.pose[:3, 3], sensor[:3, :3]
    P = noise.of_position(position) if detected.P is None else detected.P
    return PlanarObservation((C @ position + sensor[:3, 3])[:2], (C @ P @ C.T)[:2, :2])
