# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The filters meet stored and independent results to rounding.

Mutations, each tried once in a copy of the sources. All fail the comparison with the authors, by
the largest position error given here for environment 1 / Victoria Park, and other tests besides:

- standard Phi inside FEJ, 1.3 / 0.32 m: test_linearization, test_observability, test_consistency
- current landmark in FEJ's H, 1.3 / 2.6 m: the same
- first estimate of a landmark taken after its first update, 1.2 / 1.4 m: test_filter
- second robot's observation of a new landmark dropped, 8 to 10 / 0.02 m: test_filter
- new landmark updated by the observation that started it, 0.7 to 1.2 / 0.8 to 4.3 m: test_filter
- ideal's F at the estimate, 1.5 m, or its start covariance there, 0.67 m: test_linearization

Noise of a motion or of a new landmark left unturned goes unseen by the authors' isotropic noise;
it fails the comparison with least squares, test_filter and test_invariance.
"""

from functools import cache

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.joining.initial_alignment import align_independently
from fej_slam_ros.core.joining.initialization import initialize
from helpers.authors import authors_run
from helpers.core import make_policy, pose_difference, SmallTeam, turn

AUTHORS_NAMES = {'standard': 'Std', 'ideal': 'Ide', 'fej': 'Fej'}

RUNS = [
    ('exact_env1_20.npz', 'standard'), ('exact_env1_20.npz', 'ideal'),
    ('exact_env1_20.npz', 'fej'),
    ('exact_victoria_park.npz', 'standard'), ('exact_victoria_park.npz', 'fej')]

#: What the issue asks for; rounding alone gives 1e-11.
PROMISED = 1e-8


def authors_start(run, policy):
    """Return the joint state after step 0 with the authors' rule to stop and their guess."""
    def method(prior, _, points, seen, linearized_at):
        # Their guess of a shared landmark is where the anchor sees it, which is ours as well.
        return align_independently(
            prior, run.guess, points, seen, linearized_at, tolerance=1e-9**0.5)

    state = JointState()
    state.insert_robot('r1', 0, run.anchor, run.P_anchor)
    seen = {scan.robot: [(('', s.id), s) for s in scan.observations] for scan in run.scans(0)}
    return initialize(state, 'r1', seen, 0, policy, method)


@cache
def repeated(path, kind):
    """Return the authors' run, its joint state after our filter, and poses and covariances."""
    run = authors_run(path)
    policy = make_policy(kind, run.truth)
    filter_ = Filter(authors_start(run, policy), policy, Gate(1.0))
    filter_.start_landmarks(run.scans(0))
    state = filter_.state
    history = {name: [] for name in state.robots}
    for k in range(run.steps + 1):
        if k > 0:
            filter_.step(run.motions(k), run.scans(k))
        for name, robot in state.robots.items():
            history[name].append((state.estimate(robot), state.marginal([robot])))
    return run, state, history


@pytest.mark.parametrize(('file', 'kind'), RUNS)
@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_poses_and_covariances_equal_those_of_the_authors_at_every_step(
    data, file, kind, robot,
):
    run, _, history = repeated(data / 'fej_ekf_paper' / file, kind)

    poses = run.poses(AUTHORS_NAMES[kind])[robot]
    covariances = run.covariances(AUTHORS_NAMES[kind])[robot]

    ours, P = map(np.array, zip(*history[robot][-len(poses):]))
    assert np.abs(pose_difference(ours, poses)).max() < PROMISED
    assert np.abs(P - covariances).max() < PROMISED


@pytest.mark.parametrize(('file', 'kind'), RUNS)
def test_the_final_map_equals_that_of_the_authors_in_estimate_and_covariance(data, file, kind):
    run, state, _ = repeated(data / 'fej_ekf_paper' / file, kind)

    numbers, points, P = run.landmarks(AUTHORS_NAMES[kind])

    ours = [state.landmarks['', number] for number in numbers]
    assert len(ours) == len(state.landmarks)
    assert_allclose([state.estimate(landmark) for landmark in ours], points, atol=PROMISED)
    assert_allclose(state.marginal(ours), P, rtol=0.0, atol=PROMISED)


class Batch:
    """Weighted linear least squares over points in the plane, each with a name."""

    def __init__(self):
        self._measured = []

    def add(self, names, value, covariance):
        """Take in a measured point, or, of two names, the difference second - first."""
        self._measured.append((names, value, np.linalg.inv(covariance)))

    def solve(self, wanted):
        """Return the points of the wanted names, (2 n,), and their covariance."""
        others = {name for names, _, _ in self._measured for name in names} - set(wanted)
        place = {name: 2 * k for k, name in enumerate([*wanted, *others])}
        A, b = np.zeros((2 * len(place), 2 * len(place))), np.zeros(2 * len(place))
        for names, value, weight in self._measured:
            rows = np.zeros((2, len(b)))
            for name, sign in zip(names, [1.0] if len(names) == 1 else [-1.0, 1.0]):
                rows[:, place[name]:][:, :2] = sign * np.eye(2)
            A += rows.T @ weight @ rows
            b += rows.T @ weight @ value
        n = 2 * len(wanted)
        return np.linalg.solve(A, b)[:n], np.linalg.inv(A)[:n, :n]


@pytest.mark.parametrize(
    ('kind', 'iterations'),
    [('standard', 1), ('standard', 3), ('fej', 1), ('ideal', 1), ('invariant', 1),
     ('invariant', 3)])
def test_with_known_headings_the_filter_equals_batch_least_squares(kind, iterations):
    team, batch = SmallTeam(seed=4, robots=2, landmarks=5), Batch()
    for covariance in (team.P, team.Q):
        covariance[2, :] = covariance[:, 2] = 0.0
    filter_ = team.start(kind, iterations=iterations)
    for name, robot in filter_.state.robots.items():
        batch.add([(name, 0)], filter_.state.estimate(robot)[:2], team.P[:2, :2])
    for k in range(1, 21):
        motions = [team.drive(name, k) for name in team.names]
        scans = [team.look(name, numbers=[k % 5, (k + 1) % 5]) for name in team.names]
        meetings = [team.look_for_robots(team.names[k % 2])]
        filter_.step(motions, scans, meetings)
        for m in motions:
            C = turn(team.truth.pose(m.robot, k - 1)[2])
            batch.add([(m.robot, k - 1), (m.robot, k)], C @ m.u[:2], C @ m.Q[:2, :2] @ C.T)
        for scan in scans:
            C = turn(team.truth.pose(scan.robot, k)[2])
            for s in scan.observations:
                batch.add([(scan.robot, k), s.id], C @ s.z, C @ s.R @ C.T)
        for scan in meetings:
            C = turn(team.truth.pose(scan.robot, k)[2])
            for s in scan.observations:
                batch.add([(scan.robot, k), (s.observed, k)], C @ s.z, C @ s.R @ C.T)

    points, P = batch.solve([('r1', 20), ('r2', 20), *range(5)])

    state = filter_.state
    variables = [*state.robots.values(), *(state.landmarks['', i] for i in range(5))]
    positions = np.r_[0, 1, 3, 4, 6:16]
    # Twenty steps of rounding.
    assert_allclose(
        np.concatenate([state.estimate(v)[:2] for v in variables]), points, atol=1e-11)
    assert_allclose(state.marginal(variables)[np.ix_(positions, positions)], P, atol=1e-12)
