# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Flat ROS parameters to the settings of a run; contradictions are a UsageError."""

from collections.abc import Mapping, Sequence
from typing import Any

from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.parameter_kinds import parameters_of
from fej_slam_ros.core.settings import NoiseSettings, RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.node_settings import NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.schema import known_parameters
from fej_slam_ros.ros.parameters.values import (
    by_owner, checked_values, given_values, robot_names, Warn, warn_once, with_current_names)

#: Values by name of the team, whose owner is '', and of each robot.
GivenValues = Mapping[str, Mapping[str, Any]]


def parse(values: Mapping[str, object], warn: Warn = warn_once) -> RunSettings:
    """Return the settings that flat ROS parameters give."""
    values = with_current_names(values, warn)
    robots = team_names(values)
    known = known_parameters(robots)
    given, of_node = _divided_by_owner(given_values(values, known, warn, robots), robots)
    node = NodeSettings(**of_node)
    settings = RunSettings(_estimation_settings(robots, given, bool(node.peers)), node)
    _check_ids(settings.estimation.robots)
    _check_starts(settings.estimation.anchor, given)
    _check_frames(settings)
    check_files(settings)
    return settings


def estimation_of(values: Mapping[str, object]) -> Settings:
    """Return the settings of which `deciding` has returned the values."""
    robots = robot_names(values['robots'])
    if values['initialpose_robot'] not in robots:
        # A parameter of the estimator alone, for a team that a smoother has had since.
        values = {**values, 'initialpose_robot': ''}
    given, _ = _divided_by_owner(checked_values(values, known_parameters(robots)), robots)
    return _estimation_settings(robots, given, has_peers=False)


def team_names(values: Mapping[str, object]) -> tuple[str, ...]:
    """Return the names of all robots, the own ones first."""
    robots, peers = robot_names(values.get('robots', [])), values.get('peers', [])
    if not peers:
        return robots
    if len(robots) > 1:
        raise UsageError(
            f"parameter 'robots' lists {len(robots)} robots beside 'peers': each robot runs a"
            ' smoother of its own, list this one only')
    others = tuple(name for name in robot_names(peers, 'peers') if name != robots[0])
    if not others:
        raise UsageError("parameter 'peers' has only this robot: list the others")
    return robots + others


def _divided_by_owner(
    values: Mapping[str, Any], robots: Sequence[str]
) -> tuple[GivenValues, dict[str, Any]]:
    """Return the values of estimation by name of the team and of each robot, and of the node."""
    given = by_owner(values, robots)
    names = given[''].keys() & parameters_of(NodeSettings)
    return given, {name: given[''].pop(name) for name in names}


def _estimation_settings(
    robots: Sequence[str], given: GivenValues, has_peers: bool
) -> Settings:
    """Return the settings; noise that is not given for a robot is that of the team."""
    team = {'anchor': robots[0], **given['']}
    noise = {name: team[name] for name in parameters_of(NoiseSettings) if name in team}
    # Robots with peers list themselves first, and must agree on the IDs all the same.
    of_ids = sorted(robots) if has_peers else robots
    team['robots'] = tuple(
        RobotSettings(**{'name': name, 'id': 1 + of_ids.index(name), **noise, **given[name]})
        for name in robots)
    return Settings(**team)


def _check_ids(robots: Sequence[RobotSettings]) -> None:
    names: dict[int, str] = {}
    for robot in robots:
        if robot.id in names:
            raise UsageError(
                f"parameters '{names[robot.id]}.id' and '{robot.name}.id' are both {robot.id}: "
                'give each robot its own')
        names[robot.id] = robot.name


def _check_starts(anchor: str, given: GivenValues) -> None:
    for name in ('start_pose', 'start_sigma'):
        if name in given[anchor]:
            raise UsageError(
                f"parameter '{anchor}.{name}' is for robots other than the anchor: "
                f"give '{name.replace('start', 'anchor')}' instead")
    for owner, fields in given.items():
        if 'start_sigma' in fields and 'start_pose' not in fields:
            raise UsageError(
                f"parameter '{owner}.start_sigma' needs a start: give '{owner}.start_pose' too")


def _check_frames(settings: RunSettings) -> None:
    """Refuse names of frames that cannot form a tree of transforms."""
    map_frame = settings.node.map_frame
    names: dict[str, str] = {}
    for robot in settings.estimation.robots:
        name, own = f'{robot.name}.odom_frame', own_frame(robot.name)
        if map_frame == own:
            raise UsageError(
                f"parameter 'map_frame' is {own!r}, the frame of {robot.name} until it has joined:"
                ' choose another name')
        if robot.odom_frame is None:
            continue
        if robot.odom_frame in {map_frame, own, robot.base_frame}:
            raise UsageError(
                f'parameter {name!r} is {robot.odom_frame!r}, the name of a map or base frame:'
                ' choose another name')
        if robot.odom_frame in names and settings.node.shares_tf():
            raise UsageError(
                f'parameters {names[robot.odom_frame]!r} and {name!r} are both'
                f' {robot.odom_frame!r}, which is ambiguous on /tf: give each robot its own, or'
                " set tf_topics to 'robot'")
        names[robot.odom_frame] = name


def check_peer_files(node: NodeSettings) -> None:
    """Refuse the checkpoints of other nodes to a smoother with peers."""
    for name in ('checkpoint', 'restore', 'autosave_period'):
        if getattr(node, name):
            raise UsageError(
                f"parameter {name!r} is not for a smoother with 'peers', which continues from"
                " the measurements in a file: give 'exchange_file' instead")


def check_files(settings: RunSettings) -> None:
    """Refuse parameters of files that contradict each other."""
    node = settings.node
    if node.exchange_file and not node.peers:
        raise UsageError(
            "parameter 'exchange_file' is of a smoother that exchanges measurements: give 'peers'"
            ' too')
    if node.exchange_file and node.on_time_jump == 'reset':
        raise UsageError(
            "parameter 'exchange_file' keeps all measurements, which 'on_time_jump: reset' would"
            ' forget: give only one of them')
    if node.autosave_period > 0.0 and not (node.checkpoint or node.peers):
        raise UsageError("parameter 'autosave_period' needs a file: give 'checkpoint' too")
    if node.prior_landmarks and not settings.estimation.shared_landmark_ids:
        raise UsageError(
            "parameter 'prior_landmarks' needs IDs that all robots share: leave out"
            " 'shared_landmark_ids'")
    if node.prior_landmarks and node.prior_landmarks == node.checkpoint:
        raise UsageError(
            "parameters 'prior_landmarks' and 'checkpoint' are one file: save to another one")
    if not settings.estimation.anchor and not node.prior_landmarks:
        raise UsageError(
            "parameter 'anchor' is empty, so that the frame map is undefined: name a robot, or"
            " give 'prior_landmarks'")
