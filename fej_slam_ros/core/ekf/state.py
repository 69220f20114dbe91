# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The joint state of robots and landmarks in one frame, eq. (1) of [Liu] for any number of robots.

Every variable has a slot; at its slot the joint state holds its estimate, its first estimate and
its covariance. Robots are independent between updates, so each is kept at a stamp of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
import sys

import numpy as np

from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.covariance import Covariance, Slot
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import LandmarkKey, NO_ID, PriorMap, RendezvousKey

#: A landmark was moved when so many observations in a row fail, from positions so far apart [m].
DOUBTED_TIMES = 10
DOUBTED_FROM = 2.0


@dataclass(slots=True, eq=False)
class Robot:
    """A robot's slot and the stamp [ns] that its pose is of."""

    name: str
    slot: Slot
    stamp: int


@dataclass(slots=True, eq=False)
class MovedLandmarkEvidence:
    """
    What speaks for a landmark having been moved: its last observations, none of which has passed.

    Attributes
    ----------
    observations : how many
    robots : names of those that made them
    low, high : (2,) arrays, corners of the box in which these robots were [m]

    """

    observations: int = 0
    robots: set[str] = field(default_factory=set)
    low: Array = field(default_factory=lambda: np.full(2, np.inf))
    high: Array = field(default_factory=lambda: np.full(2, -np.inf))

    def add(self, robot: str, position: Array) -> None:
        """Take in an observation that failed the gate, from a position (2,)."""
        self.observations += 1
        self.robots.add(robot)
        self.low = np.minimum(self.low, position)
        self.high = np.maximum(self.high, position)

    def is_certain(self) -> bool:
        """Return whether there are enough of them, from far enough apart or by two robots."""
        apart = float(np.linalg.norm(self.high - self.low)) >= DOUBTED_FROM
        return self.observations >= DOUBTED_TIMES and (apart or len(self.robots) > 1)


@dataclass(slots=True, eq=False)
class TentativeEvidence:
    """
    What speaks for a landmark that nobody has numbered being there.

    Attributes
    ----------
    score : how much oftener it was seen again than missed
    unseen : in how many scans in a row of the robot that started it, or where that has left of
        any, it was not seen

    """

    score: int = 0
    unseen: int = 0


@dataclass(slots=True, eq=False)
class Landmark:
    """
    A landmark.

    Attributes
    ----------
    key, slot : its identity and its place
    owner, started : the robot that saw it first, and when [ns]; where it was known before, ``''``
        and the beginning of time
    confirmed : stamp of its last observation that passed the gate, in the present frame
    doubt : what has spoken against it since, if anything has
    provisional : what has spoken for it, while it does not count yet
    distinct : landmarks next to it that one scan has shown together with it

    """

    key: LandmarkKey
    slot: Slot
    owner: str
    started: int
    confirmed: int = field(init=False)
    doubt: MovedLandmarkEvidence | None = field(default=None, init=False)
    tentative: TentativeEvidence | None = None
    distinct: set[LandmarkKey] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.confirmed = self.started

    def was_moved(self) -> bool:
        """Return whether it is not any more where the map has it."""
        return self.doubt is not None and self.doubt.is_certain()


@dataclass(slots=True, eq=False)
class RendezvousPoint:
    """
    Where a robot of another frame was when it was seen: a point that both frames know.

    Attributes
    ----------
    key, slot : its identity and its place
    owner : the robot of this frame that saw, or was seen

    """

    key: RendezvousKey
    slot: Slot
    owner: str


Variable = Robot | Landmark | RendezvousPoint

#: Where a pose or a position is from the start of a variable on, and both of them of two.
POSE, POSITION = np.arange(3), np.arange(2)
OF_TWO, POSE_AND_POSITION = np.array([0, 0, 0, 1, 1]), np.array([0, 1, 2, 0, 1])


@dataclass(frozen=True, slots=True, eq=False)
class ObservationColumns:
    """
    Which robots see what.

    Attributes
    ----------
    by, of : m robots, and what each sees
    columns : (m, 5) array, the slots of the pose and of the position

    """

    by: Sequence[Robot]
    of: Sequence[Variable]
    columns: Indices


