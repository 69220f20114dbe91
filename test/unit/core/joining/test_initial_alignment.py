# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step 0 is the minimum of eq. (12) of [Liu] for any prior and any first guess."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from fej_slam_ros.core.joining import initial_alignment
from fej_slam_ros.core.joining.initial_alignment import (
    align, align_independently, closed_form, InitialAlignment, InitialAlignmentError)
from helpers.core import pose_difference, quarter_turn, SmallTeam, turn

ANCHOR = np.diag([0.1, 0.2, 0.05])

#: For each prior its robots, its landmarks, and B of x = x_prior + B xi with xi ~ N(0, I).
PRIORS = {
    'uncertain anchor': (['r1'], [], ANCHOR @ [[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.3, -0.2, 1]]),
    'exact anchor': (['r1'], [], np.zeros((3, 0))),
    'anchor with exact heading': (['r1'], [], ANCHOR[:, :2]),
    'anchor known across a line': (['r1'], [], ANCHOR[:, :1] + ANCHOR[:, 1:2]),
    'two known starts': (['r1', 'r2'], [], block_diag(ANCHOR, 3.0 * ANCHOR)),
    'two robots that stand together': (['r1', 'r2'], [], np.vstack([ANCHOR, ANCHOR])),
    'anchor and landmarks': (['r1'], [0, 1], np.tril(0.1 + 0.1 * np.eye(7)))}


def observations(team, **numbers):
    """Return observations of some landmarks by each robot."""
    return {
        name: [(('', s.id), s) for s in team.look(name, some).observations]
        for name, some in numbers.items()}


def all_observations(seed):
    team = SmallTeam(seed, robots=3, landmarks=4)
    return team, observations(team, **dict.fromkeys(team.names, range(4)))


def prior_of(team, robots=('r1',), landmarks=(), B=ANCHOR):
    """Return a prior whose error is drawn from its covariance."""
    true = [team.truth.pose(name, 0) for name in robots]
    true += [team.truth.landmarks[number] for number in landmarks]
    x = np.concatenate(true) + B @ np.random.default_rng(11).normal(size=B.shape[1])
    poses, points = x[:3 * len(robots)].reshape(-1, 3), x[3 * len(robots):].reshape(-1, 2)
    keys = [('', number) for number in landmarks]
    return InitialAlignment(dict(zip(robots, poses)), dict(zip(keys, points)), B @ B.T)


def joint(solved):
    return np.concatenate([*solved.poses.values(), *solved.points.values()])


def solve(prior, seen, method=align, **options):
    """Return the alignment of all robots and landmarks, from the closed form."""
    poses, points = closed_form(prior.poses, prior.points, seen)
    new = {name: x for name, x in poses.items() if name not in prior.poses}
    shared = {key: x for key, x in points.items() if key not in prior.points}
    return method(prior, new, shared, seen, **options)


