# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Slip of a robot with landmarks: its own map fits only in two parts, as after it was carried.

Landmarks outweigh odometry after a small slip. After one of metres, observations from before and
from after it contradict each other, so that the map is bent, or one part of them is removed as
outliers. Each part alone fits: the longest one from the begin and the longest one to the end are
found by bisection. The later part is placed by the landmarks that both have, and each link between
them is released in which the robot slipped. That is the result if enough observations count again,
and not if all slips together take the robot back: then the observations between them are wrong.
"""

from bisect import bisect_left
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile
from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.odometry_links import (
    distances, factors_of, intervals_of, links_of, measured_poses, MIN_PER_LINK,
    ReleasedOdometry, UNKNOWN_SLIP)
from fej_slam_ros.core.csam.outlier_removal import (
    count_beyond, Outlier, outlier_limit, robust_minimum, without_outliers)
from fej_slam_ros.core.csam.trajectory_parts import placed, TrajectoryPart, with_slips
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.smoothing.factors import rows_of

#: Smallest d2 of the odometry of a slip between two parts: that of 5 % of odometry that fits.
MIN_SLIP = chi_square_quantile(3, 0.95)


@dataclass(frozen=True, slots=True, eq=False)
class OwnMap:
    """A single robot's map at the minimum."""

    joint: JointMap  #: the map without outliers
    outliers: Sequence[Outlier]  #: observations that were removed
    misfits: int  #: number of these, and of others that are beyond the limit for outliers
    released: ReleasedOdometry | None = None  #: odometry in which the robot slipped

    @classmethod
    def of(cls, complete: JointMap, probability: float) -> 'OwnMap':
        """Return the map without outliers; parameters and errors as of `without_outliers`."""
        joint, outliers = without_outliers(complete, probability)
        limit = outlier_limit(complete, probability)
        return cls(joint, outliers, len(outliers) + count_beyond(joint, limit))


def own_map(complete: JointMap, probability: float, limit: float) -> OwnMap:
    """
    Return a single robot's map without outliers and without the odometry of slips.

    Parameters
    ----------
    complete : the map with all measurements, at some start
    probability : that of removing no correct observation; 1.0 keeps all
    limit : largest d2 of odometry that fits

    Raises
    ------
    SingularError, ConvergenceError
        As of `without_outliers`.

    """
    own = OwnMap.of(complete, probability)
    if own.misfits < MIN_PER_LINK:
        return own
    search = _SlipSearch(replace(complete, values=own.joint.values), probability, limit)
    try:
        explained = search.explained() if search.contradicts_odometry() else None
    except NoMinimumError:
        explained = None
    if explained is None:
        return own
    intervals = intervals_of(search.links, explained.slips, 0)
    count = own.misfits - explained.own.misfits
    if count < MIN_PER_LINK * len(intervals):
        return own
    robot, = complete.robots
    return replace(explained.own, released=ReleasedOdometry(robot, intervals, count))


class _Explained(NamedTuple):
    """A map in which some links are released."""

    own: OwnMap
    slips: Collection[int]  #: the links


class _SlipSearch:
    """
    Search of slips among the links of a robot.

    Parameters
    ----------
    bent : the map with all measurements, at values that do not fit all
    probability, limit : as of `own_map`

    Attributes
    ----------
    links : odometry of the robot between successive poses with observations

    """

    def __init__(self, bent: JointMap, probability: float, limit: float) -> None:
        robot, = bent.robots
        self.links = links_of(bent, robot, pairwise(measured_poses(bent, robot).tolist()))
        self._bent, self._probability, self._limit = bent, probability, limit

    def contradicts_odometry(self) -> bool:
        """Return whether most observations contradict odometry."""
        robust = robust_minimum(self._bent)
        return robust is not None and bool(
            self._by_odometry(robust).max(initial=0.0) > self._limit)

    def explained(self) -> _Explained | None:
        """Return the map without the odometry of slips, None if its parts share too little."""
        links = self._between_parts()
        poses = len(self._bent.values.poses)
        before, after = (self._solved_part(part) for part in (
            range(int(self.links.factors.pose[links[0]]) + 1),
            range(int(self.links.factors.target[links[-1]]), poses)))
        start = placed(self._bent, before, after, self.links, links)
        if start is None:
            return None
        free = with_slips(start, self.links, dict.fromkeys(links, UNKNOWN_SLIP))
        solved, _ = without_outliers(free, self._probability)
        if not self._is_moved(solved, links):
            return None
        slips = factors_of(solved, self.links, self._slips(solved, links))
        used = with_slips(replace(self._bent, values=solved.values), self.links, slips)
        return _Explained(OwnMap.of(used, self._probability), slips)

    def _by_odometry(self, joint: JointMap) -> Array:
        """Return the squared distances (k,) of links at values of a map, by their own noise."""
        _, r = self.links.factors.linearize(joint.values)
        return nees(r, self.links.factors.R)

    def _between_parts(self) -> range:
        """Return the links between the longest parts from the begin and to the end that fit."""
        factors, count = self.links.factors, len(self.links.rows)
        poses = len(self._bent.values.poses)
        first = _first_misfit(
            count, lambda k: self._misfits(range(int(factors.target[k]) + 1)))
        last = _first_misfit(
            count, lambda k: self._misfits(range(int(factors.pose[count - 1 - k]), poses)))
        return range(first, max(first + 1, count - last))

    def _misfits(self, poses: range) -> int:
        """Return the number of misfits in a part of the trajectory."""
        part = TrajectoryPart.of(self._bent, poses).joint
        try:
            return OwnMap.of(part, self._probability).misfits
        except NoMinimumError:
            return len(part.problem.landmarks.z)

    def _solved_part(self, poses: range) -> TrajectoryPart:
        part = TrajectoryPart.of(self._bent, poses)
        solved, _ = without_outliers(part.joint, self._probability)
        return part._replace(joint=solved)

    def _is_moved(self, free: JointMap, links: Sequence[int]) -> bool:
        """Return whether odometry over all of some free links contradicts the rest."""
        factors, robot = self.links.factors, free.robots[0]
        ends = int(factors.pose[links[0]]), int(factors.target[links[-1]])
        whole = links_of(self._bent, robot, [ends]).factors
        return bool(distances(free, free.information(ends), whole, 1.0)[0] > self._limit)

    def _slips(self, free: JointMap, links: Sequence[int]) -> Collection[int]:
        """Return those of some free links that contradict the rest."""
        factors = rows_of(self.links.factors, np.array(links))
        d2 = distances(free, free.information([*factors.pose, *factors.target]), factors, 1.0)
        return [link for link, is_slip in zip(links, d2 > MIN_SLIP) if is_slip]


def _first_misfit(count: int, misfits: Callable[[int], int]) -> int:
    """Return the first of `count` links with misfits, given their number up to each link."""
    up_to = cache(misfits)
    link = min(bisect_left(range(count), MIN_PER_LINK, key=up_to), count - 1)
    while link > 1 and up_to(link - 2) < up_to(link - 1):
        link -= 1
    return link
