# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timed campaigns run all experiments; speed itself is not tested."""

import pytest

from fej_slam_ros.benchmark import run_speed


@pytest.mark.slow
def test_all_experiments_of_the_paper_are_timed():
    timed = run_speed.campaign_time(runs=1, jobs=2)

    assert (timed.runs, timed.jobs) == (1, 2)
    assert timed.seconds > 0.0
    # Three Python processes with numpy and scipy, in bytes.
    assert timed.memory > 3 * 40e6
