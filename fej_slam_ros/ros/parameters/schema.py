# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names, kinds and descriptions of all parameters, from the settings that declare them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

from fej_slam_ros.core.parameter_kinds import (
    Kind, numbers, one_of, Parameter, parameters_of, Range)
from fej_slam_ros.core.settings import (
    CommonRobotSettings, EstimatorSettings, NoiseSettings, RobotSettings, Settings,
    SmootherSettings)
from fej_slam_ros.ros.parameters.node_settings import (
    EstimatorNodeSettings, NodeSettings, RunSettings, SmootherNodeSettings)

#: A value of a parameter, as ROS takes it.
Value = bool | int | float | str | list[float] | list[str]
#: Classes that declare the parameters of the team, of a node and of each robot.
Audience = tuple[type, type, type]

ALL: Audience = (Settings, NodeSettings, RobotSettings)
ESTIMATOR: Audience = (EstimatorSettings, EstimatorNodeSettings, RobotSettings)
SMOOTHER: Audience = (SmootherSettings, SmootherNodeSettings, CommonRobotSettings)

#: Beginning of the names of parameters that override the quality of service of topics.
QOS_OVERRIDES = 'qos_overrides.'
#: Kinds of the policies in names such as ``qos_overrides./r1/odom.subscription.depth``.
QOS_POLICIES = {
    'reliability': one_of('reliable', 'best_effort', 'best_available', 'system_default'),
    'durability': one_of('volatile', 'transient_local', 'best_available', 'system_default'),
    'history': one_of('keep_last', 'keep_all', 'system_default'),
    'depth': numbers('an integer', Range(0, 2**31 - 1), element=int),
}


def declared_parameters(settings: type) -> dict[str, Parameter]:
    """Return the parameters that some settings declare, those of noise last."""
    declared = parameters_of(settings)
    noise = parameters_of(NoiseSettings)
    return {name: declared[name] for name in sorted(declared, key=noise.__contains__)}


def known_parameters(
    robots: Sequence[str] = ('<robot>',), audience: Audience = ALL
) -> dict[str, Parameter]:
    """Return the parameters of a team by their full names."""
    team, node, robot = map(declared_parameters, audience)
    pairs = {f'{a}:{b}' for a, b in permutations(robots, 2)}
    kinds = {
        'anchor': one_of(*robots, ''),
        'initialpose_robot': one_of(*robots, ''),
        'relative_poses': Kind(
            "a list of pairs such as 'r1:r2' of two robots", str, (None,), pairs.__contains__)}
    of_team = {
        name: replace(p, kind=kinds.get(name, p.kind)) for name, p in (team | node).items()}
    of_robots = {
        f'{owner}.{name}': replace(p, default=f'the global {name}') if name in team else p
        for owner in robots for name, p in robot.items()}
    return of_team | of_robots


def full_names(team: type, robot: type, robots: Sequence[str]) -> dict[str, Parameter]:
    """Return the parameters that classes declare for a team and for each robot."""
    return parameters_of(team) | {
        f'{owner}.{name}': p for owner in robots for name, p in parameters_of(robot).items()}


def flat_values(team: object, of_robots: Mapping[str, object]) -> dict[str, Value]:
    """Return settings of a team and of robots by name, without those that are not set."""
    flat = _flat(type(team), vars(team))
    for name, of_robot in of_robots.items():
        flat |= _flat(type(of_robot), vars(of_robot), f'{name}.')
    return flat


def as_parameters(settings: RunSettings) -> dict[str, Value]:
    """Return the settings as flat ROS parameters, without those that are not set."""
    names = [robot.name for robot in settings.estimation.robots]
    own = names[:1] if settings.node.peers else names
    return {**deciding(settings.estimation), 'robots': own} | _flat(
        NodeSettings, vars(settings.node))


def deciding(settings: Settings) -> dict[str, Value]:
    """Return the flat ROS parameters on which the result depends."""
    names = [robot.name for robot in settings.robots]
    flat = _flat(Settings, {**vars(settings), 'robots': names})
    for robot in settings.robots:
        # Standard deviations of an unknown start have no meaning.
        start_sigma = None if robot.start_pose is None else robot.start_sigma
        flat |= _flat(
            RobotSettings, {**vars(robot), 'start_sigma': start_sigma}, f'{robot.name}.')
    return flat


def _flat(declared: type, values: dict[str, object], prefix: str = '') -> dict[str, Value]:
    # An empty list has no type in ROS.
    return {
        f'{prefix}{name}': parameter.kind.write(values[name])
        for name, parameter in declared_parameters(declared).items()
        if values[name] is not None and values[name] != ()}
