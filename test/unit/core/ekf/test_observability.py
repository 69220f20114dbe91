# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lemma 1 of [Liu]: the rank of the local observability matrix M of a run with noise.

M is built from the Phi and H by which a run of the filter multiplied its covariance, and from the
transport of the covariance of the invariant filter to its newest estimate.

Mutations, each tried once in a copy of the sources, gave FEJ the rank of the standard filter:
standard Phi, current landmarks in H, first estimates refreshed by updates; only with `held_robots`
the current pose in H, as it is the first estimate unless another robot has corrected it, and
likewise the current pose of an observed robot. The invariant filter got it without the transport
after an update, and with three iterations without the transport between them.

The last tests are of the recorder, which builds the same M of any filter during a run.
"""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import null_space, subspace_angles

from fej_slam_ros.core.ekf import observability
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.observability import ObservabilityRecorder
from fej_slam_ros.core.ekf.state import JointState
from helpers.core import central_differences, quarter_turn, SmallTeam, turn, Witness

KINDS = ['standard', 'ideal', 'fej', 'invariant']
#: Filters to which only rigid motions of the whole state are unobservable.
CONSISTENT = ['ideal', 'fej', 'invariant']

#: Singular values above this part of the largest count: zeros are 1e-16, the others above 1e-4.
RELATIVE = 1e-8


def joint_steps(team, steps):
    """All robots move and look at every stamp."""
    return [(team.names, team.names)] * steps


def held_robots(team, steps):
    """Move robots one by one; each observes only after the others have corrected it."""
    turns = []
    for name in team.names:
        others = [other for other in team.names if other != name]
        turns += [([name], []), (others, others), (others, []), ([], [name]), (others, others)]
    return turns * steps


def begin(kind, robots=2, landmarks=2, seed=3, iterations=1, **world):
    """Return a team, its filter, which has started all landmarks, and a witness of its calls."""
    team, witness = SmallTeam(seed, robots, landmarks, **world), Witness()
    filter_ = team.start(kind, witness, iterations)
    team.step(filter_, 1, team.names, team.names)
    witness.events.clear()
    return team, filter_, witness


def record(filter_):
    """Put a recorder in the place of a filter's covariance and return it."""
    filter_.state.covariance = ObservabilityRecorder(filter_.state.covariance)
    return filter_.state.covariance


def drive(team, filter_, schedule=joint_steps, steps=4):
    """Let a team go through a schedule; return what the updates were."""
    return [
        team.step(filter_, stamp, moving, looking)
        for stamp, (moving, looking) in enumerate(schedule(team, steps), start=2)]


def linearized_at(kind, team, state):
    """Return where a kind of filter takes the joint state at the beginning of M."""
    if kind == 'ideal':
        poses = [team.truth.pose(name, 1) for name in state.robots]
        points = [team.truth.landmark(key) for key in state.landmarks]
        return np.concatenate(poses + points)
    return (state.x_first if kind == 'fej' else state.x_hat).copy()


def run(kind, schedule=joint_steps, steps=4, **world):
    """Return M and where the kind of filter takes the joint state at the beginning of M."""
    team, filter_, witness = begin(kind, **world)
    origin = linearized_at(kind, team, filter_.state)
    drive(team, filter_, schedule, steps)
    return local_observability_matrix(witness.events), origin


def local_observability_matrix(events):
    """Return the rows H_k Phi_k-1 ... Phi_0 of a witness's events."""
    rows, transition = [], np.eye(events[0][1].shape[1])
    for what, matrix in events:
        if what == 'error':
            transition = matrix @ transition
        else:
            rows.append(matrix @ transition)
    return np.vstack(rows)


def rank(M):
    s = np.linalg.svd(M, compute_uv=False)
    return int(np.sum(s > RELATIVE * s[0]))


