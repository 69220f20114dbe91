# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Wheel slip of a robot that only others observe: its odometry is wrong, not the observations.

After a slip, all observations by and of the robot contradict those from before it, and the tests
of rendezvous leave out one of the two parts. One slip, of three coordinates, explains that better
than as many wrong observations, if these agree with each other and with the rest of the odometry.
Then odometry that no accepted measurement confirms is released: its covariance is multiplied so
that the slip is one standard deviation.

The slip is found among the links of the robot, its odometry between two successive poses with
other measurements. Without a link of residual r and covariance S, chi-square is smaller by

    d2 = r^T (S - H P H^T)^-1 r,

with the P of both poses at the minimum. The link of the largest d2 is released first. Links
between observations of landmarks by the robot are none: its own map has been tested.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.chi_square import distances_where_tested
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.loop_closing import (
    close_loops, ClosedLoops, measurements_of, with_measurements)
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous import Rendezvous
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array, distinct, Indices
from fej_slam_ros.core.models import composed_increment
from fej_slam_ros.core.smoothing.factors import (
    concatenated, OdometryFactors, Row, rows_of, stacked, Values, whitened, whitener)

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
    observations: int  #: number of robot-to-robot observations that count again


class ExplainedLoops(NamedTuple):
    """Rendezvous that a slip explains."""

    closed: ClosedLoops  #: the map with them
    released: ReleasedOdometry


def explained_loops(
    joint: JointMap, loops: Sequence[Rendezvous], rules: JoinRules
) -> ExplainedLoops | None:
    """
    Return a map with rendezvous of the robot whose slip explains most of those that failed.

    None if there is none. Some of them must be with a robot whose landmarks show that it has not
    slipped itself.

    """
    found = []
    for robot in joint.robots:
        own = [loop for loop in loops if robot in loop.robots]
        others = [(loop, other) for loop in own for other in loop.robots if other != robot]
        if any(_is_confirmed(joint, other, loop) for loop, other in others):
            explained = _explained_by_slip_of(robot, joint, own, rules)
            if explained is not None:
                found.append(explained)
    return max(found, key=lambda explained: explained.released.observations, default=None)


def _is_confirmed(joint: JointMap, robot: str, loop: Rendezvous) -> bool:
    """Return whether a robot observed landmarks before and after its part in a rendezvous."""
    first, landmarks = joint.first_poses[robot], _own(joint, robot, joint.problem.landmarks.pose)
    poses = [first + (m.pose if m.observer == robot else m.observed_pose)
             for m in loop.measurements]
    return len(landmarks) > 0 and landmarks[0] <= min(poses) and max(poses) <= landmarks[-1]


