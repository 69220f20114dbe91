# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Alignment with another robot before any of its map arrives, section IV of [Andersson].

A robot sends its observations of the other one, and the square-root information A_m of its own map
about the poses at which either observed the other. The other robot adds its own observations and
its own A_m, and has the pose of the first in its frame by Algorithm 1. A few poses suffice; the
message has a few kB however large the map is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import struct

import numpy as np

from fej_slam_ros.core.csam.base_node import (
    Alignment, RendezvousInformation, RendezvousObservations)
from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous import (
    MAX_RENDEZVOUS_PAUSE, RendezvousMeasurement)
from fej_slam_ros.core.csam.rendezvous_alignment import aligned_but_for_outliers, AlignmentInput
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array, compose, upper_triangular
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.ordering.corrected_observations import corrected_robot_scan
from fej_slam_ros.core.peers.blocks import (
    BadBlockError, decoded, encoded, MAX_STAMP, MAX_VALUE, Measurement)
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.messages import MAX_BLOCK_SIZE
from fej_slam_ros.core.peers.team_logs import LogContents, TeamLogs
from fej_slam_ros.core.peers.union import unsolved
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.core.settings import Settings

#: Maximum number of own observations in a message, spread over the last rendezvous.
MAX_SENT = 8
#: Largest number of poses in a message: all own observations, all of the other one, and the start.
MAX_MESSAGE_POSES = 2 * MAX_SENT + 1
#: Numbers of poses, of the row of the middle one and of the start, and size of the observations.
_HEADER = struct.Struct('<HHHI')


@dataclass(frozen=True, slots=True, eq=False)
class WindowInformation:
    """Information about a rendezvous for the other robot."""

    stamps: tuple[int, ...]  #: times of its poses [ns]
    information: RendezvousInformation  #: its map about these poses, in the same order
    scans: tuple[RobotScan, ...]  #: its observations of the other robot, corrected


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousTask:
    """Input of `solve_rendezvous`."""

    settings: Settings  #: whose only robot is this one
    log: LogContents  #: measurements of this robot
    peer: str  #: name of the other robot
    received: bytes  #: information of the other robot about this one, empty before it arrives


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousResult:
    """Result of `solve_rendezvous`."""

    message: bytes  #: information for the other robot, empty if there is no observation yet
    #: pose of the other robot's map in that of this one, or why there is none
    alignment: Alignment | JoinFailure
    stamp: int  #: newest time at which either observed the other [ns]
    pose: Array | None  #: (3,) pose of the other robot then, in the map of this one


def rendezvous_task(logs: TeamLogs, settings: Settings, peer: str) -> RendezvousTask:
    """Return the task of a robot for its rendezvous with another."""
    robots = tuple(robot for robot in settings.robots if robot.name == logs.robot)
    log = logs.logs.get(LogName(peer, logs.robot))
    received = b'' if log is None else b''.join(log.blocks)
    return RendezvousTask(
        replace(settings, robots=robots), logs.contents(logs.robot), peer, received)


def contents(message: bytes) -> list[bytes]:
    """Return a message as contents of blocks."""
    return [message[k:k + MAX_BLOCK_SIZE] for k in range(0, len(message), MAX_BLOCK_SIZE)]


def solve_rendezvous(task: RendezvousTask) -> RendezvousResult | None:
    """Return the information for the other robot and the alignment of the maps, None if none."""
    robot, = task.settings.robots
    try:
        theirs = read(task.received, task.peer, robot.name)
    except BadBlockError:
        theirs = None
    sent = _window(task, theirs)
    if sent is None:
        return None
    if theirs is None:
        return RendezvousResult(
            write(sent), JoinFailure(f'{task.peer} has sent no rendezvous information'),
            max(sent.stamps), None)
    alignment = _aligned(robot.name, sent, theirs)
    newest = max(range(len(theirs.stamps)), key=theirs.stamps.__getitem__)
    pose = None if isinstance(alignment, JoinFailure) else compose(
        alignment.base_node.pose, theirs.information.in_map(newest))
    return RendezvousResult(write(sent), alignment, theirs.stamps[newest], pose)


def _window(task: RendezvousTask, theirs: WindowInformation | None) -> WindowInformation | None:
    """Return the information of this robot, None without observations or without a map."""
    measurements, (robot,) = task.log.measurements(), task.settings.robots
    # The other robot does not know the errors of this one before it has the log.
    own = [corrected_robot_scan(m, robot) for m in _observations(measurements, task.peer)]
    observed_at = {scan.stamp for scan in (*own, *(theirs.scans if theirs else ()))}
    if not observed_at:
        return None
    try:
        local, index = _local_map(task.settings, measurements, observed_at)
        stamps = sorted(observed_at & index.keys())
        if not stamps:
            return None
        information = local.rendezvous_information(np.array([index[t] for t in stamps], np.intp))
    except NoMinimumError:
        return None
    # The first pose, which is fixed in the map, was added if it is not one of the rendezvous.
    added = [min(index)] if len(information.poses) > len(stamps) else []
    return WindowInformation(
        (*stamps, *added), information, tuple(scan for scan in own if scan.stamp in index))


