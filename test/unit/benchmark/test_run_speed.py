# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark measures is what it says; how fast it is, is not a test's matter."""

import pytest

from fej_slam_ros.benchmark import run_speed


@pytest.mark.slow
def test_all_experiments_of_the_paper_are_timed():
    timed = run_speed.campaign_time(runs=1, jobs=2)

    assert (timed.runs, timed.jobs) == (1, 2)
    assert timed.seconds > 0.0
    # Three Python processes with numpy and scipy, in bytes.
    assert timed.memory > 3 * 40e6


def test_the_synthetic_log_is_as_large_as_that_of_victoria_park():
    problem, values = run_speed.synthetic_log()

    assert values.poses[1:].size + values.points.size == 21292
    assert len(problem.landmarks.z) == pytest.approx(45390, rel=0.1)
    # Nothing is left open: every landmark is seen.
    assert set(problem.landmarks.landmark) == set(range(len(values.points)))


def test_all_parts_of_a_smoothers_work_are_timed():
    timed = run_speed.smoother_time('log', *run_speed.synthetic_log())

    assert timed.unknowns == 21292
    # One more factorisation is a part of beginning.
    assert 0.0 < timed.factorisation < timed.begin
    assert timed.marginals > 0.0
