# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots that join, and those that are not smoothed, have a line of the log."""

from fej_slam_ros.core.csam.team_solution import solve, TeamMap
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.records import odometry
from helpers.ros import log_texts, meeting, raw_record, run_settings


def test_the_smoother_logs_joined_and_unsolved_robots():
    run = SmootherSession(run_settings(), None)
    for record in meeting():
        run.receive(raw_record(record))
    list(run.release())
    list(run.adopt(solve(run.team.task())))
    list(run.adopt(TeamMap(unsolved={'r1': 'no minimum'})))
    list(run.adopt(solve(run.team.task())))

    assert log_texts(run) == [
        'r1 joined map, by its anchor_pose',
        'r2 joined map, by observations of robots and shared landmarks',
        'r1 is not smoothed: no minimum', 'r1 is smoothed again']


def test_a_robot_that_starts_over_has_a_line_with_the_reason():
    run = SmootherSession(run_settings('r1'), None)
    for ms in range(0, 1000, 100):
        run.receive(raw_record(odometry('r1', ms, (50.0 * (ms >= 500), 0.0, 0.0))))
        list(run.take())

    assert log_texts(run) == [
        'r1 starts over, without its map: its odometry moved 50.0 m in 0.10 s']
