# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step 0: the joint state of all robots that the first scans relate, "Initialization" of [Liu]."""

from collections import Counter
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from functools import partial
from itertools import islice
import math
import sys

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import Linearization, Points, Poses
from fej_slam_ros.core.ekf.state import at_slot, JointState, Landmark, Robot, Variable
from fej_slam_ros.core.ekf.whitening import whiten
from fej_slam_ros.core.geometry import Array, pose_difference
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
    max_heading_sigma: float = math.inf,
) -> JointState | None:
    """
    Return the joint state with all robots and shared landmarks that the scans determine.

    New robots whose headings are too uncertain are left out, with their scans. None if the scans
    relate no new robots or landmarks: then the step is an ordinary one.

    Parameters
    ----------
    state : robots with an initial pose, the anchor among them, predicted to step 0
    anchor : name of the anchor
    scans : observations of every robot at step 0, whether in the state or not
    stamp : time of step 0 [ns]
    linearization : policy that linearises the covariance
    method : one of `START_COVARIANCES`; its errors are those of `align`
    max_new : maximum number of new landmarks
    max_heading_sigma : largest standard deviation of the heading of a new robot [rad]

    """
    robots = sorted(state.robots.values(), key=lambda robot: robot.name != anchor)
    keys = {key for scan in scans.values() for key, _ in scan}
    observed = [landmark for key, landmark in state.landmarks.items() if key in keys]
    unobserved = [landmark for key, landmark in state.landmarks.items() if key not in keys]
    prior = _estimates(state, robots, observed)
    scans, new_poses, shared = _determined(prior, scans, max_new)
    if not new_poses and not shared:
        return None
    solved = method(
        prior, new_poses, shared, scans,
        partial(_linearized_at, linearization, state, scans.keys(), stamp))
    uncertain = _uncertain(solved, new_poses, max_heading_sigma)
    if uncertain:
        return initialize(
            state, anchor, {name: scan for name, scan in scans.items() if name not in uncertain},
            stamp, linearization, method, max_new, max_heading_sigma)
    known = prior
    if unobserved:
        known = _estimates(state, robots, [*observed, *unobserved])
        solved = _with_unobserved(solved, prior, known)
    located = _joint_state(solved, state, scans, stamp)
    x_prior = [*(solved.poses | known.poses).values(), *(solved.points | known.points).values()]
    before = np.concatenate(x_prior)
    linearization.transport_errors(located, before, located.x_hat - before)
    return located


def _determined(
    prior: InitialAlignment, scans: InitialScans, max_new: int
) -> tuple[InitialScans, Poses, Points]:
    """Return the scans to use, and guesses of the new robots and shared landmarks in them."""
    poses, points = closed_form(prior.poses, prior.points, scans)
    observers = Counter(key for name in poses for key, _ in scans.get(name, ()))
    shared = {
        key: x for key, x in points.items() if observers[key] > 1 and key not in prior.points}
    if len(shared) > max_new:
        # No pose may depend on landmarks that are not started.
        usable = {*prior.points, *islice(shared, max_new)}
        return _determined(prior, {
            name: [(key, observation) for key, observation in scan if key in usable]
            for name, scan in scans.items()}, max_new)
    return scans, {name: x for name, x in poses.items() if name not in prior.poses}, shared


def _uncertain(solved: InitialAlignment, names: Collection[str], max_sigma: float) -> set[str]:
    """Return those of some robots whose heading is too uncertain in the frame of the anchor."""
    # The first robot is the anchor, whose error turns the others with it.
    variances = solved.P.diagonal()[2::3] - solved.P[2, 2]
    return {name for name, variance in zip(solved.poses, variances)
            if name in names and variance > max_sigma ** 2}


def _linearized_at(
    linearization: Linearization, state: JointState, observers: Container[str], stamp: int,
    poses: Poses, points: Points,
) -> tuple[Poses, Points]:
    """Return the points at which the covariance is linearised, given the solution."""
    # The poses of other robots are in no Jacobian, and their ground truth may be missing.
    observing = {name: x for name, x in poses.items() if name in observers}
    observing, points = linearization.initialization_points(state, observing, points, stamp)
    return {**poses, **observing}, points


def _estimates(
    state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
) -> InitialAlignment:
    return InitialAlignment(
        {robot.name: state.estimate(robot) for robot in robots},
        {landmark.key: state.estimate(landmark) for landmark in landmarks},
        state.marginal([*robots, *landmarks]))


def _with_unobserved(
    solved: InitialAlignment, prior: InitialAlignment, known: InitialAlignment
) -> InitialAlignment:
    """
    Return a solution with known landmarks that were not observed, which come last.

    They follow by their covariance with the `prior` of the solution, the first of the `known`:
    solving for a large map would take minutes. With P of the prior, P_s of its variables in the
    solution, and K = P_rp P^-1 of the rest r, the estimates are x_r + K dx and the covariance
    is P_r - K (P - P_s) K^T; that with the solution is K times the rows of those variables.

    """
    n, poses, points = len(prior.P), 3 * len(prior.poses), 2 * len(prior.points)
    # The variables of the prior among those that were solved for.
    at = np.concatenate([np.arange(poses), 3 * len(solved.poses) + np.arange(points)])
    dx = np.concatenate([
        *(pose_difference(solved.poses[name], x) for name, x in prior.poses.items()),
        *(solved.points[key] - x for key, x in prior.points.items())])
    whitening = whiten(prior.P, known.P[n:, :n], prior.P.diagonal())
    C, pivots = whitening.C, whitening.pivots
    cross = C @ whitening.whitened(solved.P[at[pivots]])
    P_g = whitening.whitened(whitening.whitened(solved.P[np.ix_(at[pivots], at[pivots])]).T)
    P_rest = known.P[n:, n:] - C @ (np.eye(len(pivots)) - P_g) @ C.T
    keys = [*known.points][len(prior.points):]
    moved = (C @ whitening.whitened(dx[pivots, None])).reshape(-1, 2)
    return InitialAlignment(
        solved.poses,
        solved.points | {key: known.points[key] + step for key, step in zip(keys, moved)},
        np.block([[solved.P, cross.T], [cross, P_rest]]))


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
        located = Robot(name, next(slots), stamp) if robot is None else at_slot(robot, next(slots))
        if not solved.points.keys().isdisjoint(observed.get(name, ())):
            located.turn_variance = 0.0
        variables.append(located)
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
