# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Collaborative smoothing and mapping, section IV of [Andersson]: maps of robots that met become one.

Each robot has smoothed its own way and map in a frame of its own. Where robots saw each other, or
share numbers of landmarks, a base node tells where one frame lies in the other; the minimum of eq.
(21) over all poses and landmarks is the joint map; landmarks that stand in it twice are found to
be one. Joined robots meet others as one map, so that any number of robots can come together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from fej_slam_ros.core.csam.base_node import (
    align, central, InconsistentError, NotAlignedError, RendezvousObservations, require_consistent)
from fej_slam_ros.core.csam.landmark_matching import match_landmarks
from fej_slam_ros.core.csam.maps import JointMap, LocalMap, placed
from fej_slam_ros.core.geometry import Array, rigid_fit
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.smoothing.least_squares import (
    concatenated, ConvergenceError, RendezvousFactors)
from fej_slam_ros.core.smoothing.normal_equations import SingularError

#: So many observations in the middle of a meeting take part in the alignment; all in the joint map.
MEETING = 50
#: Shared landmarks tell the heading better than this [rad], or the start may be too far away.
MAX_HEADING_SIGMA = 0.1

#: One of so many observations may be wrong; of fewer, nobody can tell which.
FEW = 10
#: Robots that did not see each other for so long [ns] meet another time.
PARTED = 20 * NS

#: Names of two robots.
RobotPair = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousMeasurement:
    """
    A robot seen by a robot, a rendezvous-measurement of [Andersson].

    Attributes
    ----------
    seer, pose : name of the robot that saw, and number of its pose
    seen, seen_pose : name of the robot that was seen, and number of its pose
    z : (2,) array, position of the seen robot in the base frame of the seer [m]
    R : (2, 2) array, covariance of z [m^2]
    stamp : time of both poses [ns]

    """

    observer: str
    pose: int
    seen: str
    seen_pose: int
    z: Array
    R: Array
    stamp: int


#: Two robots, and how they saw each other while they were near; not at all where they only share
#: landmarks.
Rendezvous = tuple[RobotPair, list[RendezvousMeasurement]]


@dataclass(frozen=True, slots=True)
class JoinRules:
    """
    When maps are joined.

    Attributes
    ----------
    min_shared : robots are also joined by at least so many landmarks that have one name
    probability : what is right is accepted with this chi-square probability; 1.0 accepts all

    """

    min_shared: int = 3
    probability: float = 1.0 - 1e-4


#: By these what is right is as good as never refused.
DEFAULT = JoinRules()


def join_maps(
    maps: Sequence[LocalMap], meetings: Sequence[RendezvousMeasurement], rules: JoinRules = DEFAULT
) -> tuple[list[JointMap], list[JoinFailure]]:
    """
    Return the maps after joining, of which each robot is part of one, and what failed.

    Parameters
    ----------
    maps : the maps of all robots; of those that are joined, the first one's frame is kept
    meetings : who saw whom, in the order of time
    rules : when they are joined

    """
    groups = [JointMap.of(local) for local in maps]
    notes: list[JoinFailure] = []
    groups, failed = _joined(groups, _encounters(maps, meetings), rules, notes)
    # Observations that are too few each time may do all together.
    groups, failed = _joined(groups, _united(failed), rules, notes)
    return (
        [match_landmarks(group).with_base_nodes() for group in groups],
        [*notes, *(JoinFailure(reason, pair) for (pair, _), reason in failed)])


def _encounters(maps: Sequence[LocalMap], meetings: Sequence[RendezvousMeasurement]) -> list[Rendezvous]:
    """Return who met whom, each time that they did, and who shares landmarks with whom."""
    names = [local.robot for local in maps]
    pairs: dict[RobotPair, list[list[RendezvousMeasurement]]] = {}
    for met in meetings:
        one, other = sorted((met.observer, met.seen), key=names.index)
        times = pairs.setdefault((one, other), [])
        if not times or met.stamp - times[-1][-1].stamp > PARTED:
            times.append([])
        times[-1].append(met)
    for p, q in combinations(maps, 2):
        if not set(p.landmarks).isdisjoint(q.landmarks):
            pairs.setdefault((p.robot, q.robot), [[]])
    return [(pair, met) for pair, times in pairs.items() for met in times]


