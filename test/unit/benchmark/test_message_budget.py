# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of the way of a message are timed apart, and together are the whole way."""

from dataclasses import asdict

from fej_slam_ros.benchmark.message_budget import BUDGET_RATE, message_budget
from fej_slam_ros.benchmark.tables import budget_table


def test_the_parts_of_the_way_of_a_message_add_up_to_the_load():
    budget = message_budget(robots=2, landmarks=20, seconds=10)

    assert budget.states > 2 * 3
    assert all(value > 0.0 for value in asdict(budget).values())
    odometry = budget.odometry + budget.order + budget.publish + budget.odometry_step
    # Every second odometry has a scan at its stamp.
    scans = budget.scan + budget.scan_step - budget.odometry_step
    of_parts = 2 * (BUDGET_RATE * odometry + BUDGET_RATE / 2 * scans)
    # Medians leave out what is rare, and the processor's pauses: a factor, no more.
    assert 0.3 * budget.cpu < of_parts < 1.5 * budget.cpu


def test_the_table_has_a_row_for_each_team_in_microseconds():
    budget = message_budget(robots=2, landmarks=20, seconds=2)

    head, row = budget_table([budget]).splitlines()

    assert head.startswith('robots, us')
    assert row.split()[:3] == ['2', str(budget.states), f'{1e6 * budget.odometry:.0f}']
