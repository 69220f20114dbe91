# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The joint state of robots and landmarks in one frame, eq. (1) of [Liu] for any number of robots.

Every variable has a slot; at this slot the joint state holds its estimate, its first estimate and
its covariance. Robots are independent between updates, so each pose has its own stamp.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field
import sys
from typing import TypeVar

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance, joint_indices, Slot
from fej_slam_ros.core.ekf.joint_covariance import JointCovariance
from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence, TentativeEvidence
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import LandmarkKey, NO_ID, PriorMap, RendezvousKey


@dataclass(slots=True, eq=False)
class Robot:
    """A robot's slot and the stamp [ns] of its pose."""

    name: str
    slot: Slot
    stamp: int
    #: variance [rad^2] of its turn by odometry since an update by its observations or of it
    turn_variance: float = 0.0


@dataclass(slots=True, eq=False)
class Landmark:
    """A landmark."""

    key: LandmarkKey
    slot: Slot
    owner: str  #: the first observer, ``''`` for a landmark of a prior map
    created: int  #: stamp of its first observation [ns], ``-sys.maxsize`` in a prior map
    #: stamp of its latest observation that passed the gate
    last_accepted: int = field(init=False)
    #: evidence since then that it was moved, None without any
    moved_evidence: MovedLandmarkEvidence | None = field(default=None, init=False)
    tentative: TentativeEvidence | None = None  #: None for a confirmed landmark
    #: nearby landmarks that were observed in the same scan as this one
    distinct: set[LandmarkKey] = field(default_factory=set)
    #: whether a scan that other trusted landmarks confirm has observed it since its first
    #: observation; the first landmarks of a map are trusted
    is_trusted: bool = True
    #: whether an observation since its first one has passed the gate
    is_reobserved: bool = False
    #: robot with whose heading the invariant filter turns it, at first its owner
    rotation_owner: str = ''

    def __post_init__(self) -> None:
        self.last_accepted = self.created
        self.rotation_owner = self.rotation_owner or self.owner

    def absorb(self, duplicate: 'Landmark') -> None:
        """Take over what is known of a second variable of the same landmark, by observations."""
        self.created = min(self.created, duplicate.created)
        self.distinct |= duplicate.distinct
        self.is_reobserved = True

    def was_moved(self) -> bool:
        """Return whether the landmark has likely been moved since it was mapped."""
        return self.moved_evidence is not None and self.moved_evidence.is_sufficient()


@dataclass(slots=True, eq=False)
class RendezvousPoint:
    """Position of a robot of another frame at its observation, a point in both frames."""

    key: RendezvousKey
    slot: Slot
    owner: str  #: observer or observed robot, whichever is in this frame


Variable = Robot | Landmark | RendezvousPoint
Variables = Sequence[Variable]
VariableT = TypeVar('VariableT', bound=Variable)

#: States of a pose and of a position, counted from the start of the variable.
POSE, POSITION = np.arange(3), np.arange(2)