def write(window: WindowInformation) -> bytes:
    """Return information as bytes; R_sqrt has single precision, which costs 1e-7 of a sigma."""
    scans, information = encoded(window.scans), window.information
    return b''.join([
        _HEADER.pack(len(window.stamps), information.middle, information.start, len(scans)),
        np.array(window.stamps, '<i8').tobytes(), information.origin.astype('<f8').tobytes(),
        information.poses.astype('<f8').tobytes(),
        information.R_sqrt[np.triu_indices(len(information.R_sqrt))].astype('<f4').tobytes(),
        scans])


def read(message: bytes, sender: str, receiver: str) -> WindowInformation | None:
    """Return the information in a message, None in an empty one, or raise a BadBlockError."""
    if not message:
        return None
    if len(message) < _HEADER.size:
        raise BadBlockError('it is too short')
    count, middle, start, size = _HEADER.unpack_from(message)
    n = 3 * count - 3
    sizes = [8 * count, 24, 24 * count, 2 * n * (n + 1), size]
    if not 0 < count <= MAX_MESSAGE_POSES or max(middle, start) >= count or (
            len(message) != _HEADER.size + sum(sizes)):
        raise BadBlockError('its size is not that of its content')
    ends = np.cumsum([_HEADER.size, *sizes]).tolist()
    stamps, origin, poses, packed, scans = (
        message[begin:end] for begin, end in pairwise(ends))
    information = RendezvousInformation(
        np.frombuffer(poses, '<f8').reshape(-1, 3), middle, start, np.frombuffer(origin, '<f8'),
        upper_triangular(np.frombuffer(packed, '<f4').astype(np.float64)))
    for values in (information.poses, information.origin, information.R_sqrt):
        # R_sqrt is empty where the only pose is that of the start.
        if not np.abs(values).max(initial=0.0) <= MAX_VALUE:
            raise BadBlockError('it has numbers that are not finite')
    times = tuple(np.frombuffer(stamps, '<i8').tolist())
    observations = [
        scan for scan in decoded(scans, sender) if isinstance(scan, RobotScan)
        and {o.observed for o in scan.observations} == {receiver}]
    if len(observations) > MAX_SENT or not 0 <= min(times) <= max(times) <= MAX_STAMP:
        raise BadBlockError('it has too many observations, or times that are none')
    return WindowInformation(times, information, tuple(observations))


def _observations(measurements: Sequence[Measurement], peer: str) -> list[RobotScan]:
    """Return observations of another robot in the last rendezvous, spread over it."""
    newest = max((m.stamp for m in measurements if isinstance(m, Odometry)), default=0)
    reached = [m for m in measurements if isinstance(m, RobotScan) and m.stamp <= newest]
    scans: list[RobotScan] = []
    for scan in sorted(reached, key=lambda m: m.stamp):
        observations = tuple(o for o in scan.observations if o.observed == peer)
        if observations:
            if scans and scan.stamp - scans[-1].stamp > MAX_RENDEZVOUS_PAUSE:
                scans.clear()
            scans.append(replace(scan, observations=observations))
    chosen = np.unique(np.linspace(0, len(scans) - 1, min(len(scans), MAX_SENT)).round())
    return [scans[int(k)] for k in chosen]


def _local_map(
    settings: Settings, measurements: Sequence[Measurement], stamps: set[int]
) -> tuple[JointMap, dict[int, int]]:
    """Return the map of this robot with all poses, some at given stamps, and their indices."""
    robot, = settings.robots
    settings = replace(settings, keyframe_distance=0.0)
    records: list[Measurement] = [
        *(m for m in measurements if not isinstance(m, RobotScan)),
        *(Scan(robot.name, stamp, ()) for stamp in stamps)]
    team = unsolved(settings, sorted(records, key=lambda m: m.stamp))
    trajectory = team.trajectories.get(robot.name)
    if trajectory is None or trajectory.is_empty():
        raise NoMinimumError(f'{robot.name} has not moved')
    local = JointMap.of(trajectory.local_map(robot.name))
    return local, {stamp: k for k, stamp in enumerate(trajectory.stamps)}


def _aligned(
    robot: str, own: WindowInformation, theirs: WindowInformation
) -> Alignment | JoinFailure:
    """Return the pose of the map of the other robot in that of this one."""
    row = {stamp: k for k, stamp in enumerate(own.stamps)}
    their_row = {stamp: k for k, stamp in enumerate(theirs.stamps)}
    measurements = sorted((
        RendezvousMeasurement(
            scan.robot, of_observer[scan.stamp], o.observed, of_observed[scan.stamp], o.z, o.R,
            scan.stamp)
        for scans, of_observer, of_observed in (
            (theirs.scans, their_row, row), (own.scans, row, their_row))
        for scan in scans if scan.stamp in row and scan.stamp in their_row
        for o in scan.observations), key=lambda m: m.stamp)
    if not measurements:
        return JoinFailure('neither robot has a pose at an observation of the other')

    def input_of(window: Sequence[RendezvousMeasurement]) -> AlignmentInput:
        return own.information, theirs.information, RendezvousObservations(
            np.array([row[m.stamp] for m in window], np.intp),
            np.array([their_row[m.stamp] for m in window], np.intp),
            np.array([m.observer == robot for m in window], np.bool_),
            np.array([m.z for m in window]), np.array([m.R for m in window]))

    found = aligned_but_for_outliers(measurements, input_of, DEFAULT_RULES)
    return found if isinstance(found, JoinFailure) else found[0]