def _explained_by_slip_of(
    robot: str, joint: JointMap, loops: Sequence[Rendezvous], rules: JoinRules
) -> ExplainedLoops | None:
    """
    Return a map with rendezvous that a slip of a robot explains, None if there are none.

    Parameters
    ----------
    joint : the minimum without the rendezvous
    robot : name of the robot
    loops : rendezvous of the robot with others in the map that contradict it

    """
    measurements = measurements_of(loops)
    used = with_measurements(joint, measurements)
    links = _links_of(used, robot)
    if not links.rows:
        return None
    try:
        start, slips = _search(used, links, len(measurements) // MIN_PER_LINK, rules)
        if not slips or _is_out_and_back(joint, robot, links, slips):
            return None
        closed = close_loops(
            replace(_released(joint, links, slips), values=start), loops, rules)
    except NoMinimumError:
        return None
    count = len(closed.joint.problem.rendezvous.z) - len(joint.problem.rendezvous.z)
    if count < MIN_PER_LINK * len(slips):
        return None
    first = joint.first_poses[robot]
    return ExplainedLoops(closed, ReleasedOdometry(robot, _intervals(links, slips, first), count))


class _Links(NamedTuple):
    """Odometry of a robot between its successive poses with other measurements."""

    factors: OdometryFactors  #: one for each link, in the order of time
    rows: Sequence[Indices]  #: the odometry factors of the map in each link


def _links_of(joint: JointMap, robot: str) -> _Links:
    """Return the links of a robot, without those between its observations of landmarks."""
    odometry, measured = concatenated(joint.problem.odometry), _measured(joint, robot)
    landmarks = _own(joint, robot, joint.problem.landmarks.pose)
    poses = joint.poses_of(robot)
    own = np.flatnonzero((odometry.pose >= poses.start) & (odometry.pose < poses.stop))
    bounds = np.searchsorted(odometry.pose[own], measured)
    links: list[Row] = []
    rows = []
    for k, (begin, end) in enumerate(pairwise(measured.tolist())):
        if len(landmarks) and landmarks[0] <= begin and end <= landmarks[-1]:
            continue
        rows.append(own[bounds[k]:bounds[k + 1]])
        u, S = odometry.z[rows[-1][0]], odometry.R[rows[-1][0]]
        for row in rows[-1][1:]:
            u, S = composed_increment(u, S, odometry.z[row], odometry.R[row])
        links.append((begin, end, u, S))
    return _Links(stacked(OdometryFactors, links), rows)


def _measured(joint: JointMap, robot: str) -> Indices:
    """Return the poses of a robot with measurements other than odometry."""
    problem = joint.problem
    return _own(joint, robot, np.concatenate([
        problem.landmarks.pose, problem.rendezvous.pose, problem.rendezvous.target]))


def _own(joint: JointMap, robot: str, poses: Indices) -> Indices:
    """Return those of some poses that are of a robot, sorted."""
    own = joint.poses_of(robot)
    return distinct(poses[(poses >= own.start) & (poses < own.stop)])


def _distances(joint: JointMap, links: OdometryFactors, sign: float) -> Array:
    """
    Return d2 = r^T (S + sign H P H^T)^-1 r of some links at the minimum of a map.

    It is the decrease of chi-square without a link that the map uses (-1), or that of a link that
    it does not use (1).

    """
    A, b = whitened(whitener(links.R), *links.linearize(joint.values))
    information = joint.information()
    P = np.array([
        information.joint(ends) for ends in zip(links.pose.tolist(), links.target.tolist())])
    return distances_where_tested(b, np.eye(3) + sign * A @ P @ A.transpose(0, 2, 1))


def _search(
    used: JointMap, links: _Links, most: int, rules: JoinRules
) -> tuple[Values, dict[int, float]]:
    """
    Return the minimum with released links, and the factor of the covariance of each.

    There is no factor if all links fit, or if more than `most` do not.

    """
    found = _contradicting(used, links, most, rules)
    if found is None:
        return used.values, {}
    slips, solved = found
    # Links that were released before the slip itself may fit without it.
    while slips:
        d2 = _distances(solved, rows_of(links.factors, np.array(slips)), 1.0)
        if d2.min() > rules.limit(3):
            break
        del slips[int(np.argmin(d2))]
        solved = _without(used, links, slips, solved.values)
    _, r = links.factors.linearize(solved.values)
    return solved.values, {
        k: float(r[k] @ np.linalg.solve(links.factors.R[k], r[k])) for k in slips}


def _contradicting(
    used: JointMap, links: _Links, most: int, rules: JoinRules
) -> tuple[list[int], JointMap] | None:
    """
    Return the links without which all others fit, the worst first, and the minimum.

    None if these are more than `most`.

    """
    slips: list[int] = []
    solved = used.solved()
    while True:
        d2 = _distances(solved, links.factors, -1.0)
        d2[slips] = 0.0
        if d2.max(initial=0.0) <= rules.limit(3):
            return slips, solved
        if len(slips) == most:
            return None
        slips.append(int(np.argmax(d2)))
        solved = _without(used, links, slips, solved.values)


def _without(used: JointMap, links: _Links, slips: Sequence[int], start: Values) -> JointMap:
    """Return the minimum of a map without some links, from a start."""
    released = _released(used, links, dict.fromkeys(slips, UNKNOWN_SLIP))
    return replace(released, values=start).solved()


def _is_out_and_back(joint: JointMap, robot: str, links: _Links, slips: Collection[int]) -> bool:
    """
    Return whether a map has measurements on both sides of two slips.

    The second one would have taken the robot back to where it would be without both, so the
    observations between them are wrong.

    """
    released = np.array(sorted(slips), np.intp)
    if np.diff(released).max(initial=0) < MIN_PER_LINK:
        return False
    part = np.searchsorted(links.factors.target[released], _measured(joint, robot), 'right')
    return bool(part.min() < part.max())


def _released(joint: JointMap, links: _Links, slips: Mapping[int, float]) -> JointMap:
    """Return a map in which the covariances of some links are multiplied by a factor."""
    odometry = concatenated(joint.problem.odometry)
    for k, factor in slips.items():
        odometry.R[links.rows[k]] *= factor
    return replace(joint, problem=replace(joint.problem, odometry=odometry))


def _intervals(
    links: _Links, slips: Mapping[int, float], first: int
) -> tuple[tuple[int, int], ...]:
    """Return the first and last pose of each run of released links, counted from a pose."""
    intervals: list[tuple[int, int]] = []
    for k in sorted(slips):
        begin, end = int(links.factors.pose[k]) - first, int(links.factors.target[k]) - first
        if intervals and intervals[-1][1] == begin:
            begin, _ = intervals.pop()
        intervals.append((begin, end))
    return tuple(intervals)
