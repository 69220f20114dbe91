# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Wheel slip of a robot that only others observe: its odometry is wrong, not the observations.

After a slip, all observations by and of the robot contradict those from before it, and the tests
of rendezvous leave out one of the two parts. One slip, of three coordinates, explains that better
than as many wrong observations, if these agree with each other and with the rest of the odometry.
Then odometry that no accepted measurement confirms is released: its covariance is multiplied so
that the slip is one standard deviation.

The slip is found among the links of the robot. That of the largest d2 is released first. Odometry
between observations of landmarks by the robot is no link: its own map has been tested.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.loop_closing import (
    close_loops, ClosedLoops, measurements_of, with_measurements)
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.odometry_links import (
    distances, factors_of, intervals_of, landmark_poses, Links, links_of, measured_poses,
    MIN_PER_LINK, ReleasedOdometry, UNKNOWN_SLIP, with_released)
from fej_slam_ros.core.csam.rendezvous import Rendezvous
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.smoothing.factors import rows_of, Values


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
    first, landmarks = joint.first_poses[robot], landmark_poses(joint, robot)
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
            replace(with_released(joint, links, slips), values=start), loops, rules)
    except NoMinimumError:
        return None
    count = len(closed.joint.problem.rendezvous.z) - len(joint.problem.rendezvous.z)
    if count < MIN_PER_LINK * len(slips):
        return None
    intervals = intervals_of(links, slips, joint.first_poses[robot])
    return ExplainedLoops(closed, ReleasedOdometry(robot, intervals, count))


def _links_of(joint: JointMap, robot: str) -> Links:
    """Return the links of a robot, without those between its observations of landmarks."""
    landmarks = landmark_poses(joint, robot)
    return links_of(joint, robot, (
        (begin, end) for begin, end in pairwise(measured_poses(joint, robot).tolist())
        if not len(landmarks) or begin < landmarks[0] or landmarks[-1] < end))


def _search(
    used: JointMap, links: Links, most: int, rules: JoinRules
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
        d2 = distances(
            solved, solved.information(), rows_of(links.factors, np.array(slips)), 1.0)
        if d2.min() > rules.limit(3):
            break
        del slips[int(np.argmin(d2))]
        solved = _without(used, links, slips, solved.values)
    return solved.values, factors_of(solved, links, slips)


def _contradicting(
    used: JointMap, links: Links, most: int, rules: JoinRules
) -> tuple[list[int], JointMap] | None:
    """
    Return the links without which all others fit, the worst first, and the minimum.

    None if these are more than `most`.

    """
    slips: list[int] = []
    solved = used.solved()
    while True:
        d2 = distances(solved, solved.information(), links.factors, -1.0)
        d2[slips] = 0.0
        if d2.max(initial=0.0) <= rules.limit(3):
            return slips, solved
        if len(slips) == most:
            return None
        slips.append(int(np.argmax(d2)))
        solved = _without(used, links, slips, solved.values)


def _without(used: JointMap, links: Links, slips: Sequence[int], start: Values) -> JointMap:
    """Return the minimum of a map without some links, from a start."""
    released = with_released(used, links, dict.fromkeys(slips, UNKNOWN_SLIP))
    return replace(released, values=start).solved()


def _is_out_and_back(joint: JointMap, robot: str, links: Links, slips: Collection[int]) -> bool:
    """
    Return whether a map has measurements on both sides of two slips.

    The second one would have taken the robot back to where it would be without both, so the
    observations between them are wrong.

    """
    released = np.array(sorted(slips), np.intp)
    if np.diff(released).max(initial=0) < MIN_PER_LINK:
        return False
    part = np.searchsorted(links.factors.target[released], measured_poses(joint, robot), 'right')
    return bool(part.min() < part.max())
