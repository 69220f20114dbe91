# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic log has the size of the real one, and all parts of a solution are timed."""

import pytest

from fej_slam_ros.benchmark import smoother_speed


def test_the_synthetic_log_is_as_large_as_that_of_victoria_park():
    problem, values = smoother_speed.synthetic_log()

    assert values.poses[1:].size + values.points.size == 21292
    assert len(problem.landmarks.z) == pytest.approx(45390, rel=0.1)
    # Nothing is left open: every landmark is seen.
    assert set(problem.landmarks.target) == set(range(len(values.points)))


@pytest.mark.slow
def test_all_parts_of_a_solution_are_timed():
    timed = smoother_speed.smoother_time('log', *smoother_speed.synthetic_log())

    assert timed.unknowns == 21292
    # One more factorisation is a part of beginning.
    assert 0.0 < timed.factorisation < timed.begin
    assert timed.marginals > 0.0