class JointState:
    """
    Robots and landmarks in one frame.

    Attributes
    ----------
    robots, landmarks, places : the variables, in the order in which they came
    x_hat : (n,) array, the estimate; of what is outside of a region that of when it was entered
    x_first : (n,) array, the first estimate: of a landmark or place its value when it was started,
        of a robot its pose right after its own prediction to its present stamp
    covariance : the joint covariance of the estimate, which may be that of a region

    """

    def __init__(self) -> None:
        self._owners: tuple[Indices, Indices, Indices] | None = None
        self._headings: Indices | None = None
        self.robots: dict[str, Robot] = {}
        self.landmarks: dict[LandmarkKey, Landmark] = {}
        self.places: dict[RendezvousKey, RendezvousPoint] = {}
        self.x_hat: Array = np.empty(0)
        self.x_first: Array = np.empty(0)
        self.covariance: Covariance | CompressedCovariance = Covariance()

    def estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's estimate."""
        slot = variable.slot
        x = self.x_hat[slot.start:slot.stop].copy()
        if isinstance(self.covariance, CompressedCovariance) and not self.covariance.has(slot):
            x += self.covariance.owed(slot.indices)
        return x

    def estimates(self) -> Array:
        """Return the estimate (n,), which may be changed by nobody."""
        if isinstance(self.covariance, CompressedCovariance):
            return self.estimates_of(np.arange(len(self.x_hat)))
        return self.x_hat

    def estimates_of(self, states: Indices) -> Array:
        """Return the estimates of states that are given by their indices, in any shape."""
        x: Array = self.x_hat[states]
        if isinstance(self.covariance, CompressedCovariance) and not self.covariance.holds(states):
            x += self.covariance.owed(states.ravel()).reshape(states.shape)
        return x

    def mapped(self, landmarks: Sequence[Landmark]) -> tuple[Array, Array]:
        """Return positions (l, 2) of landmarks and the covariance (l, 2, 2) of each."""
        where = self.positions(landmarks)
        return self.estimates_of(where), self.covariance.blocks(where)

    def whole(self) -> Covariance:
        """Leave the region, if there is one; return the covariance of everything."""
        if isinstance(self.covariance, CompressedCovariance):
            self.covariance, dx = self.covariance.leave()
            self.x_hat = self.x_hat + dx
        return self.covariance

    def enter(self, region: Indices) -> None:
        """Let everything happen in a region, given by the indices of its states, in order."""
        self.covariance = CompressedCovariance(self.whole(), region)

    def first_estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's first estimate."""
        return self.x_first[variable.slot.start:variable.slot.stop].copy()

    def marginal(self, variables: Sequence[Variable]) -> Array:
        """Return the joint covariance of the variables."""
        return self.covariance.marginal([variable.slot for variable in variables])

    def poses(self, robots: Sequence[Robot]) -> Indices:
        """Return the slots of m robots, (m, 3)."""
        return _starts(robots) + POSE

    def positions(self, variables: Sequence[Variable]) -> Indices:
        """Return the slots of the positions of m variables, (m, 2)."""
        return _starts(variables) + POSITION

    def sighted(self, by: Sequence[Robot], of: Sequence[Variable]) -> ObservationColumns:
        """Return how m robots see m variables, one each."""
        starts = np.array([variable.slot.start for variable in (*by, *of)], np.intp)
        return ObservationColumns(by, of, starts.reshape(2, -1).T.take(OF_TWO, 1) + POSE_AND_POSITION)

    def variables(self) -> list[Variable]:
        """Return everything in the order of the slots, which leave no gap."""
        return sorted(
            [*self.robots.values(), *self.landmarks.values(), *self.places.values()],
            key=lambda v: v.slot.start)

    def confirmed_landmarks(self) -> list[Landmark]:
        """Return the landmarks that count, in the order in which they came."""
        return [f for f in self.landmarks.values() if f.tentative is None]

    def headings(self) -> Indices:
        """Return the slots of the robots' headings."""
        if self._headings is None:
            self._headings = self.poses([*self.robots.values()])[:, 2]
        return self._headings

    def owners(self) -> tuple[Indices, Indices, Indices]:
        """
        Return which positions turn when the heading of a robot is corrected, and which heading.

        Everything turns with its owner, or with the first robot of the state where that has left;
        landmarks that were known before any robot came turn with none.

        Returns
        -------
        positions : (k, 2) array, their slots
        owner : (k,) array, for each the number of its heading
        headings : (h,) array, the slots of the headings

        """
        if self._owners is None:
            first = next(iter(self.robots.values()), None)
            turning: list[Variable] = [*self.robots.values()]
            owners = [*self.robots.values()]
            points: list[Landmark | RendezvousPoint] = [*self.landmarks.values(), *self.places.values()]
            for variable in points:
                owner = self.robots.get(variable.owner, first) if variable.owner else None
                if owner is not None:
                    turning.append(variable)
                    owners.append(owner)
            slots = np.array([owner.slot.start + 2 for owner in owners], dtype=np.intp)
            headings, owner_of = np.unique(slots, return_inverse=True)
            self._owners = self.positions(turning), owner_of, headings
        return self._owners

    @classmethod
    def of(
        cls, variables: Sequence[Variable], x_hat: Array, x_first: Array, covariance: Covariance,
    ) -> 'JointState':
        """Return the state of variables whose slots in the covariance are given."""
        state = cls()
        state.robots = {v.name: v for v in variables if isinstance(v, Robot)}
        state.landmarks = {v.key: v for v in variables if isinstance(v, Landmark)}
        state.places = {v.key: v for v in variables if isinstance(v, RendezvousPoint)}
        state.x_hat, state.x_first, state.covariance = x_hat, x_first, covariance
        return state

    @classmethod
    def knowing(cls, prior: PriorMap) -> 'JointState':
        """Return the state of landmarks that are known; that is their first estimate, too."""
        covariance = Covariance()
        slots = covariance.insert_joint(prior.P, [2] * len(prior.ids))
        landmarks = [
            Landmark(('', number), slot, '', -sys.maxsize)
            for number, slot in zip(prior.ids, slots)]
        x = prior.points.ravel()
        return cls.of(landmarks, x.copy(), x.copy(), covariance)

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> Robot:
        """Add a robot whose pose is known with covariance P (3, 3), independent of all else."""
        robot = self.robots[name] = Robot(name, self.covariance.insert(P), stamp)
        self._append(pose)
        return robot

    def augment(
        self, key: LandmarkKey, owner: Robot, point: Array, F: Array, N: Array
    ) -> Landmark:
        """Add a landmark at point (2,) that depends on its owner's pose by F, with noise N."""
        slot = self.covariance.augment(owner.slot, F, N)
        tentative = TentativeEvidence() if key[1] < NO_ID else None
        landmark = self.landmarks[key] = Landmark(
            key, slot, owner.name, owner.stamp, tentative)
        self._append(point)
        return landmark

    def augment_place(
        self, key: RendezvousKey, owner: Robot, point: Array, F: Array, N: Array
    ) -> None:
        """Add a place in the same way."""
        self.places[key] = RendezvousPoint(key, self.covariance.augment(owner.slot, F, N), owner.name)
        self._append(point)

    def remove(self, variable: Variable) -> None:
        """Marginalise a variable out: what is known of all others stays as it is."""
        if isinstance(variable, Robot):
            del self.robots[variable.name]
        elif isinstance(variable, Landmark):
            del self.landmarks[variable.key]
        else:
            del self.places[variable.key]
        self._owners = self._headings = None
        whole = self.whole()
        gone = variable.slot.indices
        self.x_hat, self.x_first = np.delete(self.x_hat, gone), np.delete(self.x_first, gone)
        whole.remove([variable.slot], [other.slot for other in self.variables()])

    def move(self, robot: Robot, stamp: int, pose: Array) -> None:
        """Put a robot at its predicted pose, which is its first estimate at this stamp."""
        place = slice(robot.slot.start, robot.slot.stop)
        self.x_hat[place] = self.x_first[place] = pose
        robot.stamp = stamp

    def _append(self, value: Array) -> None:
        self._owners = self._headings = None
        self.x_hat = np.append(self.x_hat, value)
        self.x_first = np.append(self.x_first, value)


def _starts(variables: Sequence[Variable]) -> Indices:
    """Return where the slots of m variables start, (m, 1)."""
    return np.array([variable.slot.start for variable in variables], np.intp)[:, None]
