# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of parameters during a run."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import chain, count
from typing import Any

from fej_slam_ros.core.parameter_kinds import Parameter, parameters_of
from fej_slam_ros.core.settings import NoiseSettings, RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.node_settings import CommonNodeSettings, NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.parsing import check_files, check_peer_files, team_names
from fej_slam_ros.ros.parameters.schema import (
    Audience, deciding, ESTIMATOR, known_parameters, QOS_OVERRIDES, SMOOTHER, Value)
from fej_slam_ros.ros.parameters.values import (
    checked_values, RENAMED_PARAMETERS, robot_names, shortened, unknown_parameter)


@dataclass(frozen=True)
class ParameterChange:
    """A change of a parameter of estimation during a run."""

    parameter: str
    before: Value
    after: Value
    last_step_ns: int | None  #: stamp of the newest step before the change, None if there is none


def changeable_parameters(robots: Sequence[str], audience: Audience) -> set[str]:
    """Return the parameters of a team that can change while a node of the audience runs."""
    # The smoother reads the other parameters of estimation when a run begins.
    of_smoother = {'robots', 'peers', *parameters_of(CommonNodeSettings)}
    return {
        name for name, parameter in known_parameters(robots, audience).items()
        if parameter.changeable and (audience is ESTIMATOR or name in of_smoother)}


def rejection(
    name: str, known: Mapping[str, Parameter], changeable: Collection[str]
) -> str | None:
    """Return why a parameter cannot change during a run, None if it can."""
    if name in changeable:
        return None
    if name in RENAMED_PARAMETERS:
        return f'parameter {name!r} is the old name of {RENAMED_PARAMETERS[name]!r}: set that'
    if name not in known and not name.startswith(QOS_OVERRIDES):
        return unknown_parameter(name, known)
    return (
        f'parameter {shortened(name)!r} is read when the node starts: set it in the parameter'
        ' file, or with -p on the command line, and start the node again')


def checked_changes(
    settings: RunSettings, values: Mapping[str, object], audience: Audience
) -> dict[str, Any]:
    """Return new values of changeable parameters as the settings store them, if they are valid."""
    robots = [robot.name for robot in settings.estimation.robots]
    checked = checked_values(values, known_parameters(robots, audience))
    node = with_node_values(settings.node, checked)
    check_files(replace(settings, node=node))
    if audience is SMOOTHER and node.peers:
        check_peer_files(node)
    return checked


def changes_before(settings: RunSettings) -> str:
    """Return what differs in a run from what its process was started with, '' if nothing does."""
    given, present = deciding(settings.given()), deciding(settings.estimation)
    return ', '.join(
        f'{name} = {present[name]!r}, not {given[name]!r}' for name in given
        if name in present and present[name] != given[name])


def with_node_values(node: NodeSettings, values: Mapping[str, Any]) -> NodeSettings:
    """Return the settings of a node with new values; those of estimation are left out."""
    own = parameters_of(NodeSettings)
    return replace(node, **{name: value for name, value in values.items() if name in own})


def with_values(settings: Settings, values: Iterable[tuple[str, Any]]) -> Settings:
    """
    Return settings with other values of parameters of the team and of its robots.

    New noise of the team is also that of the robots whose value was that of the team.

    """
    return reduce(_with_value, values, settings)


def changed_team(
    settings: Settings, robots: Mapping[str, RobotSettings], value: object
) -> list[RobotSettings]:
    """
    Return the robots for a new value of the parameter ``robots`` during a run.

    The present robots keep their settings; one that was not in the team at the start has the noise
    of the team in the settings at present.

    """
    names = robot_names(value)
    known = {robot.name: robot for robot in settings.robots} | dict(robots)
    for name in names:
        if name not in known:
            known[name] = RobotSettings(
                name, 1 + max(robot.id for robot in known.values()),
                **{field: getattr(settings, field) for field in parameters_of(NoiseSettings)})
    return [known[name] for name in names]


def changed_peers(
    settings: Settings, robots: Mapping[str, RobotSettings], value: object
) -> list[RobotSettings]:
    """
    Return the robots for new names of the own robot and its peers during a run.

    A robot of the start has the ID that it had. As at the start, that of another one is its
    position in the sorted names, on which all robots agree; a UsageError says if a robot that
    comes would change that of another.

    """
    own, *others = robot_names(value)
    team = changed_team(settings, robots, team_names({'robots': [own], 'peers': others or [own]}))
    before, after = (
        {name: k for k, name in enumerate(sorted(names), start=1)}
        for names in (robots, [robot.name for robot in team]))
    new, present = after.keys() - before, [robot for robot in team if robot.name in before]
    for robot in present if new else ():
        if robot.id == before[robot.name] != after[robot.name]:
            raise UsageError(
                f"parameter 'peers' would change the ID of {robot.name!r} from {robot.id} to"
                f' {after[robot.name]}, its position in the sorted names: start again with'
                " '<robot>.id' of each robot, or give the new robots names that come last")
    ids = {robot.name: robot.id for robot in present}
    of_start = {robot.name for robot in settings.robots}
    # Robots that return come first: no other one is given the ID of one of them.
    for robot in sorted(team, key=lambda robot: robot.name not in of_start):
        if robot.name in new:
            first = robot.id if robot.name in of_start else after[robot.name]
            wanted = chain([first, after[robot.name]], count(robot.id))
            ids[robot.name] = next(number for number in wanted if number not in ids.values())
    return [replace(robot, id=ids[robot.name]) for robot in team]


def _with_value(settings: Settings, change: tuple[str, Any]) -> Settings:
    name, value = change
    owner, _, field = name.rpartition('.')

    def follows(robot: RobotSettings) -> bool:
        return robot.name == owner or (
            not owner and field in parameters_of(NoiseSettings)
            and getattr(robot, field) == getattr(settings, field))

    robots = tuple(
        replace(robot, **{field: value}) if follows(robot) else robot for robot in settings.robots)
    return replace(settings, robots=robots, **({} if owner else {field: value}))
