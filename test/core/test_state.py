# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A variable that leaves the joint state takes nothing with it but itself."""

from core_helpers import SmallTeam
from numpy.testing import assert_allclose, assert_array_equal
import pytest


def mapped(kind='fej'):
    """Return a team of three robots and its filter, which knows four landmarks."""
    team = SmallTeam(seed=5, robots=3, landmarks=4)
    filter_ = team.start(kind)
    for stamp in (1, 2, 3):
        team.step(filter_, stamp, team.names, team.names)
    return team, filter_


def a_robot(state):
    return state.robots['r2']


def a_landmark(state):
    return state.landmarks['', 1]


def numbers(state, variables):
    """Return estimates, first estimates and joint covariance of some variables."""
    return [
        *map(state.estimate, variables), *map(state.first_estimate, variables),
        state.marginal(variables)]


@pytest.mark.parametrize('chosen', [a_robot, a_landmark])
def test_all_others_keep_every_bit(chosen):
    _, filter_ = mapped()
    state = filter_.state
    others = [variable for variable in state.variables() if variable is not chosen(state)]
    before = numbers(state, others)

    state.remove(chosen(state))

    assert state.variables() == others
    assert len(state.x_hat) == len(state.x_first) == len(before[-1])
    for now, then in zip(numbers(state, others), before):
        assert_array_equal(now, then)


@pytest.mark.parametrize('chosen', [a_robot, a_landmark])
@pytest.mark.parametrize('kind', ['fej', 'standard'])
def test_the_filter_goes_on_as_one_that_hears_no_more_of_it(kind, chosen):
    team, filter_ = mapped(kind)
    _, full = mapped(kind)
    filter_.state.remove(chosen(filter_.state))

    for stamp in range(4, 9):
        motions = [team.drive(name, stamp) for name in ('r1', 'r3')]
        scans = [team.look(name, [0, 2, 3]) for name in ('r1', 'r3')]
        for each in (filter_, full):
            each.step(motions, scans)

    found = numbers(filter_.state, filter_.state.variables())
    kept = [v for v in full.state.variables() if v is not chosen(full.state)]
    for now, expected in zip(found, numbers(full.state, kept)):
        assert_allclose(now, expected, atol=1e-12)  # BLAS rounds differently in other places


def test_a_landmark_that_was_removed_starts_anew_where_it_is_seen_next():
    team, filter_ = mapped()
    filter_.state.remove(a_landmark(filter_.state))

    left = filter_.start_landmarks([team.look('r3')])

    landmark = a_landmark(filter_.state)
    assert {a.seen.key for a in left} == {('', 0), ('', 2), ('', 3)}
    assert landmark.owner == 'r3'
    assert_array_equal(
        filter_.state.estimate(landmark), filter_.state.first_estimate(landmark))