def _united(failed: Sequence[tuple[Rendezvous, str]]) -> list[Rendezvous]:
    """Return all encounters of each pair as one."""
    united: dict[RobotPair, list[RendezvousMeasurement]] = {}
    for (pair, meetings), _ in failed:
        united.setdefault(pair, []).extend(meetings)
    return list(united.items())


def _joined(
    groups: list[JointMap], encounters: Sequence[Rendezvous], rules: JoinRules,
    notes: list[JoinFailure],
) -> tuple[list[JointMap], list[tuple[Rendezvous, str]]]:
    """Return the groups after encounters, and those that failed with the reason."""
    failed: list[tuple[Rendezvous, str]] = []
    for encounter in encounters:
        try:
            groups = _after(groups, encounter, rules, notes)
        except NotAlignedError as error:  # noqa: PERF203
            failed.append((encounter, str(error)))
    if len(failed) in {0, len(encounters)}:
        return groups, failed
    # What fails alone may do when others have brought the two together.
    return _joined(groups, [encounter for encounter, _ in failed], rules, notes)


def _after(
    groups: Sequence[JointMap], encounter: Rendezvous, rules: JoinRules, notes: list[JoinFailure]
) -> list[JointMap]:
    """Return the groups after an encounter, and note if some of its observations are left out."""
    pair, meetings = encounter
    right = list(meetings)
    limit = chi2.ppf(rules.probability, 2)
    while True:
        try:
            joined = _together(groups, (pair, right), rules)
            break
        except InconsistentError as error:
            left_out = len(meetings) - len(right)
            if left_out >= len(meetings) // FEW or error.gains.max(initial=0.0) <= limit:
                raise
            right.remove(alignment_window(right)[int(np.argmax(error.gains))])
    wrong, count = len(meetings) - len(right), len(meetings)
    if wrong > 0:
        notes.append(JoinFailure(f'{wrong} of {count} observations contradict the rest', pair))
    return joined


def _together(
    groups: Sequence[JointMap], encounter: Rendezvous, rules: JoinRules
) -> list[JointMap]:
    """Return the groups after two robots were joined, or tied again where they are already."""
    pair, meetings = encounter
    p, *others = (group for group in groups if not set(pair).isdisjoint(group.robots))
    joined = _merged(p, others[0], meetings, rules) if others else _tied(p, meetings, rules)
    return [joined if group is p else group for group in groups if group not in others]


def _merged(
    p: JointMap, q: JointMap, meetings: Sequence[RendezvousMeasurement], rules: JoinRules
) -> JointMap:
    """Return two maps as one, whose frame is that of p."""
    joint = placed(p, q, _base_node(p, q, meetings, rules))
    return _checked(_with(joint, meetings), (p, q), rules)


def _base_node(
    p: JointMap, q: JointMap, meetings: Sequence[RendezvousMeasurement], rules: JoinRules
) -> Array:
    """Return where q lies in p by shared landmarks or, where these do not tell, by a meeting."""
    try:
        return _by_landmarks(p, q, rules.min_shared)
    except NotAlignedError:
        if not meetings:
            raise
    return _by_meeting(p, q, _across(p, q, alignment_window(meetings)), rules)


def _tied(group: JointMap, meetings: Sequence[RendezvousMeasurement], rules: JoinRules) -> JointMap:
    """Return a map with further observations among its robots, which close a loop."""
    return _checked(_with(group, meetings), (group,), rules) if meetings else group