def rigid_motions(x, robots):
    """Return two translations and the rotation of a joint state, as columns."""
    N = np.zeros((len(x), 3))
    for i in range(robots):
        N[3 * i:3 * i + 2, :2] = np.eye(2)
        N[3 * i:3 * i + 2, 2], N[3 * i + 2, 2] = quarter_turn(x[3 * i:]), 1.0
    for k in range(3 * robots, len(x), 2):
        N[k:k + 2, :2], N[k:k + 2, 2] = np.eye(2), quarter_turn(x[k:])
    return N


@pytest.mark.parametrize('meeting', [False, True])
@pytest.mark.parametrize(
    ('kind', 'expected'), [('standard', 8), ('ideal', 7), ('fej', 7), ('invariant', 7)])
@pytest.mark.parametrize('m', [1, 2, 10])
def test_two_robots_and_two_landmarks_have_the_ranks_of_the_paper(kind, expected, m, meeting):
    M, _ = run(kind, steps=m + 1, meeting=meeting)

    assert rank(M) == expected


@pytest.mark.parametrize('meeting', [False, True])
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
@pytest.mark.parametrize(('robots', 'landmarks'), [(1, 3), (2, 4), (3, 4), (5, 2)])
def test_only_the_standard_filter_gains_a_direction(kind, schedule, robots, landmarks, meeting):
    M, _ = run(kind, schedule, robots=robots, landmarks=landmarks, meeting=meeting)

    assert rank(M) == 3 * robots + 2 * landmarks - 3 + (kind == 'standard')


@pytest.mark.parametrize('meeting', [False, True])
@pytest.mark.parametrize(
    ('kind', 'iterations'),
    [('ideal', 1), ('fej', 1), ('fej', 3), ('invariant', 1), ('invariant', 3)])
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
@pytest.mark.parametrize('noise', [1.0, 5.0])
def test_unobservable_directions_are_rigid_motions_at_any_noise(
    kind, iterations, schedule, noise, meeting
):
    M, origin = run(
        kind, schedule, robots=3, landmarks=4, iterations=iterations, noise=noise,
        meeting=meeting)

    unknown = null_space(M, rcond=RELATIVE)

    assert unknown.shape[1] == 3
    assert np.sin(subspace_angles(unknown, rigid_motions(origin, robots=3))).max() < 1e-8


@pytest.mark.parametrize('meeting', [False, True])
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
def test_the_standard_filter_has_only_shifts_as_unobservable_directions(schedule, meeting):
    M, origin = run('standard', schedule, robots=3, landmarks=4, meeting=meeting)
    translations = rigid_motions(origin, robots=3)[:, :2]

    assert_allclose(M @ translations, np.zeros((len(M), 2)), atol=1e-12)
    assert null_space(M, rcond=RELATIVE).shape[1] == 2


def test_iterations_do_not_make_the_standard_filter_consistent():
    M, _ = run('standard', robots=3, landmarks=4, iterations=3)

    assert null_space(M, rcond=RELATIVE).shape[1] == 2


@pytest.mark.parametrize(
    ('kind', 'iterations'), [*((kind, 1) for kind in KINDS), ('invariant', 3)])
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
@pytest.mark.parametrize('world', [
    {'robots': 1, 'landmarks': 2}, {'robots': 3, 'landmarks': 4, 'meeting': True}])
def test_the_recorder_multiplies_the_jacobians_of_the_filter(
    kind, iterations, schedule, world
):
    team, filter_, witness = begin(kind, iterations=iterations, **world)
    recorded_team, recorded, _ = begin(kind, iterations=iterations, **world)
    recorder = record(recorded)

    drive(team, filter_, schedule)
    drive(recorded_team, recorded, schedule)

    # Rounding of products in another order.
    assert_allclose(
        np.vstack(recorder.rows), local_observability_matrix(witness.events), atol=1e-12)


