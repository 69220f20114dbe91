# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks that stay where they are, unlike the legs of people who walk."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile, squared_distances
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.records import NS

#: Probability with which a landmark is found again where it was.
FOUND_PROBABILITY = 0.99
#: Variance per second [m^2/s] and per second and squared distance [rad^2/s] by which odometry
#: moves what stands still: slower than a person who walks.
DRIFT = 0.01**2
HEADING_DRIFT = 0.005**2
#: Longest pause [ns] after which something is still at its place, before it has proved to be
#: static and since.
MAX_PAUSE, MAX_STATIC_PAUSE = NS // 2, 5 * NS
#: Time [ns] for which something that too few beams have met is not used, and largest distance of
#: these beams from its place [m].
THIN_TIME, THIN_DISTANCE = NS, 0.3


@dataclass(slots=True, eq=False)
class _Place:
    """A place of the odometry frame where something was seen."""

    point: Array  #: (2,) array [m]
    P: Array  #: (2, 2) array
    begin: int  #: when it was seen there first [ns]
    seen_at: int  #: when it was seen last [ns]
    is_static: bool = False  #: whether it has been there for long enough
    thin_until: int = 0  #: before this time [ns] it is not used, as too few beams met it


class StaticFilter:
    """
    Finds which points stand still, as landmarks do.

    Parameters
    ----------
    static_time : time [ns] for which a landmark must have been seen at one place

    """

    def __init__(self, static_time: int) -> None:
        self._static_time = static_time
        self._places: list[_Place] = []

    def are_static(
        self, stamp: int, points: Array, R: Array, is_certain: Flags, origin: Array
    ) -> Flags:
        """
        Return which points (m,) have been at their places for long enough.

        Parameters
        ----------
        stamp : of the scan [ns], later than the one before of the same laser
        points, R : (m, 2) and (m, 2, 2) arrays, in the frame of odometry [m]
        is_certain : (m,) array, whether they are landmarks wherever they are
        origin : (2,) position of the laser in this frame [m]

        """
        self._places = [
            place for place in self._places
            if stamp - place.seen_at <= (MAX_STATIC_PAUSE if place.is_static else MAX_PAUSE)]
        static = np.zeros(len(points), bool)
        if len(points) == 0:
            return static
        found = self._found(stamp, points, R, origin)
        for k, place in enumerate(found):
            if place is None:
                if is_certain[k]:
                    self._places.append(_Place(points[k], R[k], stamp, stamp))
                continue
            pause = max(stamp - place.seen_at, 0)
            P = place.P + np.eye(2) * self._drift(pause, points[k], origin)
            K = np.linalg.solve(P + R[k], P).T
            place.point, place.P = place.point + K @ (points[k] - place.point), P - K @ P
            place.seen_at = max(stamp, place.seen_at)
            place.is_static |= stamp - place.begin >= self._static_time
            static[k] = place.is_static
        return static

    def are_thin(
        self, stamp: int, points: Array, is_thin: Flags, thin: Array
    ) -> Flags:
        """
        Return which points (m,) too few beams have met in one of the last scans.

        A post at the range where by chance two or three beams meet it would be used only when
        these are more than its width makes likely: its radius and its distance would be too large.

        Parameters
        ----------
        stamp : of the scan [ns]
        points : (m, 2) array, in the frame of odometry [m], just passed to `are_static`
        is_thin : (m,) array, whether too few beams meet them in this scan
        thin : (k, 2) array, other places that too few beams meet

        """
        if self._places:
            places = np.array([place.point for place in self._places])
            for point in (*points[is_thin], *thin):
                distances = np.hypot(*(places - point).T)
                if distances.min() < THIN_DISTANCE:
                    self._places[int(distances.argmin())].thin_until = stamp + THIN_TIME
        known = np.array([p.point for p in self._places if stamp < p.thin_until]).reshape(-1, 2)
        distances = np.hypot(*(points[:, None] - known).transpose(2, 0, 1))
        are_thin: Flags = (distances < THIN_DISTANCE).any(axis=1)
        return are_thin

    def _found(
        self, stamp: int, points: Array, R: Array, origin: Array
    ) -> list[_Place | None]:
        """Return the place of each point, the nearest that is near enough and not taken."""
        found: list[_Place | None] = [None] * len(points)
        if not self._places:
            return found
        n = len(self._places)
        of_places = np.array([place.P for place in self._places])
        ages = np.array([max(stamp - place.seen_at, 0) for place in self._places])
        drift = self._drift(ages, points[:, None], origin)
        S = (R[:, None] + of_places + drift[:, :, None, None] * np.eye(2)).reshape(-1, 2, 2)
        r = (points[:, None] - np.array([place.point for place in self._places])).reshape(-1, 2)
        d2 = squared_distances(r, S).reshape(-1, n)
        limit = chi_square_quantile(2, FOUND_PROBABILITY)
        taken = set()
        for index in np.argsort(d2, axis=None, kind='stable'):
            k, place = divmod(int(index), n)
            if d2[k, place] > limit:
                break
            if found[k] is None and place not in taken:
                found[k] = self._places[place]
                taken.add(place)
        return found

    @staticmethod
    def _drift(duration: Array | int, points: Array, origin: Array) -> Array:
        """Return the variances by odometry [m^2] of points (..., 2) over durations [ns]."""
        variances: Array = (
            DRIFT + HEADING_DRIFT * np.sum((points - origin) ** 2, axis=-1)) * duration / NS
        return variances