class VariableSet:
    """
    Robots, landmarks and rendezvous points with their slots in a joint vector.

    Each kind is in order of creation; the slots of all variables are contiguous.

    """

    def __init__(self, variables: Iterable[Variable] = ()) -> None:
        self._heading_owners: tuple[Indices, Indices, Indices] | None = None
        self._headings: Indices | None = None
        self._landmark_positions: Indices | None = None
        self.robots: dict[str, Robot] = {}
        self.landmarks: dict[LandmarkKey, Landmark] = {}
        self.rendezvous_points: dict[RendezvousKey, RendezvousPoint] = {}
        for variable in variables:
            self._add(variable)

    def variables(self) -> list[Variable]:
        """Return all variables in the order of their slots."""
        return sorted(
            [*self.robots.values(), *self.landmarks.values(), *self.rendezvous_points.values()],
            key=lambda v: v.slot.start)

    def confirmed_landmarks(self) -> list[Landmark]:
        """Return the landmarks that are not tentative, in order of creation."""
        return [f for f in self.landmarks.values() if f.tentative is None]

    def headings(self) -> Indices:
        """Return the indices (N,) of the robots' headings."""
        if self._headings is None:
            self._headings = pose_indices([*self.robots.values()])[:, 2]
        return self._headings

    def landmark_positions(self) -> Indices:
        """Return the indices (l, 2) of the landmarks' positions, in order of creation."""
        if self._landmark_positions is None:
            self._landmark_positions = position_indices([*self.landmarks.values()])
        return self._landmark_positions

    def heading_owners(self) -> tuple[Indices, Indices, Indices]:
        """
        Return the heading whose correction rotates each position.

        A landmark rotates with its `rotation_owner`, a rendezvous point with its owner, or both
        with the first robot if that has left; landmarks of a prior map do not rotate.

        Returns
        -------
        positions : (k, 2) array, indices of the positions
        owner : (k,) array, the row of `headings` for each
        headings : (h,) array, indices of the headings

        """
        if self._heading_owners is None:
            turning: list[Variable] = [*self.robots.values()]
            headings_of = self.headings().tolist()
            points: list[tuple[Variable, str]] = [
                (landmark, landmark.rotation_owner) for landmark in self.landmarks.values()]
            points += [(point, point.owner) for point in self.rendezvous_points.values()]
            heading_of = {name: self.heading_of(name) for name in {name for _, name in points}}
            for variable, name in points:
                heading = heading_of[name]
                if heading is not None:
                    turning.append(variable)
                    headings_of.append(heading)
            headings, owner_of = np.unique(np.array(headings_of, np.intp), return_inverse=True)
            self._heading_owners = position_indices(turning), owner_of, headings
        return self._heading_owners

    def heading_of(self, owner: str) -> int | None:
        """Return the heading that points of an owner turn with: if it has left, the first one."""
        first = next(iter(self.robots.values()), None)
        robot = self.robots.get(owner, first) if owner else None
        return None if robot is None else robot.slot.start + 2

    def set_rotation_owner(self, landmark: Landmark, robot: Robot) -> None:
        """Let a landmark rotate with a robot from now on."""
        landmark.rotation_owner, self._heading_owners = robot.name, None

    def _add(self, variable: Variable) -> None:
        if isinstance(variable, Robot):
            self.robots[variable.name] = variable
            self._headings = self._heading_owners = None
        elif isinstance(variable, Landmark):
            self.landmarks[variable.key] = variable
            self._landmark_positions = None
            self._add_heading_owner(variable)
        else:
            self.rendezvous_points[variable.key] = variable
            self._heading_owners = None

    def _add_heading_owner(self, landmark: Landmark) -> None:
        """Add a new landmark to `heading_owners`, which take long to make for a large map."""
        if self._heading_owners is None:
            return
        positions, owner, headings = self._heading_owners
        heading = self.heading_of(landmark.rotation_owner)
        if heading is not None:
            self._heading_owners = (
                np.concatenate([positions, landmark.slot.indices[None]]),
                np.append(owner, np.searchsorted(headings, heading)), headings)

    def _discard(self, variable: Variable) -> None:
        self._heading_owners = self._headings = self._landmark_positions = None
        if isinstance(variable, Robot):
            del self.robots[variable.name]
        elif isinstance(variable, Landmark):
            del self.landmarks[variable.key]
        else:
            del self.rendezvous_points[variable.key]


