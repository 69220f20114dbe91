# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All parts of a solution are timed; smoothers have the same data, and estimate the same."""

import pytest

from fej_slam_ros.benchmark import smoother_speed
from fej_slam_ros.benchmark.smoother_speed import growth_times, OUR_SMOOTHER, WINDOWS
from fej_slam_ros.benchmark.tables import growth_table


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


def test_the_table_has_a_row_for_each_window_with_ratios_to_ours():
    times = growth_times(40, {})

    head, *rows = growth_table(times).splitlines()

    assert head.split()[-3:] == ['ours', 'RMSE', '[m]']
    assert [row.split()[:2] for row in rows] == [
        [OUR_SMOOTHER, str(poses)] for poses in range(4, 44, 4)]
    assert {tuple(row.split()[-3:-1]) for row in rows} == {('1.0', '1.0')}


def test_each_window_of_poses_is_timed_for_every_smoother():
    isam2 = pytest.importorskip(
        'fej_slam_ros.benchmark.isam2', reason='gtsam is not installed')

    times = growth_times(205, {'iSAM2': lambda: isam2.Isam2(10)})

    assert [(time.name, time.poses) for time in times[:3]] == [
        (OUR_SMOOTHER, 21), ('iSAM2', 21), (OUR_SMOOTHER, 42)]
    assert len(times) == 2 * WINDOWS
    assert times[-1].poses == 205
    for ours, theirs in zip(times[::2], times[1::2]):
        # Linearised at different points, with errors of the start and of landmarks in common.
        assert ours.rmse == pytest.approx(theirs.rmse, rel=0.35, abs=0.02)
