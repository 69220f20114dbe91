# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of flat ROS parameters for settings of any kind; a mistake is a UsageError."""

from array import array
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
import logging
import math
import re
from typing import Any

import numpy as np

from fej_slam_ros.core.parameter_kinds import FLAG, Kind, MAX_NAME, Parameter, ROBOT_NAMES
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.schema import (
    full_names, known_parameters, QOS_OVERRIDES, QOS_POLICIES)

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
#: Least similarity (of ``difflib``, from 0 to 1) of a misspelled name and the one that is meant.
#: Names of parameters of other nodes, with which files are shared, are less like known ones:
#: ``range_sigma_growth`` of the adapter is 0.76 like ``range_sigma`` of the detector.
LEAST_SIMILARITY = 0.8
#: Minimum length of the beginning of a known name that stands for it: ``p`` or ``kd`` of another
#: node's controller do not.
MIN_BEGINNING = 3
#: Maximum length of a name or value in a message.
MAX_SHOWN = 500

#: Parameters that ROS adds to every node, besides those of the quality of service.
PARAMETERS_OF_ROS = frozenset({'use_sim_time', 'start_type_description_service'})
OF_EVERY_NODE = re.compile('|'.join([*PARAMETERS_OF_ROS, f'{re.escape(QOS_OVERRIDES)}.*']))

Warn = Callable[[str], object]
#: Writes each warning once per process to stderr.
warn_once: Warn = cache(logging.getLogger(__name__).warning)


def no_warning(text: str) -> None:
    """Discard a warning about parameters that were read before, with warnings."""


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
    robots: Sequence[str] = (), of_others: Collection[str] = (),
) -> dict[str, Any]:
    """
    Return flat ROS parameters of known names as settings store them.

    Unknown names are those of `_known_values`, but for parameters of other nodes that share the
    file; angles that exceed a turn are warnings.

    """
    own = {name: value for name, value in values.items() if name in known or name not in of_others}
    checked = checked_values(_known_values(own, known, warn, robots), known)
    _warn_of_degrees(checked, known, warn)
    return checked


def front_end_settings(
    values: Mapping[str, object], team: type[Any], of_robot: type[Any], warn: Warn
) -> Any:
    """Return the settings of a front end, of a class for the team and one for each robot."""
    robots = robot_names(values.get('robots', []))
    # The estimator may have more robots.
    owners = [*{name.rpartition('.')[0] for name in values} - {''}]
    of_others = known_parameters(owners).keys() - full_names(team, of_robot, owners).keys()
    checked = given_values(
        values, full_names(team, of_robot, robots), warn, robots, of_others)
    given = by_owner(checked, robots)
    return team(
        **given.pop(''), of_robots={robot: of_robot(**own) for robot, own in given.items()})


def by_owner(values: Mapping[str, Any], robots: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return flat parameters by name of the team, whose owner is '', and of each robot."""
    given: dict[str, dict[str, Any]] = {owner: {} for owner in ('', *robots)}
    for name, value in values.items():
        owner, _, field = name.rpartition('.')
        given[owner][field] = value
    return given


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


def robot_names(value: object, parameter: str = 'robots') -> tuple[str, ...]:
    """Return the checked names of the robots, which determine the names of other parameters."""
    robots: tuple[str, ...] = _checked_value(parameter, ROBOT_NAMES, value)
    if not robots:
        raise UsageError(
            f'parameter {parameter!r} is missing or empty: list the robots, for example [r1, r2];'
            ' of a parameter file, only the sections for this node and /** count')
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


def unknown_parameter(
    name: str, known: Mapping[str, Parameter], robots: Sequence[str] = (), effect: str = ''
) -> str:
    """Return the sentence about a parameter of an unknown name, with a known one if it is near."""
    name = shortened(name)
    owner, dot, _ = name.partition('.')
    remarks = [f'{owner!r} is not in robots'] if dot and robots and owner not in robots else []
    remarks += [f'did you mean {meant!r}?' for meant in _meant(name, known)[:1]]
    return f'unknown parameter {name!r}{effect}' + (f': {", ".join(remarks)}' if remarks else '')


def _meant(name: str, known: Iterable[str]) -> list[str]:
    """Return known names that a misspelled one may stand for, the nearest first."""
    # In ROS 1, a slash was where ROS 2 has a dot.
    owner, _, field = name.replace('/', '.').rpartition('.')
    # Names of robots are left out, since two names with the same long one are always alike.
    by_field = {other.rpartition('.')[2]: other for other in sorted(
        known, key=lambda other: other.rpartition('.')[0] == owner)}
    longer = sorted(
        (other for other in by_field if len(field) >= MIN_BEGINNING and other.startswith(field)),
        key=len)
    alike = get_close_matches(field, by_field, n=1, cutoff=LEAST_SIMILARITY)
    return [by_field[found] for found in (*longer, *alike)]


def shortened(text: str) -> str:
    """Return a text for a message, of which a long one keeps its beginning."""
    return text if len(text) <= MAX_SHOWN else f'{text[:MAX_SHOWN]}...'


def _known_values(
    values: Mapping[str, object], known: Mapping[str, Parameter], warn: Warn,
    robots: Sequence[str],
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
    """Raise UsageError if the names of robots are no list, or one cannot be a namespace."""
    if isinstance(value, str) and value.strip():
        names = ', '.join(value.replace(',', ' ').split())
        raise UsageError(
            f'parameter {parameter!r} must be a list, not {_shown(value)}: write'
            f' {shortened(f"[{names}]")}')
    for name in value if isinstance(value, (list, tuple)) else []:
        if isinstance(name, str) and not ROBOT_NAMES.allowed(name):
            if len(name) > MAX_NAME:
                raise UsageError(
                    f'parameter {parameter!r} contains {_shown(name)}, a name of {len(name):,}'
                    f' characters: give each robot a name of at most {MAX_NAME}')
            # ROS accepts no remapping rule for a name with two underscores in a row.
            valid = '_'.join(re.findall('[A-Za-z0-9]+', name))
            valid = valid if valid[:1].isalpha() else f'robot_{valid}'.rstrip('_')
            raise UsageError(
                f'parameter {parameter!r} contains {name!r}: a robot is a namespace of topics, and'
                ' ROS names begin with a letter and go on with letters, digits and _; list'
                f' {valid!r}, and remap the topics of the robot to it if they differ')


def _shown(value: object) -> str:
    try:
        return shortened(repr(value))
    except ValueError:  # Python writes no integers of thousands of digits.
        return 'an integer of thousands of digits'
