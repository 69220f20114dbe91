# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of parameters during a run."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import Any

from fej_slam_ros.core.parameter_kinds import Parameter, parameters_of
from fej_slam_ros.core.settings import NoiseSettings, RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.node_settings import CommonNodeSettings, NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.parsing import (
    check_files, checked_values, RENAMED_PARAMETERS, shortened, unknown_parameter)
from fej_slam_ros.ros.parameters.schema import (
    Audience, ESTIMATOR, known_parameters, QOS_OVERRIDES, Value)


@dataclass(frozen=True)
class ParameterChange:
    """A change of a parameter of estimation during a run."""

    parameter: str
    before: Value
    after: Value
    last_step_ns: int | None  #: stamp of the newest step before the change, None if there is none

    def as_json(self) -> dict[str, Any]:
        """Return the change as plain data, for ``summary.json`` and checkpoints."""
        return asdict(self)


def changeable_parameters(robots: Sequence[str], audience: Audience = ESTIMATOR) -> set[str]:
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
    settings: RunSettings, robots: Sequence[str], values: Mapping[str, object],
    audience: Audience = ESTIMATOR,
) -> dict[str, Any]:
    """Return the new values of some parameters as the settings store them, if they may change."""
    known = known_parameters(robots, audience)
    changeable = changeable_parameters(robots, audience)
    for name in values:
        reason = rejection(name, known, changeable)
        if reason is not None:
            raise UsageError(reason)
    checked = checked_values(values, known)
    check_files(replace(settings, node=with_node_values(settings.node, checked)))
    return checked


def with_node_values(node: NodeSettings, values: Mapping[str, Any]) -> NodeSettings:
    """Return the settings of a node with those of some values that are its own."""
    own = parameters_of(NodeSettings)
    return replace(node, **{name: value for name, value in values.items() if name in own})


def with_values(settings: Settings, values: Iterable[tuple[str, Any]]) -> Settings:
    """
    Return settings with other values of parameters of the team and of its robots.

    New noise of the team is also that of the robots whose value was that of the team.

    """
    return reduce(_with_value, values, settings)


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
