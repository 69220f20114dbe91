# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of a single robot's map, and the whole of two that an unknown motion separates."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.csam.frame_by_landmarks import frame_by_landmarks
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.odometry_links import Links
from fej_slam_ros.core.geometry import (
    between, compose, Indices, rigid_fit, transform, transform_poses)
from fej_slam_ros.core.smoothing.factors import concatenated, rows_of, shifted, Values
from fej_slam_ros.core.smoothing.problem import Problem

#: Number of landmarks by which a single pose is placed.
MIN_AT_POSE = 2


class TrajectoryPart(NamedTuple):
    """A part of a single robot's map: some successive poses and the landmarks observed there."""

    joint: JointMap
    landmarks: Indices  #: indices of its landmarks in the whole map

    @classmethod
    def of(cls, own: JointMap, poses: range) -> 'TrajectoryPart':
        """Return a part at the values of the whole."""
        odometry, factors = own.problem.odometry, own.problem.landmarks
        observations = rows_of(factors, _within(factors.pose, poses))
        landmarks, target = np.unique(observations.target, return_inverse=True)
        problem = Problem(
            shifted(rows_of(odometry, _within(odometry.target, poses[1:])), -poses.start),
            replace(shifted(observations, -poses.start), target=target))
        return cls(replace(
            own, problem=problem,
            values=Values(
                own.values.poses[poses.start:poses.stop], own.values.points[landmarks]),
            landmarks=tuple(own.landmarks[k] for k in landmarks.tolist())), landmarks)


def placed(
    own: JointMap, before: TrajectoryPart, after: TrajectoryPart, links: Links,
    between_parts: Sequence[int],
) -> JointMap | None:
    """
    Return a map at the values of two parts; landmarks of both place the later one.

    Poses at the ends of the links between them are placed by their landmarks, if these are
    enough, else by odometry. None if the parts share too few landmarks, or these do not fit.

    """
    _, rows, rows_after = np.intersect1d(
        before.landmarks, after.landmarks, assume_unique=True, return_indices=True)
    earlier, later = before.joint.values, after.joint.values
    g = frame_by_landmarks(later.points[rows_after], earlier.points[rows])
    if g is None:
        return None
    values = Values(own.values.poses.copy(), np.full_like(own.values.points, np.nan))
    values.poses[:len(earlier.poses)] = earlier.poses
    values.poses[-len(later.poses):] = transform_poses(g, later.poses)
    values.points[after.landmarks] = transform(g, later.points)
    values.points[before.landmarks] = earlier.points
    for link in between_parts[:-1]:
        _place_end(values, own, links, link)
    return replace(own, values=values)


def with_slips(joint: JointMap, links: Links, factors: Mapping[int, float]) -> JointMap:
    """
    Return a map whose odometry has slips, by which links lead to the values of the map.

    A slip is spread evenly over its link, and the covariance is multiplied by a factor.

    """
    odometry, poses = concatenated(joint.problem.odometry), joint.values.poses.copy()
    for link, factor in factors.items():
        rows, first = links.rows[link], int(links.factors.pose[link])
        path = [*accumulate(odometry.z[rows], compose, initial=poses[first])]
        share = between(path[-1], poses[links.factors.target[link]]) / len(rows)
        for k, row in enumerate(rows.tolist(), start=1):
            poses[first + k] = compose(path[k], k * share)
            odometry.z[row] = between(poses[first + k - 1], poses[first + k])
        odometry.R[rows] *= factor
    return replace(
        joint, problem=replace(joint.problem, odometry=odometry),
        values=Values(poses, joint.values.points))


def _place_end(values: Values, own: JointMap, links: Links, link: int) -> None:
    """Place the end of a link, and the landmarks that are first observed there."""
    pose, factors = int(links.factors.target[link]), own.problem.landmarks
    rows = np.flatnonzero(factors.pose == pose)
    seen, z = factors.target[rows], factors.z[rows]
    is_known = np.isfinite(values.points[seen, 0])
    values.poses[pose] = (
        rigid_fit(z[is_known], values.points[seen[is_known]])
        if is_known.sum() >= MIN_AT_POSE
        else compose(values.poses[links.factors.pose[link]], links.factors.z[link]))
    values.points[seen[~is_known]] = transform(values.poses[pose], z[~is_known])


def _within(poses: Indices, part: range) -> Indices:
    """Return the rows of some poses that are within a part of the trajectory."""
    return np.flatnonzero((poses >= part.start) & (poses < part.stop))
