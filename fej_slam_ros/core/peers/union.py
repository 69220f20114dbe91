# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smoother of all measurements that a robot has, its own ones and those of others.

It is the central smoother over the union of all logs, and depends on their measurements only, not
on when or from which robot they arrived: robots with the same logs and parameters have the same
result.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from heapq import merge
from operator import attrgetter
import sys

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.peers.blocks import Measurement
from fej_slam_ros.core.peers.team_logs import LogContents
from fej_slam_ros.core.settings import NoiseSettings, Settings
from fej_slam_ros.core.smoothing.incremental import SOLVE_EVERY


@dataclass(frozen=True, slots=True, eq=False)
class UnionTask:
    """Input of `smoothed_union`."""

    settings: Settings  #: of the team; the noise of each robot is that of its log
    logs: Mapping[str, LogContents]  #: measurements of each robot by name
    noise: Mapping[str, NoiseSettings]
    solve_every: int  #: as in `TeamSmoother`
    #: stamp [ns] of the last measurement of a robot that counts, by default all count
    until: Mapping[str, int] = field(default_factory=dict)


def smoothed_union(task: UnionTask) -> TeamSmoother:
    """Return the smoother of all measurements, with their solution."""
    by_stamp, logs = attrgetter('stamp'), []
    for robot, log in sorted(task.logs.items()):
        until = task.until.get(robot, sys.maxsize)
        logs.append(sorted((m for m in log.measurements() if m.stamp <= until), key=by_stamp))
    team = unsolved(team_settings(task), merge(*logs, key=by_stamp), task.solve_every)
    team.adopt(solve(team.task()))
    return team


def unsolved(
    settings: Settings, measurements: Iterable[Measurement], solve_every: int = SOLVE_EVERY
) -> TeamSmoother:
    """Return the smoother of measurements in the order of stamps, before it is solved."""
    # Their robots have applied their limits, which may differ, before their logs.
    settings = replace(settings, max_observations=sys.maxsize, max_delay=Settings.max_delay)
    team = TeamSmoother(settings, solve_every)
    for measurement in measurements:
        team.add(measurement)
        for _ in team.take():
            pass
    for _ in team.release():
        pass
    return team


def team_settings(task: UnionTask) -> Settings:
    """Return the settings in which each robot has the noise of its log."""
    robots = [
        replace(robot, **vars(task.noise[robot.name])) for robot in task.settings.robots
        if robot.name in task.noise]
    return replace(task.settings, robots=tuple(robots))
