# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The invariant filter keeps plain coordinates and is the one that keeps those of its error.

Mutations, each tried once in a copy of the sources, that fail here: transport left out, after the
update or between iterations, or from the last iterate instead of the prior; all owned by the first
robot; V(theta) = I or V(-theta); H or innovation of the first iterate in all, H dx left out, each
iterate added to the last one; the last of two blocks where a column of H is named twice.
"""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ekf import linearization
from helpers.core import pose_difference, SmallTeam
from helpers.invariant_reference import InvariantReference


@pytest.fixture(autouse=True)
def landmarks_turn_with_their_first_observers(monkeypatch):
    """As those of the reference do, however little a robot knows about its turns."""
    monkeypatch.setattr(linearization, 'MAX_HEADING_DRIFT', np.inf)


def after_one_run(robots, iterations, meeting):
    """Return the state of the filter and the reference, given the same with three-fold noise."""
    team = SmallTeam(seed=1, robots=robots, landmarks=6, noise=3.0, meeting=meeting)
    filter_ = team.start('invariant', iterations=iterations)
    state = filter_.state
    reference = InvariantReference(
        [(name, state.estimate(robot), team.P) for name, robot in state.robots.items()],
        iterations)
    for k in range(40):
        moving, looking = team.names[:k % 3 + 1], team.names[k % 2:]
        motions, _, meetings = team.measured(k + 1, moving, looking)
        # New landmarks come in sight one by one.
        scans = [team.look(name, [k % 6, k // 4 % 6]) for name in looking]
        for each in (filter_, reference):
            each.step(motions, scans, meetings)
    return state, reference


@pytest.mark.parametrize('meeting', [False, True])
@pytest.mark.parametrize('iterations', [1, 2, 3])
@pytest.mark.parametrize('robots', [1, 2, 3])
def test_the_filter_equals_the_reference_in_error_coordinates(robots, iterations, meeting):
    state, reference = after_one_run(robots, iterations, meeting)

    poses = np.array([state.estimate(robot) for robot in state.robots.values()])
    points = [state.estimate(landmark) for landmark in state.landmarks.values()]
    expected = reference.plain_covariance()
    # Forty steps of rounding; 4e-14 and 6e-15 here.
    assert np.abs(pose_difference(poses, np.array(reference.poses()))).max() < 4e-13
    assert_allclose(points, reference.points(), atol=4e-13)
    assert_allclose(
        state.marginal(state.variables()), expected, rtol=0.0, atol=5e-14 * expected.max())


def test_corrections_are_large_enough_to_distinguish_the_filters():
    by_iterations = [after_one_run(2, iterations, True)[0].x_hat for iterations in (1, 2, 3)]

    assert np.abs(by_iterations[1] - by_iterations[0]).max() > 1e-2
    assert np.abs(by_iterations[2] - by_iterations[1]).max() > 1e-3
