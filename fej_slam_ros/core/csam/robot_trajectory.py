# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory and map of one robot, grown pose by pose, and its frame in the team's map."""

from collections.abc import Iterator, Sequence

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.frame_by_landmarks import frame_by_landmarks, MIN_FOUND
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.csam.team_solution import SmoothedMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import LandmarkKey, Motion, Observation, UNKNOWN_POSE_COVARIANCE
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother


class RobotTrajectory:
    """
    All poses of one robot that are kept, and the newest one.

    Poses up to the last adopted solution have its covariances, later ones those of a filter. The
    poses after a motion that is not known are in a frame of their own until the robot observes
    some of its landmarks again, and in no solution before.

    """

    def __init__(
        self, robot: str, stamp: int, observations: tuple[Observation, ...], solve_every: int
    ) -> None:
        self.stamps = [stamp]  #: of the poses that are kept [ns]
        self.frame = own_frame(robot)  #: name of the frame of all estimates
        #: message if the newest pose or the robot's own map could not be solved for, else ''
        self.error = ''
        self._newest_stamp = stamp
        self._robot = robot
        self._solve_every = solve_every
        self._smoother = IncrementalSmoother(observations, solve_every)
        self._P_solved = np.zeros((1, 3, 3))
        # The poses since the robot was lost, and their stamps.
        self._lost: IncrementalSmoother | None = None
        self._lost_stamps: list[int] = []

    @property
    def is_lost(self) -> bool:
        """Return whether it is not known where the newest pose is in the map of the others."""
        return self._lost is not None

    def lose(self, stamp: int, observations: tuple[Observation, ...]) -> None:
        """Continue in a new frame after a motion that is not known."""
        self._start_own_frame(stamp, observations)
        self._find()

    def place(
        self, stamp: int, pose: Array, P: Array, observations: tuple[Observation, ...]
    ) -> None:
        """
        Continue at a pose (3,) of covariance P (3, 3) in the present frame, given from outside.

        It counts as a motion from the last pose that is kept, whose covariance is added: that of
        the new pose is too large by twice that of the last one, and never too small.

        """
        last, P_last = self.poses()[-1], self.covariances()[-1]
        Phi, C = models.Phi(pose[:2] - last[:2]), models.G(last[2])
        Q = C.T @ (P + Phi @ P_last @ Phi.T) @ C
        self._attach(self._start_own_frame(stamp, observations), pose, Q)

    def add(self, motion: Motion, observations: tuple[Observation, ...]) -> None:
        """Add the next pose and the observations from it."""
        try:
            self._growing.add(motion.u, motion.Q, observations)
            self.error = self._growing.error
        except NoMinimumError as error:
            self.error = str(error)
        self._newest_stamp = motion.stamp
        (self.stamps if self._lost is None else self._lost_stamps).append(motion.stamp)
        if observations:
            self._find()

    def add_between_keyframes(self, motion: Motion, observations: tuple[Observation, ...]) -> None:
        """Move to a pose that is not kept: its observations correct the newest pose only."""
        self._newest_stamp = motion.stamp
        self._growing.add_between_keyframes(motion.u, motion.Q, observations)
        self.error = self._growing.error

    def newest(self) -> PoseEstimate:
        """Return the newest pose."""
        frame = self.frame if self._lost is None else own_frame(self._robot)
        return PoseEstimate(
            self._robot, self._newest_stamp, frame, self._growing.pose, self._growing.P)

    def poses(self) -> Array:
        """Return the poses that are kept, an (n, 3) array."""
        return self._smoother.values().poses

    def covariances(self) -> Array:
        """Return the covariances of these poses, an (n, 3, 3) array."""
        return np.concatenate([self._P_solved, self._smoother.covariances()])

    def estimates(self) -> Iterator[PoseEstimate]:
        """Yield the poses that are kept, with their covariances."""
        for stamp, pose, P in zip(self.stamps, self.poses(), self.covariances()):
            yield PoseEstimate(self._robot, stamp, self.frame, pose, P)

    def is_empty(self) -> bool:
        """Return whether there are no measurements."""
        return len(self.stamps) == 1 and not self._smoother.landmark_index

    def landmark_keys(self, owner: str) -> tuple[LandmarkKey, ...]:
        """Return the keys of all landmarks; `owner` is the first part of each."""
        return tuple((owner, id_) for id_ in self._smoother.landmark_index)

    def local_map(self, owner: str) -> LocalMap:
        """Return the robot's own map; `owner` is the first part of its landmark keys."""
        values = self._smoother.values()
        return LocalMap(
            self._robot, self._smoother.problem(), values.in_frame_of(values.poses[0]),
            self.landmark_keys(owner))

    def adopt(self, solved: SmoothedMap) -> None:
        """Set the first poses and landmarks to a solution; estimate the later ones from it."""
        trajectory = solved.trajectories[self._robot]
        self.frame, self._P_solved = solved.frame, trajectory.P
        self._smoother.adopt(
            Values(trajectory.poses, solved.points[trajectory.landmarks]), trajectory.near)

    def lost_observations(self) -> list[tuple[int, int]]:
        """Return stamp [ns] and landmark of each observation since the robot was lost."""
        if self._lost is None:
            return []
        return stamped(
            self._lost.problem().landmarks, self._lost_stamps, [*self._lost.landmark_index])

    def why_lost(self) -> str:
        """Return why a robot is still lost."""
        known = len(self._smoother.landmark_index)
        if known < MIN_FOUND:
            count = counted(known, 'landmark')
            return f'it is lost: its map has {count}, needs {MIN_FOUND} to be found again by them'
        return (
            f'it is lost: {len(self._observed_again())} of the landmarks of its map are observed'
            f' again, needs {MIN_FOUND} that fit')

    @property
    def _growing(self) -> IncrementalSmoother:
        """Return the smoother of the newest pose."""
        return self._smoother if self._lost is None else self._lost

    def _observed_again(self) -> list[int]:
        """Return the landmarks of the map that were observed since the robot was lost."""
        lost = () if self._lost is None else self._lost.landmark_index
        return [id_ for id_ in lost if id_ in self._smoother.landmark_index]

    def _find(self) -> None:
        """Append the poses since the robot was lost if enough landmarks are observed again."""
        lost, known, shared = self._lost, self._smoother, self._observed_again()
        if lost is None or len(shared) < MIN_FOUND:
            return
        g = frame_by_landmarks(*(
            smoother.values().points[[smoother.landmark_index[id_] for id_ in shared]]
            for smoother in (lost, known)))
        if g is not None:
            self._attach(lost, g)

    def _start_own_frame(
        self, stamp: int, observations: tuple[Observation, ...]
    ) -> IncrementalSmoother:
        """Start a new frame; poses that are in no map by now are lost."""
        self._newest_stamp, self._lost_stamps = stamp, [stamp]
        self._lost = IncrementalSmoother(observations, self._solve_every)
        return self._lost

    def _attach(
        self, later: IncrementalSmoother, g: Array, Q: Array = UNKNOWN_POSE_COVARIANCE
    ) -> None:
        """Append the poses since the robot was lost, in a frame with pose g (3,) in this one."""
        self.stamps += self._lost_stamps
        self._lost, self._lost_stamps = None, []
        try:
            self._smoother.append(later, g, Q)
        except NoMinimumError as error:
            self.error = str(error)


def stamped(
    observed: LandmarkFactors, stamps: Sequence[int], ids: Sequence[int]
) -> list[tuple[int, int]]:
    """Return stamp [ns] and ID of each observation, given those of all poses and landmarks."""
    return [(stamps[k], ids[j]) for k, j in zip(observed.pose.tolist(), observed.target.tolist())]