@pytest.mark.parametrize('kind', KINDS)
def test_recording_changes_no_bit_of_the_estimate(kind):
    settings = {'iterations': 3, 'meeting': True}
    (team, filter_, _), (recorded_team, recorded, _) = begin(kind, **settings), begin(
        kind, **settings)
    record(recorded)

    drive(team, filter_, held_robots)
    drive(recorded_team, recorded, held_robots)

    variables = filter_.state.variables()
    assert_array_equal(recorded.state.x_hat, filter_.state.x_hat)
    assert_array_equal(recorded.state.marginal(variables), filter_.state.marginal(variables))


def test_rejected_observations_are_not_recorded():
    team, filter_, _ = begin('fej')
    filter_.gate = Gate(0.5)
    recorder = record(filter_)

    updates = [update for update in drive(team, filter_) if update.used]

    assert any(update.rejected for update in updates)
    assert [len(rows) for rows in recorder.rows] == [2 * len(update.used) for update in updates]


@pytest.mark.parametrize('kind', CONSISTENT)
@pytest.mark.parametrize(('robots', 'landmarks'), [(1, 2), (2, 2), (3, 4)])
def test_unobservable_directions_of_a_recorded_filter_are_rigid_motions(kind, robots, landmarks):
    team, filter_, _ = begin(kind, robots, landmarks)
    expected = rigid_motions(linearized_at(kind, team, filter_.state), robots)
    recorder = record(filter_)
    drive(team, filter_)

    unknown = observability.null_space(np.vstack(recorder.rows))

    assert unknown.shape[1] == 3
    assert np.sin(subspace_angles(unknown, expected)).max() < 1e-8


@pytest.mark.parametrize('rows', [5, 40])
def test_singular_values_below_1e_8_of_the_largest_are_zero(rows):
    rng = np.random.default_rng(1)
    U, V = (np.linalg.qr(rng.normal(size=(size, 5)))[0] for size in (rows, 5))

    M = U * [50.0, 3.0, 2.0, 5e-6, 5e-8] @ V.T

    assert observability.rank(M) == 4
    assert_allclose(observability.singular_values(M)[:4], [1.0, 0.06, 0.04, 1e-7], rtol=1e-8)
    # M is known to 1e-16 of its largest singular value, its null space to that over 1e-7.
    assert np.sin(subspace_angles(observability.null_space(M), V[:, 4:])).max() < 1e-8


def test_fewer_rows_than_states_leave_unobservable_directions():
    M = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 2.0, 0.0, 0.0]])

    unknown = observability.null_space(M)

    assert_allclose(M @ unknown, np.zeros((2, 2)), atol=1e-15)
    assert_allclose(unknown.T @ unknown, np.eye(2), atol=1e-15)


def test_rigid_motions_are_derivatives_of_a_moved_state():
    state, x = JointState(), np.array([1.0, 2.0, 0.3, -4.0, 5.0, 6.0, -7.0, -2.0, 8.0, 9.0])
    for number, (name, begin_at) in enumerate([('r1', 0), ('r2', 5)]):
        robot = state.insert_robot(name, 0, x[begin_at:begin_at + 3], np.eye(3))
        point = x[begin_at + 3:begin_at + 5]
        state.augment(('', number), robot, point, np.zeros((2, 3)), np.eye(2))

    def moved(motion):
        points = x[[[0, 1], [3, 4], [5, 6], [8, 9]]] @ turn(motion[2]).T + motion[:2]
        headings = x[[2, 7]] + motion[2]
        return np.concatenate([
            points[0], headings[:1], points[1], points[2], headings[1:], points[3]])

    # Step^2 times coordinates of order 10.
    assert_allclose(
        observability.rigid_motions(state, x), central_differences(moved, np.zeros(3)), atol=1e-8)


def test_the_largest_sine_is_independent_of_the_basis():
    plane = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    tilted = np.array([[1.0, 0.0], [0.0, np.cos(1e-6)], [0.0, np.sin(1e-6)]])

    sine = observability.largest_sine(plane @ [[2.0, 1.0], [0.0, 3.0]], tilted)

    assert sine == pytest.approx(1e-6, rel=1e-8)
    assert observability.largest_sine(plane, plane[:, :1]) == pytest.approx(1.0)
