# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks without ID are found in another frame, or rejected if they fit there twice."""

import numpy as np
import pytest

from fej_slam_ros.core.data_association.constellations import renamed, shared_landmarks
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import inverse, transform
from fej_slam_ros.core.join_failure import JoinFailure

G = np.array([4.0, -3.0, 2.0])
SIGMA = 0.03
NOTHING_ELSE = np.empty((0, 2))


def map_of(points, first_id, rng, name='r1'):
    """Return the state of a robot at the origin that has observed points (n, 2) without ID."""
    state = JointState()
    robot = state.insert_robot(name, 0, np.zeros(3), 1e-6 * np.eye(3))
    R = SIGMA**2 * np.eye(2)
    for k, point in enumerate(points):
        z = point + rng.normal(0.0, SIGMA, 2)
        state.augment(
            ('', first_id - k), robot, z, np.column_stack([np.eye(2), [-z[1], z[0]]]), R)
    for landmark in state.landmarks.values():
        landmark.tentative = None
    return state


def two_maps(shared, only_ours=NOTHING_ELSE, only_theirs=NOTHING_ELSE, seed=0):
    """Return the maps of two robots, the second in a frame at G, that share landmarks."""
    rng = np.random.default_rng(seed)
    ours = map_of(np.vstack([shared, only_ours]), -2, rng)
    theirs = transform(inverse(G), rng.permutation(np.vstack([shared, only_theirs])))
    return ours, map_of(theirs, -1000, rng, 'r2')


def random_points(n, seed, half_width=8.0):
    """Return points (n, 2) at least 1 m from each other."""
    rng, points = np.random.default_rng(seed), np.empty((0, 2))
    while len(points) < n:
        point = rng.uniform(-half_width, half_width, 2)
        if np.hypot(*(points - point).T).min(initial=np.inf) > 1.0:
            points = np.vstack([points, point])
    return points


def place(state, key):
    return state.estimate(state.landmarks[key])


@pytest.mark.parametrize('seed', range(20))
def test_the_same_landmarks_get_the_same_keys(seed):
    points = random_points(16, seed)
    ours, theirs = two_maps(points[:6], points[6:11], points[11:], seed)

    keys = shared_landmarks(ours, theirs)

    assert not isinstance(keys, JoinFailure), keys.reason
    found = renamed(theirs, keys)
    shared = found.landmarks.keys() & ours.landmarks.keys()
    assert len(shared) == 6
    for key in shared:
        # Five standard deviations of two observations.
        assert transform(G, place(found, key)[None])[0] == pytest.approx(
            place(ours, key), abs=5.0 * np.sqrt(2.0) * SIGMA)
    assert theirs.landmarks.keys().isdisjoint(ours.landmarks.keys())


@pytest.mark.parametrize('seed', range(5))
def test_a_few_landmarks_are_found_in_a_large_map(seed):
    """Those that were observed first, and beside as many that the large map does not have."""
    points = random_points(116, seed, half_width=30.0)
    near = np.argsort(np.hypot(*points.T))
    shared, only_theirs, only_ours = np.split(points[near], [8, 16])
    ours, theirs = two_maps(shared, only_ours, only_theirs, seed)

    keys = shared_landmarks(ours, theirs)

    assert not isinstance(keys, JoinFailure), keys.reason
    assert len(keys) >= 7
    assert {*keys.values()} <= {('', -2 - k) for k in range(8)}


def test_a_renamed_map_is_otherwise_the_same():
    ours, theirs = two_maps(random_points(7, 0))

    found = renamed(theirs, shared_landmarks(ours, theirs))

    np.testing.assert_array_equal(found.estimates(), theirs.estimates())
    np.testing.assert_array_equal(
        found.marginal(found.variables()), theirs.marginal(theirs.variables()))


ROW = np.column_stack([1.5 * np.arange(8), np.full(8, 2.0)])
GRID = np.array([[2.0 * i, 2.0 * j] for i in range(4) for j in range(3)])
RING = np.array([[3.0 * np.cos(a), 3.0 * np.sin(a)] for a in np.arange(7) * 2.0 * np.pi / 7])
HALF = np.add(random_points(5, 3), [9.0, 0.0])


@pytest.mark.parametrize(
    ('ours', 'theirs'),
    [
        (ROW, ROW), (ROW[:6], ROW[2:]), (GRID, GRID), (GRID[:9], GRID[3:]), (RING, RING),
        # Symmetric about a point.
        (np.vstack([HALF, -HALF]), np.vstack([HALF, -HALF])),
    ],
)
def test_symmetric_and_repeated_landmarks_are_rejected(ours, theirs):
    rng = np.random.default_rng(0)

    failure = shared_landmarks(
        map_of(ours, -2, rng), map_of(transform(inverse(G), theirs), -100, rng, 'r2'))

    assert isinstance(failure, JoinFailure)
    assert 'symmetric or repeated' in failure.reason


@pytest.mark.parametrize('seed', range(20))
def test_maps_of_different_places_have_nothing_in_common(seed):
    points = random_points(24, seed)
    ours, theirs = two_maps(NOTHING_ELSE, points[:12], points[12:], seed)

    assert isinstance(shared_landmarks(ours, theirs), JoinFailure)


def test_mirrored_landmarks_are_not_the_same():
    points, rng = random_points(8, 0), np.random.default_rng(0)

    failure = shared_landmarks(
        map_of(points, -2, rng), map_of(points * [1.0, -1.0], -100, rng, 'r2'))

    assert isinstance(failure, JoinFailure)


@pytest.mark.parametrize(('count', 'named'), [(1, '1 landmark'), (4, '4 landmarks')])
def test_too_few_landmarks_are_named(count, named):
    failure = shared_landmarks(*two_maps(random_points(count, 0)))

    assert failure.reason == f'{named} without ID, needs 5'


@pytest.mark.parametrize('shared', [0, 4])
def test_fewer_than_five_landmarks_that_fit_another_map_are_named(shared):
    # No two distances to these landmarks are equal.
    alone = np.column_stack([100.0 * 2.0 ** np.arange(10), np.zeros(10)])
    ours, theirs = two_maps(random_points(4, 0)[:shared], alone[:5], alone[5:])

    failure = shared_landmarks(ours, theirs)

    assert failure.reason == (
        'fewer than 5 landmarks without ID are where another map has some')
