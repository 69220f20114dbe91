# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small maps, and all hypotheses of a scan, for tests of unknown data association."""

import numpy as np

from fej_slam_ros.core.data_association.candidate_pairs import candidate_pairs
from fej_slam_ros.core.data_association.joint_compatibility import match_scan
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.records import NO_ID, Observation

#: One observation of something unknown in 100 m^2, for one of each landmark.
ODDS = float(np.log(100.0 / (2.0 * np.pi)))


def a_map(points, P, pose=(0.0, 0.0, 0.0)):
    """Return a state of a robot r1 and landmarks with the joint covariance P, and its robot."""
    covariance = Covariance()
    slots = covariance.insert(np.asarray(P)).split([3] + [2] * len(points))
    robot = Robot('r1', slots[0], 1)
    landmarks = [Landmark(('', -2 - k), slot, 'r1', 0) for k, slot in enumerate(slots[1:])]
    x = np.concatenate([pose, np.ravel(points)])
    return JointState([robot, *landmarks], x, x.copy(), covariance), robot


def independent(pose_sigma, landmark_sigma, count):
    """Return the joint covariance of a pose and uncorrelated landmarks."""
    return np.diag(np.square([*pose_sigma, *[landmark_sigma] * 2 * count]))


def observations(points, sigma=0.1):
    """Return observations without IDs of points in the base frame."""
    return [Observation(NO_ID, np.array(z, dtype=float), sigma**2 * np.eye(2)) for z in points]


def pairs_of(state, robot, seen, odds=ODDS):
    """Return the possible pairs of observations and all landmarks."""
    landmarks = [*state.landmarks.values()]
    return candidate_pairs(
        state, FirstEstimates(), robot, seen, landmarks, np.full(len(landmarks), odds))


def match(state, robot, seen, probability=0.99, odds=ODDS):
    """Return landmark index by observation index, and the new and the ambiguous observations."""
    landmarks = [*state.landmarks.values()]
    found = match_scan(
        state, FirstEstimates(), robot, seen, landmarks, np.full(len(landmarks), odds),
        probability)
    matched = {i: landmarks.index(landmark) for i, landmark in found.landmarks.items()}
    return matched, list(found.new), list(found.doubtful)


def scored_hypotheses(pairs):
    """Yield every set of pairs that is jointly possible, with its log-likelihood ratio."""
    def sets(p):
        if p == len(pairs):
            yield ()
            return
        for rest in sets(p + 1):
            yield rest
            taken = [pairs[q] for q in rest]
            if all(pairs[p][0] != i and pairs[p][1] != f for i, f in taken):
                yield (p, *rest)

    for chosen in sets(0):
        rows = [*chosen, *(p + len(pairs) for p in chosen)]
        r, S = pairs.r[rows], pairs.S[np.ix_(rows, rows)]
        score = pairs.log_odds[list(chosen)].sum() - 0.5 * (
            r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1])
        yield {pairs[p] for p in chosen}, float(score)
