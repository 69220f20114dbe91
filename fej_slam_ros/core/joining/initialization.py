# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step 0: from robots in frames of their own to one joint state, "Initialization" of [Liu]."""

from collections import Counter
from collections.abc import Callable, Container, Mapping
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import Linearization, Points, Poses, transport_errors
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.joining.initial_alignment import (
    align, align_independently, closed_form, InitialAlignment, InitialScans)
from fej_slam_ros.core.records import LandmarkKey

#: How the anchor's uncertainty enters what is started at step 0.
START_COVARIANCES: Mapping[str, Callable[..., InitialAlignment]] = {
    'anchored': align,
    'independent': align_independently,
}


def initialize(
    state: JointState, anchor: str, seen: InitialScans, stamp: int, linearization: Linearization,
    method: Callable[..., InitialAlignment],
) -> JointState | None:
    """
    Return the joint state with all robots and shared landmarks that the observations determine.

    None where these bring nothing new together: then the step is one like any other.

    Parameters
    ----------
    state : robots with a known start, the anchor among them, predicted to step 0
    anchor : name of the anchor
    seen : the observations of every robot that scans at step 0, those not yet located included
    stamp : time of step 0 [ns]
    linearization : where the covariance is linearised
    method : one of `START_COVARIANCES`

    Raises
    ------
    AlignmentError
        If the observations do not determine what they tie together.

    """
    prior = _known(state, anchor)
    poses, points = closed_form(prior.poses, prior.points, seen)
    sighted = Counter(key for name in poses for key, _ in seen.get(name, ()))
    new_poses = {name: x for name, x in poses.items() if name not in prior.poses}
    shared = {
        key: x for key, x in points.items() if sighted[key] > 1 and key not in prior.points}
    if not new_poses and not shared:
        return None

    def linearized_at(at_poses: Poses, at_points: Points) -> tuple[Poses, Points]:
        looking = {name: x for name, x in at_poses.items() if name in seen}
        return linearization.initialization_points(state, looking, at_points, stamp)

    solved = method(prior, new_poses, shared, seen, linearized_at)
    located = _joint_state(solved, state, seen, stamp)
    x_prior = [*(solved.poses | prior.poses).values(), *(solved.points | prior.points).values()]
    transport_errors(linearization, located, np.concatenate(x_prior))
    return located


def _known(state: JointState, anchor: str) -> InitialAlignment:
    """Return what is located already, the anchor first."""
    robots = sorted(state.robots.values(), key=lambda robot: robot.name != anchor)
    landmarks = list(state.landmarks.values())
    return InitialAlignment(
        {robot.name: state.estimate(robot) for robot in robots},
        {landmark.key: state.estimate(landmark) for landmark in landmarks},
        state.marginal([*robots, *landmarks]))


def _joint_state(solved: InitialAlignment, before: JointState, seen: InitialScans, stamp: int) -> JointState:
    """Return the solution as a joint state; it is the first estimate of what is new."""
    covariance = Covariance()
    sizes = [3] * len(solved.poses) + [2] * len(solved.points)
    slots = iter(covariance.insert(solved.P).split(sizes))
    robots: list[Robot] = []
    landmarks: list[Landmark] = []
    first: list[Array] = []
    for name, x in solved.poses.items():
        robot = before.robots.get(name)
        robots.append(Robot(name, next(slots), stamp if robot is None else robot.stamp))
        first.append(x if robot is None else before.first_estimate(robot))
    for key, x in solved.points.items():
        known = before.landmarks.get(key)
        landmarks.append(
            Landmark(key, next(slots), _first_to_see(key, solved.poses, seen), stamp)
            if known is None else replace(known, slot=next(slots)))
        first.append(x if known is None else before.first_estimate(known))
    x_hat = np.concatenate([*solved.poses.values(), *solved.points.values()])
    return JointState([*robots, *landmarks], x_hat, np.concatenate(first), covariance)


def _first_to_see(key: LandmarkKey, team: Container[str], seen: InitialScans) -> str:
    return next(name for name in seen if name in team and key in dict(seen[name]))
