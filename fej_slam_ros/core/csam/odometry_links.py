# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Odometry that contradicts other measurements, and is released: the robot slipped, or was carried.

A link is the odometry between two poses of a robot with other measurements. Without a link of
residual r and covariance S, chi-square is smaller by

    d2 = r^T (S - H P H^T)^-1 r,

with the P of both poses at the minimum. A link is released by a factor of its covariance.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.chi_square import distances_where_tested
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.geometry import Array, distinct, Indices
from fej_slam_ros.core.models import composed_increment
from fej_slam_ros.core.smoothing.factors import (
    concatenated, OdometryFactors, Row, stacked, whitened, whitener)
from fej_slam_ros.core.smoothing.marginals import Information

#: Observations that must count again for each released link: ten coordinates for three.
MIN_PER_LINK = 5
#: Factor of the covariance of a released link until the slip is known.
UNKNOWN_SLIP = 1e8


@dataclass(frozen=True, slots=True)
class ReleasedOdometry:
    """Odometry of a robot that contradicted observations, and was released."""

    robot: str  #: name of the robot
    #: intervals: the first and the last pose of each, by index
    intervals: tuple[tuple[int, int], ...]
    observations: int  #: number of observations that count again


class Links(NamedTuple):
    """Odometry of a robot between successive poses with other measurements."""

    factors: OdometryFactors  #: one for each link, in the order of time
    rows: Sequence[Indices]  #: the odometry factors of the map in each link


def links_of(joint: JointMap, robot: str, ends: Iterable[tuple[int, int]]) -> Links:
    """Return the links of a robot between some pairs of its poses, in the order of time."""
    odometry, poses = concatenated(joint.problem.odometry), joint.poses_of(robot)
    own = np.flatnonzero((odometry.pose >= poses.start) & (odometry.pose < poses.stop))
    links: list[Row] = []
    rows = []
    for begin, end in ends:
        first, last = np.searchsorted(odometry.pose[own], [begin, end])
        rows.append(own[first:last])
        u, S = odometry.z[rows[-1][0]], odometry.R[rows[-1][0]]
        for row in rows[-1][1:]:
            u, S = composed_increment(u, S, odometry.z[row], odometry.R[row])
        links.append((begin, end, u, S))
    return Links(stacked(OdometryFactors, links), rows)


def landmark_poses(joint: JointMap, robot: str) -> Indices:
    """Return the poses of a robot with observations of landmarks, in the order of time."""
    return _own(joint, robot, joint.problem.landmarks.pose)


def measured_poses(joint: JointMap, robot: str) -> Indices:
    """Return the poses of a robot with measurements other than odometry, in the order of time."""
    problem = joint.problem
    return _own(joint, robot, np.concatenate([
        problem.landmarks.pose, problem.rendezvous.pose, problem.rendezvous.target]))


def _own(joint: JointMap, robot: str, poses: Indices) -> Indices:
    """Return those of some poses that are of a robot, sorted."""
    own = joint.poses_of(robot)
    return distinct(poses[(poses >= own.start) & (poses < own.stop)])


def distances(
    joint: JointMap, information: Information, links: OdometryFactors, sign: float
) -> Array:
    """
    Return d2 = r^T (S + sign H P H^T)^-1 r of some links at the minimum of a map.

    `information` is that of the map, with all ends of the links.

    It is the decrease of chi-square without a link that the map uses (-1), or that of a link that
    it does not use (1).

    """
    A, b = whitened(whitener(links.R), *links.linearize(joint.values))
    P = np.array([
        information.joint(ends) for ends in zip(links.pose.tolist(), links.target.tolist())])
    return distances_where_tested(b, np.eye(3) + sign * A @ P @ A.transpose(0, 2, 1))


def with_released(joint: JointMap, links: Links, slips: Mapping[int, float]) -> JointMap:
    """Return a map in which the covariances of some links are multiplied by a factor."""
    odometry = concatenated(joint.problem.odometry)
    for k, factor in slips.items():
        odometry.R[links.rows[k]] *= factor
    return replace(joint, problem=replace(joint.problem, odometry=odometry))


def factors_of(joint: JointMap, links: Links, slips: Iterable[int]) -> dict[int, float]:
    """Return the factor of each released link by which its slip is one standard deviation."""
    _, r = links.factors.linearize(joint.values)
    return {k: float(r[k] @ np.linalg.solve(links.factors.R[k], r[k])) for k in slips}


def intervals_of(
    links: Links, slips: Iterable[int], first: int
) -> tuple[tuple[int, int], ...]:
    """Return the first and last pose of each run of released links, counted from a pose."""
    intervals: list[tuple[int, int]] = []
    for k in sorted(slips):
        begin, end = int(links.factors.pose[k]) - first, int(links.factors.target[k]) - first
        if intervals and intervals[-1][1] == begin:
            begin, _ = intervals.pop()
        intervals.append((begin, end))
    return tuple(intervals)
