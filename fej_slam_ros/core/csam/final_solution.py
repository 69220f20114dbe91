# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The final solution of a team, with the sizes of the messages that align two maps."""

from collections.abc import Mapping
from dataclasses import dataclass

from fej_slam_ros.core.csam.message_sizes import sizes
from fej_slam_ros.core.csam.team_solution import SmoothingTask, solve, TeamMap


@dataclass(frozen=True, slots=True, eq=False)
class FinalSolution:
    """Result of `final_solution`."""

    team_map: TeamMap
    #: sizes [bytes] of the messages that align two maps by form, for each (sender, receiver)
    message_sizes: Mapping[tuple[str, str], Mapping[str, int]]


def final_solution(task: SmoothingTask) -> FinalSolution:
    """Return the solution of a task, and the sizes of messages between the solved robots."""
    team_map = solve(task)
    maps = [local for local in task.maps if local.robot not in team_map.unsolved]
    names = {local.robot for local in maps}
    return FinalSolution(team_map, sizes(
        maps, [m for m in task.measurements if {m.observer, m.observed} <= names]))
