# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Flat ROS parameters to settings; every mistake is a UsageError of one sentence."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
import logging
import math
import re
from typing import Any

import numpy as np

from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.parameter_kinds import (
    FLAG, Kind, MAX_NAME, Parameter, parameters_of, ROBOT_NAMES)
from fej_slam_ros.core.settings import NoiseSettings, RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.node_settings import NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.schema import known_parameters, QOS_OVERRIDES, QOS_POLICIES

#: Names of topics and reports besides those of robots.
RESERVED_NAMES = ('estimator', 'filter', 'ground_truth', 'landmarks', 'qos', 'smoother')

#: Old names of parameters that are still accepted, with a warning.
RENAMED_PARAMETERS = {'second_look': 'inflate_rejected_scans'}

#: Name of the parameter that makes an unknown name an error.
STRICT_PARAMETERS = 'strict_parameters'

#: Maximum number of robots. Each has some 20 topics, and 20 robots fill one processor core.
MAX_ROBOTS = 100
#: Maximum number of warnings about unknown names in one file.
MAX_WARNINGS = 20
#: Maximum length of a name or value in a message.
MAX_SHOWN = 500

#: Parameters that ROS adds to every node, besides those of the quality of service.
PARAMETERS_OF_ROS = frozenset({'use_sim_time', 'start_type_description_service'})
OF_EVERY_NODE = re.compile('|'.join([*PARAMETERS_OF_ROS, f'{re.escape(QOS_OVERRIDES)}.*']))

#: Values by name of the team, whose owner is '', and of each robot.
GivenValues = Mapping[str, Mapping[str, Any]]
Warn = Callable[[str], object]
#: Writes each warning once per process to stderr.
warn_once: Warn = cache(logging.getLogger(__name__).warning)


def parse(values: Mapping[str, object], warn: Warn = warn_once) -> RunSettings:
    """Return the settings that flat ROS parameters give."""
    values = with_current_names(values, warn)
    robots = _team(values)
    known = known_parameters(robots)
    given: dict[str, dict[str, Any]] = {owner: {} for owner in ('', *robots)}
    for name, value in given_values(values, known, warn, robots).items():
        owner, _, field = name.rpartition('.')
        given[owner][field] = value
    of_node = given[''].keys() & parameters_of(NodeSettings)
    node = NodeSettings(**{name: given[''].pop(name) for name in of_node})
    settings = RunSettings(_estimation_settings(robots, given, bool(node.peers)), node)
    _check_ids(settings.estimation.robots)
    _check_starts(settings.estimation.anchor, given)
    _check_frames(settings)
    check_files(settings)
    return settings


def _team(values: Mapping[str, object]) -> tuple[str, ...]:
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


def with_current_names(values: Mapping[str, object], warn: Warn) -> dict[str, object]:
    """Return parameters with old names replaced by the present ones."""
    current = dict(values)
    for old, new in RENAMED_PARAMETERS.items():
        if old in values:
            if new in values:
                raise UsageError(
                    f'parameter {old!r} is the old name of {new!r}: give only {new!r}')
            warn(f'parameter {old!r} is deprecated: rename it to {new!r}')
            current[new] = current.pop(old)
    return current


def given_values(
    values: Mapping[str, object], known: Mapping[str, Parameter], warn: Warn,
    robots: Sequence[str] = (),
) -> dict[str, Any]:
    """
    Return flat ROS parameters of known names as settings store them.

    Unknown names are those of `known_values`; angles that exceed a turn are warnings.

    """
    checked = checked_values(known_values(values, known, warn, robots), known)
    _warn_of_degrees(checked, known, warn)
    return checked


def known_values(
    values: Mapping[str, object], known: Mapping[str, Parameter], warn: Warn,
    robots: Sequence[str] = (),
) -> dict[str, object]:
    """
    Return flat ROS parameters without those of unknown names.

    Each of these is a warning, since files are shared with other nodes, or a UsageError if the
    parameter ``strict_parameters`` is true.

    """
    strict = _checked_value(STRICT_PARAMETERS, FLAG, values.get(STRICT_PARAMETERS, False))
    unknown = [name for name in values if name not in known and not OF_EVERY_NODE.fullmatch(name)]
    for name in unknown[:MAX_WARNINGS]:
        if strict:
            raise UsageError(unknown_parameter(name, known, robots))
        warn(unknown_parameter(name, known, robots, ' is ignored'))
    if len(unknown) > MAX_WARNINGS:
        warn(f'{len(unknown) - MAX_WARNINGS} more unknown parameters are ignored')
    ignored = {*unknown}
    return {name: value for name, value in values.items() if name not in ignored}


def checked_values(
    values: Mapping[str, object], known: Mapping[str, Parameter]
) -> dict[str, Any]:
    """Return flat ROS parameters as settings store them, without those of every node."""
    for name, value in values.items():
        policy = name.rpartition('.')[2]
        if name.startswith(QOS_OVERRIDES) and policy in QOS_POLICIES:
            _checked_value(name, QOS_POLICIES[policy], value)
    return {
        name: _checked_value(name, known[name].kind, value)
        for name, value in values.items() if name in known}


