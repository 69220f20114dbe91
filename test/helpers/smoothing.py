# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small least-squares problems with ground truth."""

import numpy as np

from fej_slam_ros.core.geometry import poses_plus
from fej_slam_ros.core.smoothing.factors import (
    LandmarkFactors, OdometryFactors, RendezvousFactors, Values)
from fej_slam_ros.core.smoothing.problem import Problem
from helpers.core import SmallTeam, turn


def world(seed, robots=2, landmarks=5, steps=10, noise=1.0, met=(), shared=True):
    """
    Return the measurements of a small team, and the truth with poses robot by robot.

    Parameters
    ----------
    seed, robots, landmarks, noise : of the team
    steps : of each robot
    met : (observer, observed, step) of robot-to-robot observations, robots by index
    shared : whether landmark IDs are the same for all robots

    """
    team = SmallTeam(seed, robots, landmarks, noise)
    increments, observations, true, points = [], [], [], []
    for number, name in enumerate(team.names):
        first = 0 if shared else number * landmarks
        for k in range(steps + 1):
            if k > 0:
                increments.append((len(true) - 1, len(true), team.drive(name, k).u))
            observations += [(len(true), first + s.id, s.z) for s in team.look(name).observations]
            true.append(team.truth.pose(name, k))
        if number == 0 or not shared:
            points += [team.truth.landmarks[i] for i in range(landmarks)]
    truth = Values(np.array(true), np.array(points))
    rendezvous = observations_of_robots(
        [(a * (steps + 1) + k, b * (steps + 1) + k) for a, b, k in met],
        truth, noise * team.R, np.random.default_rng(seed), team.R)
    return (
        Problem(
            OdometryFactors(*map(np.array, zip(*increments)), team.Q),
            LandmarkFactors(*map(np.array, zip(*observations)), team.R), rendezvous), truth)


def observations_of_robots(pairs, truth, noise, rng, R):
    """Return noisy robot-to-robot observations of pairs of poses, with stated covariance R."""
    pose, observed = np.array(pairs, np.intp).reshape(-1, 2).T
    z = [
        turn(truth.poses[a, 2]).T @ (truth.poses[b] - truth.poses[a])[:2]
        for a, b in zip(pose, observed)]
    error = rng.multivariate_normal(np.zeros(2), noise, len(pose))
    return RendezvousFactors(pose, observed, np.array(z).reshape(-1, 2) + error, R)


def far_from(truth, seed, metres=1.0):
    """Return values with errors of some metres and half as many radians, except pose 0."""
    rng = np.random.default_rng(seed)
    poses = truth.poses + metres * rng.normal(0.0, [1.0, 1.0, 0.5], truth.poses.shape)
    poses[0] = truth.poses[0]
    return Values(poses, truth.points + metres * rng.normal(0.0, 1.0, truth.points.shape))


#: Robots without shared landmarks: observation in one direction, chain, loop.
RENDEZVOUS = {
    'one direction': (2, [(0, 1, k) for k in range(3, 7)]),
    'chain': (3, [(a, a + 1, k) for a in (0, 1) for k in range(2, 6)]),
    'loop': (3, [(a, (a + 1) % 3, k) for a in (0, 1, 2) for k in range(2 + a, 6 + a)])}


def rendezvous_world(name, seed):
    """Return a world with one of the rendezvous."""
    robots, met = RENDEZVOUS[name]
    return world(seed, robots, landmarks=4, steps=8, met=met, shared=False)


def whitened_dense(problem, values):
    """Return the dense A and b of all measurements, row by row."""
    poses, width = len(values.poses), values.poses.size + values.points.size
    rows, residuals = [], []
    for kind in (problem.odometry, problem.landmarks, problem.rendezvous):
        H, r = kind.linearize(values)
        L_inv = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(
            kind.R, (len(r), *kind.R.shape[-2:]))))
        residuals.append((L_inv @ r[:, :, None]).ravel())
        for whitening, block, a, b in zip(L_inv, H, *kind.nodes(poses)):
            start = 3 * b if b < poses else 3 * poses + 2 * (b - poses)
            row = np.zeros((len(block), width))
            row[:, 3 * a:3 * a + 3] = block[:, :3]
            row[:, start:start + block.shape[1] - 3] += block[:, 3:]
            rows.append(whitening @ row)
    return np.vstack(rows), np.concatenate(residuals)


def dense_minimum(problem, x):
    """Return the poses and landmarks after ten Gauss-Newton steps, with pose 0 fixed."""
    n = x.poses.size
    for _ in range(10):
        A, b = whitened_dense(problem, x)
        dx = np.zeros(A.shape[1])
        dx[3:] = np.linalg.solve(A[:, 3:].T @ A[:, 3:], A[:, 3:].T @ b)
        x = Values(poses_plus(x.poses, dx[:n].reshape(-1, 3)), x.points + dx[n:].reshape(-1, 2))
    return x
