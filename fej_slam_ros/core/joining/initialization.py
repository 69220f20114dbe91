# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step 0: the joint state of all robots that the first scans relate, "Initialization" of [Liu]."""

from collections import Counter
from collections.abc import Callable, Mapping
from itertools import islice
import sys

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import Linearization, Points, Poses, transport_errors
from fej_slam_ros.core.ekf.state import at_slot, JointState, Landmark, Robot, Variable
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.joining.initial_alignment import (
    align, align_independently, closed_form, InitialAlignment, InitialScans)

#: Treatment of the anchor's uncertainty in the covariance of step 0, by parameter value.
START_COVARIANCES: Mapping[str, Callable[..., InitialAlignment]] = {
    'anchored': align,
    'independent': align_independently,
}


def initialize(
    state: JointState, anchor: str, scans: InitialScans, stamp: int, linearization: Linearization,
    method: Callable[..., InitialAlignment], max_new: int = sys.maxsize,
) -> JointState | None:
    """
    Return the joint state with all robots and shared landmarks that the scans determine.

    None if the scans relate no new robots or landmarks: then the step is an ordinary one.

    Parameters
    ----------
    state : robots with an initial pose, the anchor among them, predicted to step 0
    anchor : name of the anchor
    scans : observations of every robot at step 0, whether in the state or not
    stamp : time of step 0 [ns]
    linearization : policy that linearises the covariance
    method : one of `START_COVARIANCES`; its errors are those of `align`
    max_new : maximum number of new landmarks

    """
    prior = _known(state, anchor)
    poses, points = closed_form(prior.poses, prior.points, scans)
    observers = Counter(key for name in poses for key, _ in scans.get(name, ()))
    new_poses = {name: x for name, x in poses.items() if name not in prior.poses}
    shared = dict(islice((
        (key, x) for key, x in points.items()
        if observers[key] > 1 and key not in prior.points), max_new))
    if not new_poses and not shared:
        return None

    def linearized_at(at_poses: Poses, at_points: Points) -> tuple[Poses, Points]:
        # The poses of other robots are in no Jacobian, and their ground truth may be missing.
        observing = {name: x for name, x in at_poses.items() if name in scans}
        observing, at_points = linearization.initialization_points(
            state, observing, at_points, stamp)
        return {**at_poses, **observing}, at_points

    solved = method(prior, new_poses, shared, scans, linearized_at)
    located = _joint_state(solved, state, scans, stamp)
    x_prior = [*(solved.poses | prior.poses).values(), *(solved.points | prior.points).values()]
    transport_errors(linearization, located, np.concatenate(x_prior))
    return located


def _known(state: JointState, anchor: str) -> InitialAlignment:
    """Return the known robots and landmarks, the anchor first."""
    robots = sorted(state.robots.values(), key=lambda robot: robot.name != anchor)
    landmarks = list(state.landmarks.values())
    return InitialAlignment(
        {robot.name: state.estimate(robot) for robot in robots},
        {landmark.key: state.estimate(landmark) for landmark in landmarks},
        state.marginal([*robots, *landmarks]))


def _joint_state(
    solved: InitialAlignment, before: JointState, scans: InitialScans, stamp: int
) -> JointState:
    """Return the solution as a joint state; it is the first estimate of new variables."""
    covariance = Covariance()
    sizes = [3] * len(solved.poses) + [2] * len(solved.points)
    slots = iter(covariance.insert(solved.P).split(sizes))
    variables: list[Variable] = []
    first: list[Array] = []
    observed = {name: dict(scan).keys() for name, scan in scans.items() if name in solved.poses}
    for name, x in solved.poses.items():
        robot = before.robots.get(name)
        variables.append(Robot(name, next(slots), stamp if robot is None else robot.stamp))
        first.append(x if robot is None else before.first_estimate(robot))
    for key, x in solved.points.items():
        landmark = before.landmarks.get(key)
        if landmark is None:
            owner, *others = [name for name, keys in observed.items() if key in keys]
            variables.append(
                Landmark(key, next(slots), owner, stamp, is_reobserved=bool(others)))
        else:
            variables.append(at_slot(landmark, next(slots)))
        first.append(x if landmark is None else before.first_estimate(landmark))
    x_hat = np.concatenate([*solved.poses.values(), *solved.points.values()])
    return JointState(variables, x_hat, np.concatenate(first), covariance)