def _warn_of_degrees(
    values: Mapping[str, Any], known: Mapping[str, Parameter], warn: Warn
) -> None:
    """Warn of angles in checked values that exceed a turn: they are probably in degrees."""
    for name, value in values.items():
        count = known[name].kind.angles
        for angle in value[-count:] if count else ():
            if abs(angle) > math.tau:
                warn(
                    f'parameter {name!r} has an angle of {angle:g} rad, more than a turn: if it is'
                    f' in degrees, write {math.radians(angle):.4f}')


def unknown_parameter(
    name: str, known: Mapping[str, Parameter], robots: Sequence[str] = (), effect: str = ''
) -> str:
    """Return the sentence about a parameter of an unknown name, with the nearest known one."""
    name = shortened(name)
    nearest = get_close_matches(name, known, n=1, cutoff=0.0)[0]
    owner, dot, _ = name.partition('.')
    reason = f'{owner!r} is not in robots, ' if dot and robots and owner not in robots else ''
    return f'unknown parameter {name!r}{effect}: {reason}did you mean {nearest!r}?'


def robot_names(value: object, parameter: str = 'robots') -> tuple[str, ...]:
    """Return the checked names of the robots, which determine the names of other parameters."""
    robots: tuple[str, ...] = _checked_value(parameter, ROBOT_NAMES, value)
    if not robots:
        raise UsageError(
            f'parameter {parameter!r} is missing or empty: list the robots, for example [r1, r2]')
    if len(robots) > MAX_ROBOTS:
        raise UsageError(
            f'parameter {parameter!r} lists {len(robots)} robots: list at most {MAX_ROBOTS}')
    for robot in robots:
        if robots.count(robot) > 1:
            raise UsageError(
                f'parameter {parameter!r} contains {robot!r} twice: give each robot its own name')
        if robot in RESERVED_NAMES:
            raise UsageError(
                f'parameter {parameter!r} contains the reserved name {robot!r}: choose another')
    return robots


def changed_team(
    settings: Settings, robots: Mapping[str, RobotSettings], value: object
) -> list[RobotSettings]:
    """
    Return the robots for a new value of the parameter ``robots`` during a run.

    The present robots keep their settings; one that was not in the team at the start has the noise
    of the team in the settings at present.

    """
    known = {robot.name: robot for robot in settings.robots} | dict(robots)
    for name in robot_names(value):
        if name not in known:
            known[name] = RobotSettings(
                name, 1 + max(robot.id for robot in known.values()),
                **{field: getattr(settings, field) for field in parameters_of(NoiseSettings)})
    return [known[name] for name in robot_names(value)]


def changed_peers(
    settings: Settings, robots: Mapping[str, RobotSettings], value: object
) -> list[RobotSettings]:
    """
    Return the robots for new names of the own robot and its peers during a run.

    As at the start, the ID of a robot is its position in the sorted names, on which all robots
    agree; a UsageError says if a robot that comes would change that of another.

    """
    own, *others = robot_names(value)
    team = changed_team(settings, robots, _team({'robots': [own], 'peers': others or [own]}))
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
    used = {robot.id for robot in present}
    return [
        replace(robot, id=after[robot.name])
        if robot.name in new and after[robot.name] not in used else robot for robot in team]


def shortened(text: str) -> str:
    """Return a text for a message, of which a long one keeps its beginning."""
    return text if len(text) <= MAX_SHOWN else f'{text[:MAX_SHOWN]}...'


def _shown(value: object) -> str:
    try:
        return shortened(repr(value))
    except ValueError:  # Python writes no integers of thousands of digits.
        return 'an integer of thousands of digits'


def _checked_value(name: str, kind: Kind, value: object) -> Any:
    if isinstance(value, (array, np.ndarray)):
        value = value.tolist()
    read = kind.read(value)
    if read is None:
        if kind is ROBOT_NAMES:
            _refuse_names(name, value)
        raise UsageError(f'parameter {name!r} must be {kind.expected}, not {_shown(value)}')
    return read


def _refuse_names(parameter: str, value: object) -> None:
    """Raise UsageError if one of the names of robots cannot be the namespace of topics."""
    for name in value if isinstance(value, (list, tuple)) else []:
        if isinstance(name, str) and not ROBOT_NAMES.allowed(name):
            if len(name) > MAX_NAME:
                raise UsageError(
                    f'parameter {parameter!r} contains {_shown(name)}, a name of {len(name):,}'
                    f' characters: give each robot a name of at most {MAX_NAME}')
            valid = re.sub(r'\W', '_', name, flags=re.ASCII)
            valid = valid if valid[:1].isalpha() else f'robot_{valid}'.rstrip('_')
            raise UsageError(
                f'parameter {parameter!r} contains {name!r}: a robot is a namespace of topics, and'
                ' ROS names begin with a letter and go on with letters, digits and _; list'
                f' {valid!r}, and remap the topics of the robot to it if they differ')


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
