# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth by stamp, from a simulation or a motion-capture system."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Container, Iterable
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from fej_slam_ros.core.geometry import Array, between, Indices, interpolated, interpolated_all
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import LandmarkKey, NS, RendezvousKey, TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.errors import UserError

#: Longest gap between true poses [ns] across which they are interpolated.
MAX_GAP = NS // 2

#: Maximum number of true poses kept per robot; the oldest are dropped.
MAX_TRUE_POSES = 10_000


class MissingTruthError(UserError):
    """Required ground truth is missing."""


class Truth(Protocol):
    """True poses (3,) and landmarks (2,) in the frame of an estimate."""

    def pose(self, robot: str, stamp: int) -> Array:
        """Return the true pose of a robot at a stamp [ns]."""

    def landmark(self, key: LandmarkKey) -> Array:
        """Return the true position of a landmark."""

    def rendezvous_point(self, key: RendezvousKey) -> Array:
        """Return the true position of the observed robot at the rendezvous."""


class RecordedTruth:
    """Ground truth in the frame ``map``, collected from records."""

    def __init__(self) -> None:
        self._poses: dict[str, list[tuple[int, Array]]] = defaultdict(list)
        self.landmarks: dict[int, Array] = {}
        self._rendezvous_points: dict[RendezvousKey, Array] = {}
        # Stamp of each robot's newest true pose that was dropped [ns]. Older ones are not added
        # again, as when they are sent again to a run that continues from a checkpoint.
        self._dropped: dict[str, int] = {}

    def add(self, record: TruePose | TrueLandmarks) -> RejectionReason | None:
        """Add a record; return the reason if it is rejected: another pose at the same stamp."""
        if isinstance(record, TrueLandmarks):
            self.landmarks.update(record.positions)
            return None
        poses = self._poses[record.robot]
        index = bisect_left(poses, (record.stamp,))
        if index < len(poses) and poses[index][0] == record.stamp:
            is_equal = np.array_equal(poses[index][1], record.pose)
            return None if is_equal else RejectionReason.CONFLICTING
        if record.stamp > self._dropped.get(record.robot, record.stamp - 1):
            poses.insert(index, (record.stamp, record.pose))
        return None

    def robots(self) -> list[str]:
        """Return the robots that have true poses."""
        return [robot for robot, poses in self._poses.items() if poses]

    def take_surplus(self, robot: str) -> list[int]:
        """Drop a robot's oldest true poses beyond MAX_TRUE_POSES; return their stamps [ns]."""
        return self._drop(robot, len(self._poses[robot]) - MAX_TRUE_POSES)

    def covers(self, robot: str, stamp: int) -> bool:
        """Return whether a robot's true pose at a stamp is recorded or can be interpolated."""
        return self.find(robot, stamp) is not None

    def find(self, robot: str, stamp: int) -> Array | None:
        """
        Return the true pose of a robot at a stamp [ns], interpolated; None if unknown.

        It may be that of a record, which the caller must not modify.

        """
        around = self._around(robot, stamp)
        if around is None:
            return None
        before, after, fraction = around
        return after if fraction == 1.0 else interpolated(before, after, fraction)

    def find_all(self, robot: str, stamps: Iterable[int]) -> tuple[Indices, Array]:
        """Return which of some stamps [ns] have a true pose as of `find`, and these (k, 3)."""
        found = [
            (k, *around) for k, stamp in enumerate(stamps)
            if (around := self._around(robot, stamp)) is not None]
        if not found:
            return np.empty(0, np.intp), np.empty((0, 3))
        known, before, after, fractions = map(np.array, zip(*found))
        return known, interpolated_all(before, after, fractions)

    def _around(self, robot: str, stamp: int) -> tuple[Array, Array, float] | None:
        """Return the true poses around a stamp and the fraction of the motion between them."""
        poses = self._poses[robot]
        index = bisect_left(poses, (stamp,))
        if index == len(poses):
            return None
        t1, x1 = poses[index]
        if t1 == stamp:
            return x1, x1, 1.0
        t0, x0 = poses[index - 1] if index else (t1 - MAX_GAP - 1, x1)
        return (x0, x1, (stamp - t0) / (t1 - t0)) if t1 - t0 <= MAX_GAP else None

    def isolated(self, robot: str) -> list[int]:
        """Return the stamps of the true poses between which nothing is interpolated [ns]."""
        stamps = [stamp for stamp, _ in self._poses[robot]]
        is_far = [later - stamp > MAX_GAP for stamp, later in pairwise(stamps)]
        return [
            stamp for stamp, *far in zip(stamps, [True, *is_far], [*is_far, True]) if all(far)]

    def newest(self, robot: str) -> int | None:
        """Return the stamp of a robot's newest true pose."""
        poses = self._poses[robot]
        return poses[-1][0] if poses else None

    def pose(self, robot: str, stamp: int) -> Array:
        """
        Return the true pose of a robot at a stamp [ns], interpolated.

        Raises
        ------
        MissingTruthError
            If it is unknown.

        """
        pose = self.find(robot, stamp)
        if pose is None:
            raise MissingTruthError(
                f'no ground truth of {robot} at {stamp} ns: publish {robot}/ground_truth at or'
                ' around every stamp, or choose another filter than ideal')
        return pose

    def landmark(self, key: LandmarkKey) -> Array:
        """
        Return the true position of a landmark.

        Raises
        ------
        MissingTruthError
            If the landmark has no ground truth.

        """
        _, id_ = key
        if id_ not in self.landmarks:
            raise MissingTruthError(
                f'no ground truth of landmark {id_}: publish it on ground_truth/landmarks, or'
                ' choose another filter than ideal')
        return self.landmarks[id_]

    def rendezvous_point(self, key: RendezvousKey) -> Array:
        """Return the true position, kept until `keep_rendezvous_points` drops it."""
        if key not in self._rendezvous_points:
            self._rendezvous_points[key] = self.pose(key.observed, key.stamp)[:2]
        return self._rendezvous_points[key]

    def keep_rendezvous_points(self, keys: Container[RendezvousKey]) -> None:
        """Drop the true rendezvous points of all other keys."""
        self._rendezvous_points = {
            key: point for key, point in self._rendezvous_points.items() if key in keys}

    def forget_before(self, robot: str, stamp: int) -> None:
        """Drop all true poses before the latest one at or before a stamp."""
        self._drop(robot, bisect_left(self._poses[robot], (stamp + 1,)) - 1)

    def _drop(self, robot: str, count: int) -> list[int]:
        """Drop a number of a robot's oldest true poses, if above 0; return their stamps [ns]."""
        poses = self._poses[robot]
        stamps = [stamp for stamp, _ in poses[:max(count, 0)]]
        if stamps:
            del poses[:count]
            self._dropped[robot] = stamps[-1]
        return stamps


class LocalTruth:
    """Ground truth in a frame whose origin is the pose of a robot at a stamp [ns]."""

    def __init__(self, truth: Truth, robot: str, stamp: int) -> None:
        self._truth = truth
        self._start = robot, stamp

    @cached_property
    def _origin(self) -> Array:
        return self._truth.pose(*self._start)

    def pose(self, robot: str, stamp: int) -> Array:
        """Return the true pose of a robot at a stamp [ns]."""
        return between(self._origin, self._truth.pose(robot, stamp))

    def landmark(self, key: LandmarkKey) -> Array:
        """Return the true position of a landmark."""
        return self._local(self._truth.landmark(key))

    def rendezvous_point(self, key: RendezvousKey) -> Array:
        """Return the true position of the observed robot at the rendezvous."""
        return self._local(self._truth.rendezvous_point(key))

    def _local(self, point: Array) -> Array:
        local: Array = h(self._origin[None], point[None])[0]
        return local