class JointState(VariableSet):
    """
    Variables with their estimates, first estimates and joint covariance.

    Parameters
    ----------
    variables : variables whose slots are given; by default there are none
    x_hat : (n,) array, the estimate; states outside an active submap lack its pending corrections
    x_first : (n,) array, the first estimate: of a point its value at its creation or the last
        renewal, of a robot its pose right after its prediction to its present stamp
    covariance : the joint covariance of the errors, complete or that of an active submap

    """

    def __init__(
        self, variables: Iterable[Variable] = (), x_hat: Array | None = None,
        x_first: Array | None = None, covariance: Covariance | None = None,
    ) -> None:
        super().__init__(variables)
        self.x_hat: Array = np.empty(0) if x_hat is None else x_hat
        self.x_first: Array = np.empty(0) if x_first is None else x_first
        self.covariance: JointCovariance = Covariance() if covariance is None else covariance

    def estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's estimate, (3,) of a robot and (2,) of a point."""
        slot = variable.slot
        return self.covariance.current_estimates(
            self.x_hat[slot.start:slot.stop].copy(), slot.indices)

    def pose(self, robot: Robot) -> Array:
        """Return a copy of a robot's estimate (3,), which is never outside a submap."""
        return self.x_hat[robot.slot.start:robot.slot.stop].copy()

    def estimates(self) -> Array:
        """Return the estimate (n,), which the caller must not modify."""
        return self.covariance.current_estimates(self.x_hat, np.arange(len(self.x_hat)))

    def estimates_of(self, states: Indices) -> Array:
        """Return the estimates of states given by their indices, in the same shape."""
        return self.covariance.current_estimates(self.x_hat[states], states)

    def most_certain_heading(self) -> int:
        """Return the index of the heading with the least variance, of a state with robots."""
        headings = self.headings()
        return int(headings[np.argmin(self.covariance.variance_bounds(headings[:, None]))])

    def first_estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's first estimate, of the shape of `estimate`."""
        return self.x_first[variable.slot.start:variable.slot.stop].copy()

    def marginal(self, variables: Sequence[Variable]) -> Array:
        """Return the joint covariance (k, k) of the variables, in the order given."""
        return self.covariance.marginal([variable.slot for variable in variables])

    def whole(self, may_end: bool = False) -> Covariance:
        """
        Leave the active submap, if there is one; return the covariance of all states.

        If it may end early, it raises EndedError then and changes nothing.

        """
        whole, self.x_hat = self.covariance.leave(self.x_hat, may_end)
        self.covariance = whole
        return whole

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> Robot:
        """Add a robot whose pose has covariance P (3, 3), independent of all other states."""
        robot = Robot(name, self.whole().insert(P), stamp)
        self._append(robot, pose)
        return robot

    def is_without_earlier_landmarks(self, stamp: int) -> bool:
        """Return whether all landmarks were created at a stamp [ns]."""
        return all(landmark.created == stamp for landmark in self.landmarks.values())

    def augment(
        self, key: LandmarkKey, owner: Robot, point: Array, F: Array, N: Array,
        is_first: bool = True,
    ) -> Landmark:
        """
        Add a landmark at point (2,) with F (2, 3) times the error of its owner plus noise N.

        It `is_first` if there are no landmarks from before.

        """
        slot = self.covariance.augment(owner.slot, F, N)
        tentative = TentativeEvidence() if key[1] < NO_ID else None
        landmark = Landmark(
            key, slot, owner.name, owner.stamp, tentative, is_trusted=is_first)
        self._append(landmark, point)
        return landmark

    def augment_rendezvous_point(
        self, key: RendezvousKey, owner: Robot, point: Array, F: Array, N: Array
    ) -> None:
        """Add a rendezvous point in the same way."""
        slot = self.covariance.augment(owner.slot, F, N)
        self._append(RendezvousPoint(key, slot, owner.name), point)

    def remove(self, variable: Variable) -> None:
        """Marginalise a variable out; the marginal of all others is unchanged."""
        self.remove_all([variable])

    def remove_all(self, variables: Sequence[Variable]) -> None:
        """Marginalise some variables out, at the cost of one, without leaving a submap."""
        if not variables:
            return
        slots = [variable.slot for variable in variables]
        for variable in variables:
            self._discard(variable)
        removed = joint_indices(slots)
        self.x_hat, self.x_first = np.delete(self.x_hat, removed), np.delete(self.x_first, removed)
        self.covariance.remove(slots, [other.slot for other in self.variables()])

    def move(self, robot: Robot, stamp: int, pose: Array) -> None:
        """Set a robot to its predicted pose (3,), which is its first estimate at this stamp."""
        states = slice(robot.slot.start, robot.slot.stop)
        self.x_hat[states] = self.x_first[states] = pose
        robot.stamp = stamp

    def _append(self, variable: Variable, value: Array) -> None:
        self._add(variable)
        self.x_hat = np.concatenate([self.x_hat, value])
        self.x_first = np.concatenate([self.x_first, value])


def part_of(state: JointState, variables: Sequence[Variable]) -> JointState:
    """Return a state of some variables only, in their order, with their joint marginal."""
    covariance = Covariance()
    slots = covariance.insert(state.marginal(variables)).split([v.slot.size for v in variables])
    return JointState(
        [at_slot(variable, slot) for variable, slot in zip(variables, slots)],
        np.concatenate([state.estimate(variable) for variable in variables]),
        np.concatenate([state.first_estimate(variable) for variable in variables]), covariance)


def at_slot(variable: VariableT, slot: Slot) -> VariableT:
    """Return a copy of a variable, with its evidence, at another slot."""
    moved = copy(variable)
    moved.slot = slot
    return moved


def state_of_prior_map(prior: PriorMap) -> JointState:
    """Return the state of the landmarks of a prior map; their estimates are first estimates."""
    covariance = Covariance()
    slots = covariance.insert(prior.P).split([2] * len(prior.ids))
    landmarks = [
        Landmark(('', id_), slot, '', -sys.maxsize, is_reobserved=True)
        for id_, slot in zip(prior.ids, slots)]
    x = prior.points.ravel()
    return JointState(landmarks, x.copy(), x.copy(), covariance)


def landmark_estimates(state: JointState, landmarks: Sequence[Landmark]) -> tuple[Array, Array]:
    """Return the positions (l, 2) of landmarks and the covariance (l, 2, 2) of each."""
    indices = position_indices(landmarks)
    return state.estimates_of(indices), state.covariance.blocks(indices)


def pose_indices(robots: Sequence[Robot]) -> Indices:
    """Return the indices of the poses of m robots, (m, 3)."""
    return _starts(robots) + POSE


def position_indices(variables: Sequence[Variable]) -> Indices:
    """Return the indices of the positions of m variables, (m, 2)."""
    return _starts(variables) + POSITION


def observation_columns(observers: Sequence[Robot], observed: Sequence[Variable]) -> Indices:
    """Return the states (m, 5) of observations: the observer's pose and the observed position."""
    return np.hstack([pose_indices(observers), position_indices(observed)])


def _starts(variables: Sequence[Variable]) -> Indices:
    return np.array([variable.slot.start for variable in variables], np.intp)[:, None]
