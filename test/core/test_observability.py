# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lemma 1 of [Liu]: the rank of the local observability matrix M of a run with noise.

M is put together from the very Phi and H that a run of the filter multiplied its covariance with.

Mutations, each tried once in a copy of the sources, gave FEJ the rank of the standard filter:
standard Phi, current landmarks in H, first estimates refreshed by updates; the current pose in H,
which is the first estimate unless another robot has corrected it, only with `held_robots`.
"""

from core_helpers import quarter_turn, SmallTeam, Witness
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.linalg import null_space, subspace_angles

#: Singular values above this part of the largest count: zeros are 1e-16, the others above 1e-4.
RELATIVE = 1e-8


def joint_steps(team, steps):
    """All robots move and look at every stamp."""
    return [(team.names, team.names)] * steps


def held_robots(team, steps):
    """Move robots one by one; who moved looks only after the others have corrected it."""
    turns = []
    for name in team.names:
        others = [other for other in team.names if other != name]
        turns += [([name], []), (others, others), (others, []), ([], [name]), (others, others)]
    return turns * steps


def run(kind, schedule=joint_steps, robots=2, landmarks=2, steps=4, seed=3):
    """Return M and where the kind of filter takes the joint state at the beginning of M."""
    team, witness = SmallTeam(seed, robots, landmarks), Witness()
    filter_ = team.start(kind, witness)
    state = filter_.state
    team.step(filter_, 1, team.names, team.names)
    witness.events.clear()
    origin = state.x_first.copy()
    if kind == 'ideal':
        poses = [team.truth.pose(name, 1) for name in state.robots]
        points = [team.truth.landmark(key) for key in state.landmarks]
        origin = np.concatenate(poses + points)
    for stamp, (moving, looking) in enumerate(schedule(team, steps), start=2):
        team.step(filter_, stamp, moving, looking)
    return local_observability_matrix(witness.events, len(origin)), origin


def local_observability_matrix(events, n):
    """Return the rows H_k Phi_k-1 ... Phi_0 of a witness's events."""
    rows, transition = [], np.eye(n)
    for indices, matrix in events:
        if indices.ndim == 1:
            transition[indices] = matrix @ transition[indices]
        else:
            rows += [block @ transition[columns] for columns, block in zip(indices, matrix)]
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


@pytest.mark.parametrize(('kind', 'expected'), [('standard', 8), ('ideal', 7), ('fej', 7)])
@pytest.mark.parametrize('m', [1, 2, 10])
def test_two_robots_and_two_landmarks_have_the_ranks_of_the_paper(kind, expected, m):
    M, _ = run(kind, steps=m + 1)

    assert rank(M) == expected


@pytest.mark.parametrize(('kind', 'extra'), [('standard', 1), ('ideal', 0), ('fej', 0)])
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
@pytest.mark.parametrize(('robots', 'landmarks'), [(1, 3), (2, 4), (3, 4), (5, 2)])
def test_only_the_standard_filter_gains_a_direction(kind, extra, schedule, robots, landmarks):
    M, _ = run(kind, schedule, robots, landmarks)

    assert rank(M) == 3 * robots + 2 * landmarks - 3 + extra


@pytest.mark.parametrize('kind', ['ideal', 'fej'])
@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
def test_what_stays_unknown_is_a_rigid_motion_of_everything(kind, schedule):
    M, origin = run(kind, schedule, robots=3, landmarks=4)

    unknown = null_space(M, rcond=RELATIVE)

    assert unknown.shape[1] == 3
    assert np.sin(subspace_angles(unknown, rigid_motions(origin, robots=3))).max() < 1e-8


@pytest.mark.parametrize('schedule', [joint_steps, held_robots])
def test_the_standard_filter_knows_only_that_it_may_be_shifted(schedule):
    M, origin = run('standard', schedule, robots=3, landmarks=4)
    translations = rigid_motions(origin, robots=3)[:, :2]

    assert_allclose(M @ translations, np.zeros((len(M), 2)), atol=1e-12)
    assert null_space(M, rcond=RELATIVE).shape[1] == 2
