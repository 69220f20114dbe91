# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Frames, the robots in them and the filter of each frame.

The team is estimated in ``map``. A robot whose initial pose in ``map`` is unknown maps in a frame
of its own, ``<robot>/map``, with a filter of its own, until its frame group joins another one.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.active_submap import AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate, InflatingGate
from fej_slam_ros.core.ekf.linearization import Linearization, LINEARIZATIONS
from fej_slam_ros.core.ekf.state import JointState, landmark_estimates, Robot, state_of_prior_map
from fej_slam_ros.core.estimates import FrameMap
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array, wrap
from fej_slam_ros.core.ground_truth import LocalTruth, RecordedTruth, Truth
from fej_slam_ros.core.joining.rendezvous_points import marginalize, rendezvous_keys_of
from fej_slam_ros.core.records import is_too_uncertain, LandmarkKey, Motion, PriorMap
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple


@dataclass(slots=True, eq=False)
class FrameGroup:
    """Robots whose poses are estimated in one frame, and the map of that frame."""

    filter: Filter  #: estimates robots and landmarks jointly
    #: name of the robot that the frame is named after, ``''`` for the frame ``map``
    owner: str = ''
    #: whether the owner has restarted in a newer frame of its own
    is_previous: bool = False

    @property
    def frame(self) -> str:
        """Return the name of the frame."""
        if not self.owner:
            return MAP
        return own_frame(f'{self.owner}/before' if self.is_previous else self.owner)

    @property
    def state(self) -> JointState:
        """Return the joint state of robots and landmarks."""
        return self.filter.state

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Return the robots of the group by name."""
        return self.filter.state.robots

    def map(self) -> FrameMap:
        """Return the confirmed landmarks, ordered by ID."""
        landmarks = sorted(
            self.state.confirmed_landmarks(), key=lambda f: (f.key[1], f.key[0]))
        points, P = landmark_estimates(self.state, landmarks)
        return FrameMap(
            self.frame, tuple(self.robots), tuple(f.key for f in landmarks), points, P,
            len(self.state.landmarks) - len(landmarks))

    def prior_map(self) -> PriorMap:
        """Return the confirmed landmarks with joint covariance, as the prior map of a new run."""
        known = self.map()
        return PriorMap(
            tuple(id_ for _, id_ in known.keys), known.points,
            self.state.marginal([self.state.landmarks[key] for key in known.keys]))


class FrameGroups:
    """
    The frame groups of a team, each with its filter and robots.

    Policies that linearise at the true values find them in `truth`; the landmarks of `prior` are
    known in ``map`` beforehand.

    """

    def __init__(
        self, settings: Settings, truth: RecordedTruth, prior: PriorMap | None = None
    ) -> None:
        self._settings = settings
        self._truth = truth
        self.team = FrameGroup(self._new_filter(self._policy(truth)))  #: the group in ``map``
        if prior is not None:
            self.team.filter.state = state_of_prior_map(prior)
        #: groups in frames of their own, the latest (re)named one last; a group without robots is
        #: a map whose robots have all left, and joins like any other
        self.others: list[FrameGroup] = []
        self.robots: dict[str, RobotSettings] = {}  #: by name, in the order of processing
        self.not_in_map: dict[str, str] = {}  #: reason for each robot that is not in ``map``
        self.is_initialized = not settings.anchor  #: whether step 0 is done; true without anchor
        #: why the configured initial pose of a robot is not used; '' if it is used up
        self.void_starts: dict[str, str] = {}
        self._has_joined_robots = False  # whether robots have joined the team in ``map``
        # Increment u and covariance Q between the initial pose of a robot and its first odometry.
        self._motion_before: dict[str, tuple[Array, Array]] = {}

    def __iter__(self) -> Iterator[FrameGroup]:
        return iter((self.team, *self.others))

    def states(self) -> Sequence[JointState]:
        """Return the joint states of all frames, that of ``map`` first."""
        return [group.state for group in self]

    def of(self, robot: str) -> FrameGroup:
        """Return the group that a robot is in; raise a KeyError before its first odometry."""
        for group in self:
            if robot in group.robots:
                return group
        raise KeyError(robot)

    def change_settings(self, settings: Settings) -> None:
        """Use other settings of the gate from now on, in all frames."""
        self._settings = settings
        for group in self:
            group.filter.gate = _gate(settings)

    def may_leave(self, robot: str) -> bool:
        """Return whether a robot may leave the team: the anchor only after step 0."""
        return self.is_initialized or robot != self._settings.anchor

    def start_after(self, robot: str, u: Array, Q: Array) -> None:
        """Let a robot begin at an increment u (3,) from its initial pose, with covariance Q."""
        self._motion_before[robot] = u, Q

    def void_start(self, robot: str, reason: str) -> None:
        """Let a robot begin in a frame of its own; without its anchor, ``map`` has no step 0."""
        self.void_starts[robot] = reason
        if robot == self._settings.anchor:
            self.is_initialized = True

    def _has_reference(self) -> bool:
        """Return whether landmarks, robots or start poses in ``map`` fix it besides the anchor."""
        others = self.team.robots.keys() - {self._settings.anchor}
        return self._has_joined_robots or bool(others or self.team.state.landmarks) or any(
            map(self._has_start, self.robots.values()))

    def _has_start(self, robot: RobotSettings) -> bool:
        """Return whether a robot has a start pose that still counts and can be linearised."""
        return robot.start_pose is not None and robot.name not in self.void_starts and (
            not is_too_uncertain(np.diag(np.square(robot.start_sigma))))

    def is_map_given(self) -> bool:
        """Return whether more than the start of its anchor defines ``map``."""
        return any(self._settings.anchor_pose) or self._has_reference()

    def begin(self, robot: RobotSettings, stamp: int) -> None:
        """
        Add a robot at its first odometry: to ``map`` if its initial pose is known.

        One that is too uncertain to linearise is not known, unless the anchor defines ``map`` by
        it or step 0 is to solve for it.

        """
        initial = self._initial_pose(robot)
        if initial is not None and is_too_uncertain(np.diag(np.square(initial[1]))) and (
                self._has_reference() if robot.name == self._settings.anchor
                else self.is_initialized):
            self.void_start(robot.name, 'its start pose is too uncertain to linearise')
            initial = None
        if initial is None:
            self._begin_own_frame(robot.name, stamp)
            return
        (x, y, phi), sigma = initial
        self.team.state.insert_robot(
            robot.name, stamp, np.array([x, y, wrap(phi)]), np.diag(np.square(sigma)))
        if robot.name in self._motion_before:
            u, Q = self._motion_before.pop(robot.name)
            self.team.filter.predict(Motion(robot.name, stamp, u, Q))
        self.not_in_map.pop(robot.name, None)

    def restart(self, robot: str, stamp: int, reason: str) -> None:
        """Restart a robot whose pose is unknown: it relocalizes by joining with a new map."""
        self._take_out(robot)
        # An anchor that has observed no landmark yet may define ``map`` again by its present pose,
        # unless ``map`` is given otherwise: then there is no step 0.
        if robot == self._settings.anchor and (
                self.is_map_given() or robot in self.void_starts):
            self.is_initialized = True
        if self.may_leave(robot):
            self.void_starts[robot] = reason
        self.begin(self.robots[robot], stamp)

    def place(self, robot: str, stamp: int, pose: Array, P: Array) -> None:
        """
        Restart a robot in ``map`` at a pose (3,) of covariance P (3, 3), independent of the map.

        Its estimate so far is marginalized; the landmarks stay.

        """
        self._take_out(robot)
        self.void_starts[robot] = ''
        self.team.state.insert_robot(robot, stamp, pose, P)
        self.not_in_map.pop(robot, None)

    def leave(self, robot: str) -> None:
        """Marginalize a robot that leaves the team; its landmarks stay."""
        if any(robot in group.robots for group in self):
            self.void_starts[robot] = ''
        self._take_out(robot)
        self.not_in_map.pop(robot, None)

    def merge(self, group: FrameGroup, other: FrameGroup) -> None:
        """Remove a group whose state has been joined to that of another group."""
        self.others.remove(other)
        if group is self.team:
            self.mark_joined(other.robots)
        else:
            self.rename(group)

    def mark_joined(self, robots: Collection[str]) -> None:
        """Record that robots are in ``map``; a lost anchor no longer restarts at its origin."""
        for robot in robots:
            del self.not_in_map[robot]
        self._has_joined_robots = True

    def rename(self, group: FrameGroup) -> None:
        """Rename a group without its owner after another of its robots; drop an empty group."""
        if group.robots and group.owner not in group.robots:
            self.others.remove(group)
            self.others.append(group)
            group.owner, group.is_previous = next(iter(group.robots)), False
        elif not (group.robots or group.state.landmarks):
            self._drop(group)

    def moved_landmarks(self) -> list[LandmarkKey]:
        """Return the landmarks of all maps that are known to have been moved."""
        return sorted({
            landmark.key for state in self.states()
            for landmark in state.landmarks.values() if landmark.was_moved()})

    def _initial_pose(self, robot: RobotSettings) -> tuple[Triple, Triple] | None:
        """Return the configured initial pose and its standard deviations, None if unknown."""
        if robot.name in self.void_starts:
            return None
        if robot.name == self._settings.anchor:
            return self._settings.anchor_pose, self._settings.anchor_sigma
        return None if robot.start_pose is None else (robot.start_pose, robot.start_sigma)

    def _begin_own_frame(self, robot: str, stamp: int) -> None:
        """Start a robot in a frame whose origin is its present pose."""
        older = [group for group in self.others if group.owner == robot]
        for group in older[:-1]:
            self._drop(group)
        # The map of its previous frame may still join.
        for group in older[-1:]:
            self.others.remove(group)
            self.others.append(group)
            group.is_previous = True
        policy = self._policy(LocalTruth(self._truth, robot, stamp)).of_joining_maps()
        group = FrameGroup(self._new_filter(policy), robot)
        group.state.insert_robot(robot, stamp, np.zeros(3), np.zeros((3, 3)))
        self.others.append(group)
        self.not_in_map[robot] = self.void_starts.get(robot) or (
            'it has observed no landmark or robot since it began' if self.is_initialized
            else f'the anchor {self._settings.anchor} has observed no landmark')

    def _take_out(self, robot: str) -> None:
        """Marginalize a robot and its rendezvous points out of all states."""
        states = self.states()
        marginalize(rendezvous_keys_of(robot, states), states)
        for state in states:
            if robot in state.robots:
                state.remove(state.robots[robot])
        for group in [*self.others]:
            # Its previous map may have other robots, too, if it had joined that again.
            if group.owner == robot and (group.robots or not group.is_previous):
                self.rename(group)

    def _drop(self, group: FrameGroup) -> None:
        self.others.remove(group)
        marginalize([*group.state.rendezvous_points], self.states())

    def _policy(self, truth: Truth) -> Linearization:
        return LINEARIZATIONS[self._settings.filter](truth)

    def _new_filter(self, policy: Linearization) -> Filter:
        settings = self._settings
        return Filter(
            JointState(), policy, _gate(settings),
            settings.shared_landmark_ids, settings.update_iterations or policy.default_iterations,
            AROUND_ROBOTS if settings.compressed else WHOLE_MAP)


def _gate(settings: Settings) -> Gate:
    gate = InflatingGate if settings.inflate_rejected_scans else Gate
    return gate(settings.gate_probability)