def general_solution(solved, prior, B, seen):
    """Return the minimum of eq. (12) near a solution, as a joint vector, and its covariance."""
    x_prior, m = joint(solved), 3 * len(solved.poses)
    known = [*range(3 * len(prior.poses)), *range(m, m + 2 * len(prior.points))]
    x_prior[known] = joint(prior)
    T = np.zeros((len(x_prior), B.shape[1] + len(x_prior) - len(known)))
    T[known, :B.shape[1]] = B
    T[np.delete(np.arange(len(T)), known), B.shape[1]:] = np.eye(len(T) - len(known))

    def residuals(unknown):
        x = x_prior + T @ unknown
        poses = dict(zip(solved.poses, x[:m].reshape(-1, 3)))
        points = dict(zip(solved.points, x[m:].reshape(-1, 2)))
        return np.concatenate([unknown[:B.shape[1]], *(
            whitened(s, turn(poses[name][2]).T @ (points[key] - poses[name][:2]))
            for name in seen for key, s in seen[name])])

    found = least_squares(
        residuals, np.zeros(T.shape[1]), '3-point', xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return x_prior + T @ found.x, T @ np.linalg.inv(found.jac.T @ found.jac) @ T.T


def whitened(observation, z_hat):
    return np.linalg.inv(np.linalg.cholesky(observation.R)) @ (observation.z - z_hat)


@pytest.mark.parametrize('given', PRIORS)
def test_the_result_is_the_minimum_that_a_general_solver_finds(given):
    robots, landmarks, B = PRIORS[given]
    team, seen = all_observations(seed=1)
    prior = prior_of(team, robots, landmarks, B)

    solved = solve(prior, seen)

    x, P = general_solution(solved, prior, B, seen)
    # The general solver stops where its finite differences are lost in rounding.
    assert_allclose(joint(solved), x, rtol=0.0, atol=1e-7)
    assert_allclose(solved.P, P, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize('seed', range(10))
def test_the_guess_does_not_matter(seed):
    team, seen = all_observations(seed=3)
    prior, rng = prior_of(team), np.random.default_rng(seed)
    far = {name: rng.uniform([-50.0, -50.0, -3.0], [50.0, 50.0, 3.0]) for name in ('r2', 'r3')}
    anywhere = {('', number): rng.uniform(-50.0, 50.0, 2) for number in range(4)}

    solved = align(prior, far, anywhere, seen)

    near = solve(prior, seen)
    poses, near_poses = (np.array([*result.poses.values()]) for result in (solved, near))
    assert np.abs(pose_difference(poses, near_poses)).max() < 1e-10  # iterations end at 1e-12
    assert np.abs(poses[:, 2]).max() <= np.pi
    assert_allclose([*solved.points.values()], [*near.points.values()], atol=1e-10)


def moves_with_anchor(solved):
    """Return A of A blkdiag(P_anchor, P_s) A^T: all moves rigidly with the anchor's error."""
    anchor, *others = solved.poses.values()
    rows = [np.eye(3)]
    for x in others:
        rows += [np.column_stack([np.eye(2), quarter_turn(x[:2] - anchor[:2])]), np.eye(3)[2:]]
    for f in solved.points.values():
        rows += [np.column_stack([np.eye(2), quarter_turn(f - anchor[:2])])]
    A = np.eye(len(solved.P))
    A[:, :3] = np.vstack(rows)
    return A


def test_robots_and_landmarks_move_rigidly_with_an_uncertain_anchor():
    team, seen = all_observations(seed=4)
    prior = prior_of(team)
    exact = InitialAlignment(prior.poses, {}, np.zeros((3, 3)))

    anchored, P_s = solve(prior, seen), solve(exact, seen).P[3:, 3:]

    A = moves_with_anchor(anchored)
    assert_allclose(anchored.P, A @ block_diag(prior.P, P_s) @ A.T, atol=1e-12)


def test_the_form_of_the_paper_has_no_cross_terms_with_the_anchor():
    team, seen = all_observations(seed=4)
    prior = prior_of(team)
    exact = InitialAlignment(prior.poses, {}, np.zeros((3, 3)))

    independent, P_s = solve(prior, seen, align_independently), solve(exact, seen).P[3:, 3:]

    assert_allclose(independent.P, block_diag(prior.P, P_s), rtol=0.0, atol=1e-15)
    assert_array_equal(prior.P, ANCHOR**2)


def test_the_covariance_may_be_taken_at_the_truth():
    team, seen = all_observations(seed=5)
    truth = (
        {name: team.truth.pose(name, 0) for name in team.names},
        {('', number): f for number, f in team.truth.landmarks.items()})

    solved = solve(prior_of(team), seen, linearized_at=lambda poses, points: truth)

    # Without noise the solution is the truth.
    quiet = SmallTeam(5, robots=3, landmarks=4, noise=0.0)
    exact = InitialAlignment({'r1': truth[0]['r1']}, {}, ANCHOR**2)
    expected = solve(exact, observations(quiet, **dict.fromkeys(quiet.names, range(4))))
    assert_allclose(solved.P, expected.P, atol=1e-12)


def test_the_covariance_of_the_authors_is_that_of_the_iteration_before_the_last():
    team, seen = all_observations(seed=6)
    linearized = []

    def watch(poses, points):
        linearized.append(np.concatenate([*poses.values(), *points.values()]))
        return poses, points

    solved = solve(prior_of(team), seen, linearized_at=watch, tolerance=1e-3)

    # The iteration ends at a step below the tolerance, and takes that step.
    assert len(linearized) == 1
    assert 0.0 < np.linalg.norm(joint(solved) - linearized[0]) < 1e-3


def linked(**numbers):
    """Return the robots that the closed form locates with r1, given what each observes."""
    team = SmallTeam(seed=8, robots=4, landmarks=9, noise=0.0)
    located = {'r1': team.truth.pose('r1', 0)}
    poses, points = closed_form(located, {}, observations(team, **numbers))
    for name, x in poses.items():
        assert_allclose(x, team.truth.pose(name, 0), atol=1e-13)
    for (_, number), f in points.items():
        assert_allclose(f, team.truth.landmarks[number], atol=1e-13)
    return sorted(poses)


def test_two_shared_landmarks_locate_a_robot():
    assert linked(r1=[0, 1, 2], r2=[1, 2, 3]) == ['r1', 'r2']


def test_one_shared_landmark_locates_no_robot():
    assert linked(r1=[0, 1, 2], r2=[2, 3, 4]) == ['r1']


def test_robots_that_share_landmarks_with_no_located_one_are_not_located():
    assert linked(r1=[0, 1], r2=[2, 3], r3=[2, 3]) == ['r1']


def test_a_chain_of_robots_is_located():
    assert linked(r4=[0, 1], r3=[1, 0, 2, 3], r1=[4, 5], r2=[2, 3, 4, 5]) == [
        'r1', 'r2', 'r3', 'r4']


def test_robots_are_located_together_by_landmarks_too_few_for_each():
    assert linked(r1=[0, 1], r2=[0, 2, 3], r3=[1, 2, 3]) == ['r1', 'r2', 'r3']


def test_poses_that_the_observations_do_not_determine_are_an_error():
    team = SmallTeam(seed=9)
    seen = observations(team, r1=[0], r2=[0])

    with pytest.raises(InitialAlignmentError, match='do not determine all poses'):
        align(prior_of(team), {'r2': np.array([1.0, 2.0, 0.5])}, {('', 0): np.ones(2)}, seen)


def test_an_iteration_that_does_not_end_is_an_error(monkeypatch):
    team, seen = all_observations(seed=10)
    monkeypatch.setattr(initial_alignment, 'MAX_STEP0_ITERATIONS', 2)

    with pytest.raises(InitialAlignmentError, match='did not converge in 2 iterations'):
        solve(prior_of(team), seen)