def _with(joint: JointMap, meetings: Sequence[RendezvousMeasurement]) -> JointMap:
    """Return a map with further observations among its robots, before it is solved for."""
    rows = RendezvousFactors(
        np.array([joint.first_poses[met.observer] + met.pose for met in meetings], np.intp),
        np.array([joint.first_poses[met.seen] + met.seen_pose for met in meetings], np.intp),
        np.array([met.z for met in meetings]).reshape(-1, 2),
        np.array([met.R for met in meetings]).reshape(-1, 2, 2))
    return replace(joint, problem=replace(
        joint.problem, rendezvous=concatenated(joint.problem.rendezvous, rows)))


def _checked(joined: JointMap, parts: Sequence[JointMap], rules: JoinRules) -> JointMap:
    """Return the minimum of eq. (21), with everything linearised anew, if it fits the parts."""
    try:
        joined = joined.solved()
    except (ConvergenceError, SingularError) as error:
        raise NotAlignedError(f'cannot align: {error}') from error
    raised = joined.chi_square - sum(part.chi_square for part in parts)
    dof = joined.dof - sum(part.dof for part in parts)
    require_consistent(raised, dof, rules.probability)
    return joined


def alignment_window(meetings: Sequence[RendezvousMeasurement]) -> Sequence[RendezvousMeasurement]:
    """Return those observations in the middle of a meeting by which maps are aligned."""
    return meetings[central(len(meetings), MEETING)]


def _by_meeting(p: JointMap, q: JointMap, across: RendezvousObservations, rules: JoinRules) -> Array:
    """Return the base node that observations of a meeting give, by Algorithm 1."""
    met_p, rows_p = np.unique(across.p, return_inverse=True)
    met_q, rows_q = np.unique(across.q, return_inverse=True)
    sighted = replace(across, p=rows_p, q=rows_q)
    aligned = align(p.subset(met_p), q.subset(met_q), sighted, rules.probability)
    return aligned.base_node.pose


def _by_landmarks(p: JointMap, q: JointMap, min_shared: int) -> Array:
    """Return the base node that brings landmarks of one name nearest to each other."""
    of_p, of_q = p.numbers(), q.numbers()
    shared = sorted(of_p.keys() & of_q.keys())
    if len(shared) < min_shared:
        raise NotAlignedError(f'{len(shared)} shared landmarks, {min_shared} are needed')
    at_p, at_q = [of_p[key] for key in shared], [of_q[key] for key in shared]
    P = p.information().joint(points=at_p) + q.information().joint(points=at_q)
    # Traces, which do not depend on the frame that each P is in.
    weights = 2.0 / np.diag(P).reshape(-1, 2).sum(axis=1)
    points = q.values.points[at_q]
    spread = points - np.average(points, axis=0, weights=weights)
    heading_sigma = 1.0 / np.sqrt(weights @ np.square(spread).sum(axis=1))
    if heading_sigma > MAX_HEADING_SIGMA:
        raise NotAlignedError(
            f'cannot align: {len(shared)} shared landmarks tell the heading to'
            f' {heading_sigma:.2f} rad, {MAX_HEADING_SIGMA} are needed')
    return rigid_fit(points, p.values.points[at_p], weights)


def _across(p: JointMap, q: JointMap, meetings: Sequence[RendezvousMeasurement]) -> RendezvousObservations:
    """Return who of p saw whom of q, or was seen, by the numbers of their poses."""
    ends = [((met.observer, met.pose), (met.seen, met.seen_pose)) for met in meetings]
    of_p, of_q = (
        np.array([
            group.first_poses[robot] + pose for pair in ends for robot, pose in pair
            if robot in group.robots], np.intp)
        for group in (p, q))
    return RendezvousObservations(
        of_p, of_q, np.array([met.observer in p.robots for met in meetings], bool),
        np.array([met.z for met in meetings]).reshape(-1, 2),
        np.array([met.R for met in meetings]).reshape(-1, 2, 2))
