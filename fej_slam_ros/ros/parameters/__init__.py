# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings <-> YAML <-> ROS parameters, checked once, for node and replay alike.

Names, checks and descriptions follow from the tables ``TEAM`` and ``ROBOT``, the defaults from the
settings themselves. A parameter file means here what it means to ROS: of the sections that are for
a node, a later one wins.
"""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import permutations
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from fej_slam_ros.core.data_association.failure_detection import MOVED_LANDMARKS
from fej_slam_ros.core.estimator import LINEARIZATIONS
from fej_slam_ros.core.joining.initialization import START_COVARIANCES
from fej_slam_ros.core.ordering.time_jump import ON_TIME_JUMP
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.kinds import (
    AT_LEAST_TWO, FLAG, IDENTITY, ITERATIONS, Kind, NAMES, NOISE_SCALE, NOT_NEGATIVE, numbers,
    one_of, PERIOD, POINT_SIGMA, POSE, POSE_SIGMA, PROBABILITY, Range, TEXT, TEXTS)

Value = bool | int | float | str | list[float] | list[str]

#: Names of topics and reports besides those of robots.
TAKEN = ('estimator', 'filter', 'ground_truth', 'landmarks', 'qos', 'smoother')

#: What ROS adds to the parameters of every node.
QOS_OVERRIDES = 'qos_overrides.'
OF_EVERY_NODE = re.compile(
    f'use_sim_time|start_type_description_service|{re.escape(QOS_OVERRIDES)}.*')

#: What the policies in names such as ``qos_overrides./r1/odom.subscription.depth`` may be.
QOS_POLICIES = {
    'reliability': one_of(['reliable', 'best_effort', 'best_available', 'system_default']),
    'durability': one_of(['volatile', 'transient_local', 'best_available', 'system_default']),
    'history': one_of(['keep_last', 'keep_all', 'system_default']),
    'depth': numbers('an integer', Range(0, 2**31 - 1), element=int),
}


@dataclass(frozen=True)
class Parameter:
    """
    One line of the tables.

    Attributes
    ----------
    name : that of the field of the settings
    kind : what its value must be
    meaning, unit : for the user
    default : for the user, where it is not the constant in the settings
    decides : whether the result depends on it

    """

    name: str
    kind: Kind
    meaning: str
    unit: str = ''
    default: str = ''
    decides: bool = True


TEAM = (
    Parameter('robots', NAMES, 'names, in the order of processing', default='none, give them'),
    Parameter(
        'anchor', TEXT, 'robot whose start is the origin, empty where prior_landmarks have one',
        default='first of robots'),
    Parameter('anchor_pose', POSE, 'start of the anchor in map', 'm, m, rad'),
    Parameter('anchor_sigma', POSE_SIGMA, 'standard deviations of anchor_pose', 'm, m, rad'),
    Parameter(
        'filter',
        one_of(LINEARIZATIONS),
        f'one of {", ".join(LINEARIZATIONS)}; ideal needs ground truth',
    ),
    Parameter(
        'update_iterations', ITERATIONS, 'Gauss-Newton iterations of each update',
        default='0, that is 3 for invariant and 1 for the others'),
    Parameter(
        'compressed', FLAG,
        'steps in a large map touch only the region where robots are, exactly; not for invariant'),
    Parameter(
        'start_covariance',
        one_of(START_COVARIANCES),
        'anchored: what starts at step 0 moves with an uncertain anchor; independent: it does not',
    ),
    Parameter('gate_probability', PROBABILITY, 'chi-square gate on observations, 1.0 is no gate'),
    Parameter(
        'match_probability', PROBABILITY,
        'with which right matches of observations without identity (-1) pass their chi-square test'),
    Parameter(
        'inflate_rejected_scans', FLAG, 'scans of which most fails the gate are used with more noise'),
    Parameter(
        'moved_landmarks',
        one_of(MOVED_LANDMARKS),
        'what is done about landmarks that keep failing the gate: report, forget or ignore them',
    ),
    Parameter('max_delay', NOT_NEGATIVE, 'lateness up to which data are put in order', 's'),
    Parameter('stale_after', NOT_NEGATIVE, 'lag behind another robot that is waited for', 's'),
    Parameter('future_limit', NOT_NEGATIVE, 'how far a stamp may lie ahead of reception', 's'),
    Parameter(
        'clock_limit', NOT_NEGATIVE,
        'difference of stamps and the clock of reception that is no warning', 's', decides=False),
    Parameter(
        'on_time_jump', one_of(ON_TIME_JUMP),
        'when time jumps back: refuse what comes then, or reset, which begins a new run',
        decides=False),
    Parameter(
        'join_min_landmarks', AT_LEAST_TWO,
        'shared landmarks and places where robots were seen that a robot needs to join others'),
    Parameter(
        'join_probability', PROBABILITY,
        'chi-square test of what is shared when robots join; a smoother takes 0.9999 at least,'
        ' and 1.0 for no test'),
    Parameter(
        'join_heading_sigma', NOT_NEGATIVE,
        'what is shared must tell the heading to this, with which robots join', 'rad'),
    Parameter('shared_landmark_ids', FLAG, 'one number is one landmark for all robots'),
    # Not its name decides but what is in it.
    Parameter(
        'prior_landmarks', TEXT,
        'file of surveyed landmarks, or landmarks.csv of an earlier run, that are in map from the'
        ' beginning, empty for none', decides=False),
    Parameter(
        'relative_poses', TEXTS, 'pairs seer:seen of robots whose relative pose is published',
        default='none', decides=False),
    Parameter(
        'unused_variance', NOT_NEGATIVE, 'published for z, roll, pitch', 'm^2, rad^2',
        decides=False),
    Parameter(
        'map_period', PERIOD, 'how often paths, maps and markers are published', 's',
        decides=False),
    Parameter(
        'publish_tf', FLAG, 'transforms to the frames of odometry go to /tf', decides=False),
    Parameter(
        'output', TEXT, 'folder for the files of a live run, empty for no files', decides=False),
    Parameter(
        'checkpoint', TEXT, 'file that a live run is saved to, empty for none', decides=False),
    Parameter(
        'autosave_period', NOT_NEGATIVE, 'how often a live run is saved, 0 is on request only',
        's', decides=False),
    Parameter(
        'restore', TEXT, 'checkpoint that the run goes on from, empty for a new run; where it is'
        " that of 'checkpoint' and not there yet, the run begins anew", decides=False),
    Parameter(
        'autostart', FLAG, 'the node configures and activates itself when it is started',
        decides=False),
    Parameter(
        'odometry_sigma',
        POSE_SIGMA,
        'standard deviations of odometry without covariance',
        'm, m, rad per sqrt(s)',
    ),
    Parameter(
        'landmark_sigma',
        POINT_SIGMA,
        'standard deviations of observations without covariance',
        'm',
    ),
    Parameter(
        'odometry_noise_scale', NOISE_SCALE,
        'factor on standard deviations of odometry, claimed or from odometry_sigma'),
    Parameter(
        'landmark_noise_scale', NOISE_SCALE,
        'factor on standard deviations of landmark observations, claimed or from landmark_sigma'),
    Parameter(
        'robot_noise_scale', NOISE_SCALE,
        'factor on standard deviations of observations of robots, claimed or from landmark_sigma'),
)
#: What a robot has from the team where it has none of its own.
INHERITED = (
    'odometry_sigma', 'landmark_sigma', 'odometry_noise_scale', 'landmark_noise_scale',
    'robot_noise_scale')

ROBOT = (
    Parameter('id', IDENTITY, 'number in clouds of robots', default='place in robots, from 1'),
    Parameter('start_pose', POSE, 'known start in map', 'm, m, rad', 'unknown'),
    Parameter('start_sigma', POSE_SIGMA, 'standard deviations of start_pose', 'm, m, rad'),
    Parameter('sensor_pose', POSE, 'pose of the landmark sensor in the base frame', 'm, m, rad'),
    Parameter('sensor_frame', TEXT, 'a further frame that scans may name', default='none'),
    *(
        replace(parameter, default=f'the global {parameter.name}')
        for parameter in TEAM
        if parameter.name in INHERITED
    ),
)


def describe(robots: Sequence[str] = ('<robot>',)) -> dict[str, str]:
    """Return one line of meaning, unit and default for each parameter of a team."""
    return {
        name: description(parameter, RobotSettings if '.' in name else Settings)
        for name, parameter in _parameters(robots).items()
    }


def kinds(robots: Sequence[str]) -> dict[str, Kind]:
    """Return what the value of each parameter of a team must be."""
    return {name: parameter.kind for name, parameter in _parameters(robots).items()}


def parse(values: Mapping[str, object]) -> Settings:
    """
    Return the settings that flat ROS parameters mean.

    Parameters
    ----------
    values
        By name, those of a robot as ``<robot>.<name>``; lists also as ROS delivers them.

    Raises
    ------
    UsageError
        A name is unknown, or a value is missing, of a wrong type or impossible.

    """
    robots = robot_names(values.get('robots', []))
    given: dict[str, dict[str, Any]] = {owner: {} for owner in ('', *robots)}
    for name, value in checked(values, _parameters(robots), robots).items():
        owner, _, field = name.rpartition('.')
        given[owner][field] = value
    settings = _assemble(robots, given)
    _check_ids(settings.robots)
    _check_starts(settings.anchor, given)
    _check_autosave(settings)
    _check_prior(settings)
    return settings


def checked(
    values: Mapping[str, object], known: Mapping[str, Parameter], robots: Sequence[str] = ()
) -> dict[str, Any]:
    """
    Return flat ROS parameters as settings hold them, without those that every node has.

    Raises
    ------
    UsageError
        A name is not one of the known parameters or a value not of its kind.

    """
    for name, value in values.items():
        if name not in known and not OF_EVERY_NODE.fullmatch(name):
            raise _unknown(name, known, robots)
        policy = name.rpartition('.')[2]
        if name.startswith(QOS_OVERRIDES) and policy in QOS_POLICIES:
            _checked(name, QOS_POLICIES[policy], value)
    return {
        name: _checked(name, known[name].kind, value)
        for name, value in values.items() if name in known}


def as_parameters(settings: Settings) -> dict[str, Value]:
    """Return the flat ROS parameters that mean the settings; what is not set is left out."""
    names = [robot.name for robot in settings.robots]
    # ROS cannot tell of what type an empty list is.
    pairs = settings.relative_poses or None
    values = {'': {**vars(settings), 'robots': names, 'relative_poses': pairs}}
    for robot in settings.robots:
        # Standard deviations of an unknown start mean nothing.
        start_sigma = None if robot.start_pose is None else robot.start_sigma
        values[robot.name] = {**vars(robot), 'start_sigma': start_sigma}
    flat = {}
    for name, parameter in _parameters(names).items():
        owner, _, field = name.rpartition('.')
        if values[owner][field] is not None:
            flat[name] = parameter.kind.write(values[owner][field])
    return flat


def deciding(settings: Settings) -> dict[str, Value]:
    """Return the flat ROS parameters on which the result depends."""
    known = _parameters([robot.name for robot in settings.robots])
    return {name: x for name, x in as_parameters(settings).items() if known[name].decides}


def load(path: Path, nodes: Sequence[str] = ('estimator',)) -> Settings:
    """
    Return the settings that a ROS parameter file holds for nodes without namespace.

    Raises
    ------
    UsageError
        The file is not such a file, or `parse` refuses what it holds.

    """
    try:
        return parse(load_values(path, nodes))
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def load_values(path: Path, nodes: Sequence[str]) -> dict[str, object]:
    """Return the flat parameters that a ROS parameter file holds for some nodes, unchecked."""
    sections = {'/**', '/*', *(f'{root}/{node}' for node in nodes for root in ('/**', ''))}
    values = {
        name: value for section, name, value in _entries(_read_yaml(path)) if section in sections}
    if not values:
        raise UsageError(
            f'no parameters for the node {nodes[-1]!r}: put them under /**: and ros__parameters:')
    return values


def dump(settings: Settings) -> str:
    """Return the settings as a ROS parameter file for any node."""
    return dump_values(as_parameters(settings))


def dump_values(values: Mapping[str, object]) -> str:
    """Return flat parameters as a ROS parameter file for any node."""
    # JSON is the part of YAML in which ROS and YAML 1.2 agree on types and floats show as floats.
    lines = [f'    {name}: {_json(value)}\n' for name, value in values.items()]
    return '/**:\n  ros__parameters:\n' + ''.join(lines)


def _parameters(robots: Sequence[str]) -> dict[str, Parameter]:
    """Return the parameters of a team by their full names; the anchor is one of the team."""
    parameters = {p.name: p for p in TEAM}
    pairs = {f'{a}:{b}' for a, b in permutations(robots, 2)}
    parameters['anchor'] = replace(parameters['anchor'], kind=one_of([*robots, '']))
    parameters['relative_poses'] = replace(parameters['relative_poses'], kind=Kind(
        "a list of pairs such as 'r1:r2' of two robots", str, (None,), pairs.__contains__))
    return parameters | {f'{robot}.{p.name}': p for robot in robots for p in ROBOT}


def description(parameter: Parameter, defaults: type = Settings) -> str:
    """Return one line of meaning, unit and default."""
    unit = f' [{parameter.unit}]' if parameter.unit else ''
    return f'{parameter.meaning}{unit}; default: {default_of(parameter, defaults)}'


def default_of(parameter: Parameter, defaults: type = Settings) -> str:
    """Return the default in words, else the constant in settings."""
    return parameter.default or _json(getattr(defaults, parameter.name))


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def robot_names(value: object) -> tuple[str, ...]:
    """Return the names of the robots, which decide what other parameters there are."""
    robots: tuple[str, ...] = _checked('robots', NAMES, value)
    if not robots:
        raise UsageError(
            "parameter 'robots' is missing or empty: list the robots, for example [r1, r2]"
        )
    for robot in robots:
        if robots.count(robot) > 1:
            raise UsageError(f"parameter 'robots' names {robot!r} twice: a name is one robot")
        if robot in TAKEN:
            raise UsageError(f"parameter 'robots' names {robot!r}, which is taken: choose another")
    return robots


def changed_team(
    settings: Settings, robots: Mapping[str, RobotSettings], value: object
) -> list[RobotSettings]:
    """
    Return the robots that a new value of the parameter ``robots`` means in mid-run.

    One that was not named at the beginning has the settings of the team.

    Parameters
    ----------
    settings : what the run began with
    robots : those that are here now
    value : the names

    Raises
    ------
    UsageError
        That is no list of names of robots.

    """
    known = {robot.name: robot for robot in settings.robots} | dict(robots)
    for name in robot_names(value):
        if name not in known:
            known[name] = RobotSettings(
                name, id=1 + max(robot.id for robot in known.values()),
                **{field: getattr(settings, field) for field in INHERITED})
    return [known[name] for name in robot_names(value)]


def _checked(name: str, kind: Kind, value: object) -> Any:
    if isinstance(value, (array, np.ndarray)):
        value = value.tolist()
    read = kind.read(value)
    if read is None:
        raise UsageError(f'parameter {name!r} must be {kind.expected}, not {value!r}')
    return read


def _unknown(name: str, known: Mapping[str, Parameter], robots: Sequence[str]) -> UsageError:
    nearest = get_close_matches(name, known, n=1, cutoff=0.0)[0]
    owner, dot, _ = name.partition('.')
    stranger = f'{owner!r} is not in robots, ' if dot and owner not in robots else ''
    return UsageError(f'unknown parameter {name!r}: {stranger}did you mean {nearest!r}?')


def _assemble(robots: Sequence[str], given: Mapping[str, Mapping[str, Any]]) -> Settings:
    """Put the settings together; a robot inherits what the team has under the same name."""
    team = {'anchor': robots[0], **given['']}
    inherited = {p.name: team[p.name] for p in ROBOT if p.name in team}
    team['robots'] = tuple(
        RobotSettings(**{'name': name, 'id': place, **inherited, **given[name]})
        for place, name in enumerate(robots, start=1)
    )
    return Settings(**team)


def _check_ids(robots: Sequence[RobotSettings]) -> None:
    names: dict[int, str] = {}
    for robot in robots:
        if robot.id in names:
            raise UsageError(
                f"parameters '{names[robot.id]}.id' and '{robot.name}.id' are both {robot.id}: "
                'give each robot its own'
            )
        names[robot.id] = robot.name


def _check_starts(anchor: str, given: Mapping[str, Mapping[str, Any]]) -> None:
    for name in ('start_pose', 'start_sigma'):
        if name in given[anchor]:
            raise UsageError(
                f"parameter '{anchor}.{name}' is for robots other than the anchor: "
                f"give '{name.replace('start', 'anchor')}' instead"
            )
    for owner, fields in given.items():
        if 'start_sigma' in fields and 'start_pose' not in fields:
            raise UsageError(
                f"parameter '{owner}.start_sigma' needs a start: give '{owner}.start_pose' too"
            )


def _check_autosave(settings: Settings) -> None:
    if settings.autosave_period > 0.0 and not settings.checkpoint:
        raise UsageError(
            "parameter 'autosave_period' needs a file: give 'checkpoint' too"
        )


def _check_prior(settings: Settings) -> None:
    if settings.prior_landmarks and not settings.shared_landmark_ids:
        raise UsageError(
            "parameter 'prior_landmarks' needs numbers that all robots share: leave out"
            " 'shared_landmark_ids'")
    if settings.prior_landmarks and settings.prior_landmarks == settings.checkpoint:
        raise UsageError(
            "parameters 'prior_landmarks' and 'checkpoint' are one file: save to another one")
    if not settings.anchor and not settings.prior_landmarks:
        raise UsageError(
            "parameter 'anchor' is empty, so nothing has a place in map: name a robot, or give"
            " 'prior_landmarks'")


def _read_yaml(path: Path) -> object:
    try:
        return YAML(typ='safe', pure=True).load(path)
    except OSError as error:
        raise UsageError(f'{error.strerror}: give the path of a ROS parameter file') from error
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1
        raise UsageError(f'correct line {line}, which is not YAML: {error.problem}') from error
    except (YAMLError, ValueError) as error:
        raise UsageError('not a YAML text: give the path of a ROS parameter file') from error


def _entries(tree: object, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str, object]]:
    """Yield section, name and value of each parameter in a file."""
    if isinstance(tree, Mapping):
        for key, below in tree.items():
            yield from _entries(below, (*path, str(key)))
    elif 'ros__parameters' in path[:-1]:
        marker = path.index('ros__parameters')
        section, (_, *name) = path[:marker], path[marker:]
        yield '/' + '/'.join(section).lstrip('/'), '.'.join(name), tree
