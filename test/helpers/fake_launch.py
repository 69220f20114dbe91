# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
As much of launch and launch_ros, which PyPI lacks, as our launch files use: what they would start.

Signatures, the order of evaluation, and what becomes of parameters are those of ROS 2 Jazzy.
"""

from dataclasses import dataclass, field
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
import json
from pathlib import Path
import sys
from types import ModuleType
from typing import Any

from ruamel.yaml import YAML


@dataclass
class LaunchContext:
    """Values of the arguments, and the commands that are started, in their order."""

    folder: Path
    launch_configurations: dict[str, str]
    commands: list[list[str]] = field(default_factory=list)
    descriptions: dict[str, str] = field(default_factory=dict)


@dataclass
class LaunchConfiguration:
    variable_name: str

    def perform(self, context):
        return context.launch_configurations[self.variable_name]


@dataclass(kw_only=True)
class ExecutableInPackage:
    executable: str
    package: str

    def perform(self, _context):
        return f'{self.package}/{self.executable}'


def performed(value, context):
    return value if isinstance(value, str) else value.perform(context)


@dataclass
class IfCondition:
    predicate_expression: Any

    def evaluate(self, context):
        told = performed(self.predicate_expression, context).lower()
        assert told in {'true', 'false', '1', '0'}
        return told in {'true', '1'}


@dataclass
class LaunchDescription:
    entities: list[Any]

    def execute(self, context):
        for entity in self.entities:
            entity.execute(context)


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str | None = field(default=None, kw_only=True)
    description: str = field(default='no description given', kw_only=True)

    def execute(self, context):
        context.descriptions[self.name] = self.description
        if self.name not in context.launch_configurations:
            assert self.default_value is not None, f'{self.name} was not provided'
            context.launch_configurations[self.name] = self.default_value


@dataclass(kw_only=True)
class OpaqueFunction:
    function: Any

    def execute(self, context):
        LaunchDescription(self.function(context)).execute(context)


@dataclass(kw_only=True)
class ExecuteProcess:
    cmd: list[Any]
    output: str = 'log'

    def execute(self, context):
        context.commands.append([performed(word, context) for word in self.cmd])


@dataclass(kw_only=True)
class Node:
    package: str
    executable: str
    name: str | None = None
    namespace: Any = None
    parameters: list[Any] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    output: str = 'log'
    condition: IfCondition | None = None

    def execute(self, context):
        if self.condition is not None and not self.condition.evaluate(context):
            return
        command = [
            f'{self.package}/{self.executable}',
            *(performed(word, context) for word in self.arguments), '--ros-args']
        if self.name is not None:
            command += ['-r', f'__node:={self.name}']
        namespace = self.namespace and performed(self.namespace, context)
        if namespace:
            command += ['-r', f'__ns:=/{namespace}']
        for given in self.parameters:
            command += ['--params-file', self._file(given, context)]
        context.commands.append(command)

    def _file(self, given, context):
        if not isinstance(given, dict):
            return performed(given, context)
        values = {name: self._value(value, context) for name, value in given.items()}
        path = context.folder / f'launch_params_{len([*context.folder.iterdir()])}'
        path.write_text(json.dumps({'/**': {'ros__parameters': values}}))
        return str(path)

    def _value(self, value, context):
        if isinstance(value, list):
            return [self._value(element, context) for element in value]
        if isinstance(value, (LaunchConfiguration, str)):
            return YAML(typ='safe').load(performed(value, context))
        return value


class LifecycleNode(Node):
    pass


@dataclass
class PythonLaunchDescriptionSource:
    location: str


@dataclass
class IncludeLaunchDescription:
    launch_description_source: PythonLaunchDescriptionSource
    launch_arguments: Any = field(default=(), kw_only=True)

    def execute(self, context):
        for name, value in self.launch_arguments:
            context.launch_configurations[name] = performed(value, context)
        load(Path(self.launch_description_source.location)).execute(context)


MODULES = {
    'launch': (LaunchContext, LaunchDescription),
    'launch.actions': (
        DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, OpaqueFunction),
    'launch.conditions': (IfCondition,),
    'launch.launch_description_sources': (PythonLaunchDescriptionSource,),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.actions': (LifecycleNode, Node),
    'launch_ros.substitutions': (ExecutableInPackage,),
}


def install(patch):
    """Have launch files import this instead."""
    for name, classes in MODULES.items():
        module = ModuleType(name)
        vars(module).update({made.__name__: made for made in classes})
        patch.setitem(sys.modules, name, module)


def load(path):
    """Return the description in a launch file."""
    loader = SourceFileLoader(path.name.replace('.', '_'), str(path))
    module = module_from_spec(spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module.generate_launch_description()


def launch(path, folder, **arguments):
    """Return the context in which a launch file has been executed."""
    context = LaunchContext(folder, dict(arguments))
    load(path).execute(context)
    return context
