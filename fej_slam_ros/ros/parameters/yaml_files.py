# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
ROS parameter files.

A file means the same here as to ROS: of the sections that apply to a node, a later one wins.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
import json
from pathlib import Path
import re
from typing import TypeGuard, TypeVar

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.node_settings import RunSettings
from fej_slam_ros.ros.parameters.parsing import parse
from fej_slam_ros.ros.parameters.schema import as_parameters
from fej_slam_ros.ros.parameters.values import no_warning, Warn, warn_once, with_current_names
from fej_slam_ros.ros.parameters.yaml_bounds import (
    MAX_PARAMETER_FILE, read_bounded, YamlBoundsError)

#: Where parameters belong.
PLACE = 'put them under /**: and ros__parameters:'
#: Settings of a node.
T = TypeVar('T')


def load(path: Path, nodes: Sequence[str] = ('estimator',)) -> RunSettings:
    """Return the settings in a ROS parameter file for nodes without namespace."""
    return load_parsed(path, nodes, parse)


def load_parsed(
    path: Path, nodes: Sequence[str], parse_values: Callable[[Mapping[str, object], Warn], T]
) -> T:
    """Return settings parsed from a file; a UsageError and each warning begin with its path."""
    warn = warn_with_path(path)
    try:
        return parse_values(load_values(path, nodes, warn), warn)
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def warn_with_path(path: Path | None) -> Warn:
    """Return what writes a warning about a file."""
    return lambda text: warn_once(f'{path}: {text}')


def load_values(
    path: Path, nodes: Sequence[str], warn: Warn = warn_once, namespace: str = '/',
) -> dict[str, object]:
    """Return the flat parameters in a ROS parameter file for some nodes, values unchecked."""
    parameters = _parameters(path)
    names = [f'{namespace.rstrip("/")}/{node}' for node in nodes]
    if fault := _missing_section(parameters, names):
        raise UsageError(fault)
    values = {
        name: value for section, name, value in parameters
        if any(_applies(section, node) for node in names)}
    # Offline they have a meaning all the same, but a node would not start with this file.
    for name, value in values.items():
        if _is_mixed(value):
            warn(_mixed_list(name, value))
    return values


def load_current_values(path: Path, nodes: Sequence[str]) -> dict[str, object]:
    """Return the parameters of `load_values` by their current names, without warnings."""
    return with_current_names(load_values(path, nodes, no_warning), no_warning)


def fault_for(path: Path, node: str) -> str:
    """Return what is wrong with a file that ROS accepts for a node, by its full name, or ''."""
    try:
        fault = _missing_section(_parameters(path), [node])
    except UsageError as error:
        fault = str(error)
    return fault and f'{path}: {fault}'


def check_for_ros(path: Path) -> None:
    """Raise UsageError with the cure of the mistake for which ROS refuses a parameter file."""
    try:
        parameters = _parameters(path)
        if not parameters:
            raise UsageError(f'no parameters for a node: {PLACE}')
        for _, name, value in parameters:
            if value is None:
                raise UsageError(f'parameter {name!r} has no value: give it one, or leave it out')
            if _is_mixed(value):
                raise UsageError(_mixed_list(name, value))
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def dump(settings: RunSettings) -> str:
    """Return the settings as a ROS parameter file for any node."""
    values = as_parameters(settings)
    # A value of the team that is changed in the file must hold for the robots that have none.
    own = {
        name: value for name, value in values.items()
        if '.' not in name or value != values.get(name.partition('.')[2])}
    return dump_values(own)


def dump_values(values: Mapping[str, object]) -> str:
    """Return flat parameters as a ROS parameter file for any node."""
    # JSON is the part of YAML in which ROS and YAML 1.2 agree on types and floats show as floats.
    lines = [
        f'    {name}: {json.dumps(value, ensure_ascii=False)}\n' for name, value in values.items()]
    return '/**:\n  ros__parameters:\n' + ''.join(lines)


def _is_mixed(value: object) -> TypeGuard[list[float]]:
    return isinstance(value, list) and {type(v) for v in value} == {int, float}


def _mixed_list(name: str, value: Sequence[float]) -> str:
    return (
        f'parameter {name!r} mixes integers and floats, which ROS refuses: write'
        f' {[float(v) for v in value]}')


def _applies(section: str, node: str) -> bool:
    """Return whether a section, with the wildcards of ROS, applies to a node."""
    patterns = {'**': '(/[^/]+)*', '*': '/[^/]+'}
    tokens = section.split('/')[1:]
    return bool(re.fullmatch(
        ''.join(patterns.get(token, f'/{re.escape(token)}') for token in tokens), node))


def _missing_section(parameters: Sequence[tuple[str, str, object]], nodes: Sequence[str]) -> str:
    sections = dict.fromkeys(section for section, _, _ in parameters)
    if any(_applies(section, node) for section in sections for node in nodes):
        return ''
    only = f', only for {", ".join(sections)}' if sections else ''
    node = nodes[-1].removeprefix('/')
    return f'no parameters for the node {node!r}{only}: {PLACE}'


def _read_yaml(path: Path) -> object:
    try:
        return YAML(typ='safe', pure=True).load(read_bounded(path, MAX_PARAMETER_FILE))
    except (YamlBoundsError, RecursionError) as error:
        reason = error if isinstance(error, YamlBoundsError) else 'it has hundreds of levels'
        raise UsageError(f'{reason}: give the path of a ROS parameter file') from None
    except OSError as error:
        raise UsageError(f'{error.strerror}: give the path of a ROS parameter file') from error
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1
        # The values of a key that is given twice are those read so far: lists are still empty.
        problem = error.problem.partition(' with value ')[0]
        raise UsageError(f'correct line {line}, which is not YAML: {problem}') from error
    except (YAMLError, ValueError) as error:
        raise UsageError('not a YAML text: give the path of a ROS parameter file') from error


def _parameters(path: Path) -> list[tuple[str, str, object]]:
    """Return section, name and value of each parameter in a file; none is twice in a section."""
    parameters = [*_entries(_read_yaml(path))]
    names = Counter((section, name) for section, name, _ in parameters)
    for (_, name), count in names.items():
        if count > 1:
            raise UsageError(
                f'parameter {name!r} is given twice, with a dot and as a block: keep one of them')
    return parameters


def _entries(tree: object, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str, object]]:
    """Yield section, name and value of each parameter in a file."""
    if isinstance(tree, Mapping):
        for key, below in tree.items():
            yield from _entries(below, (*path, str(key)))
    elif 'ros__parameters' in path[:-1]:
        marker = path.index('ros__parameters')
        section, (_, *name) = path[:marker], path[marker:]
        yield '/' + '/'.join(section).lstrip('/'), '.'.join(name), tree
