# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
As much of launch and launch_ros, which PyPI lacks, as our launch files use.

Signatures, the order of evaluation, namespaces, what becomes of parameters, and what happens when
a process ends are those of ROS 2 Jazzy. An exception during the execution of a description leaves
running what was started before it, as in https://github.com/ros2/launch/issues/747.
"""

from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
import json
from pathlib import Path
import re
import signal
import sys
from time import monotonic
from types import ModuleType
from typing import Any

from ament_index_python.packages import get_package_share_path
from ruamel.yaml import YAML


@dataclass
class LaunchContext:
    """Values of the arguments, and the processes that are to be started, in their order."""

    folder: Path
    launch_configurations: dict[str, str]
    processes: list[Any] = field(default_factory=list)
    descriptions: dict[str, str] = field(default_factory=dict)
    log: list[str] = field(default_factory=list)

    @property
    def commands(self):
        return [process.command for process in self.processes]


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


@dataclass
class InText:
    """A text of a YAML launch file, with substitutions."""

    text: str

    def perform(self, context):
        text = re.sub(
            r'\$\(find-pkg-share (\w+)\)', lambda found: str(get_package_share_path(found[1])),
            self.text)
        return re.sub(
            r'\$\(var (\w+)\)', lambda found: context.launch_configurations[found[1]], text)


def performed(value, context):
    return value if isinstance(value, str) else value.perform(context)


@dataclass
class IfCondition:
    predicate_expression: Any

    def evaluate(self, context):
        value = performed(self.predicate_expression, context).lower()
        if value not in {'true', 'false', '1', '0'}:
            raise ValueError(f'invalid condition expression {value}')
        return value in {'true', '1'}


class LaunchDescriptionEntity:
    pass


@dataclass
class LaunchDescription(LaunchDescriptionEntity):
    entities: list[Any]

    def execute(self, context):
        for entity in self.entities:
            entity.execute(context)


@dataclass
class GroupAction(LaunchDescription):
    """Arguments and namespace go into the group, but not out of it."""

    def execute(self, context):
        outside = dict(context.launch_configurations)
        super().execute(context)
        context.launch_configurations = outside


@dataclass
class DeclareLaunchArgument(LaunchDescriptionEntity):
    name: str
    default_value: Any = field(default=None, kw_only=True)
    description: str = field(default='no description given', kw_only=True)
    choices: list[str] | None = field(default=None, kw_only=True)

    def execute(self, context):
        context.descriptions[self.name] = self.description
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise RuntimeError(f'{self.name} was not provided')
            context.launch_configurations[self.name] = performed(self.default_value, context)
        value = context.launch_configurations[self.name]
        if self.choices is not None and value not in self.choices:
            raise RuntimeError(f'argument {self.name}: {value} is not in {self.choices}')


@dataclass
class SetLaunchConfiguration(LaunchDescriptionEntity):
    name: str
    value: Any

    def execute(self, context):
        context.launch_configurations[self.name] = performed(self.value, context)


@dataclass(kw_only=True)
class OpaqueFunction(LaunchDescriptionEntity):
    function: Any

    def execute(self, context):
        LaunchDescription(self.function(context)).execute(context)


@dataclass(kw_only=True)
class LogInfo(LaunchDescriptionEntity):
    msg: str

    def execute(self, context):
        context.log.append(self.msg)


@dataclass(kw_only=True)
class Shutdown(LaunchDescriptionEntity):
    reason: str


@dataclass
class ProcessExited:
    returncode: int


@dataclass(kw_only=True, eq=False)
class ExecuteProcess(LaunchDescriptionEntity):
    cmd: list[Any] = field(default_factory=list)
    output: str = 'log'
    respawn: bool = False
    respawn_delay: float | None = None
    on_exit: Any = None

    def execute(self, context):
        self.command = self.full_command(context)
        context.processes.append(self)

    def full_command(self, context):
        return [performed(word, context) for word in self.cmd]

    def after_exit(self, returncode, context):
        """Return the action after an exit, None for none."""
        if callable(self.on_exit):
            return self.on_exit(ProcessExited(returncode), context)
        return self.on_exit


@dataclass(kw_only=True, eq=False)
class Node(ExecuteProcess):
    package: Any
    executable: Any
    name: str | None = None
    namespace: Any = None
    parameters: list[Any] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)

    def full_command(self, context):
        command = [
            f'{performed(self.package, context)}/{performed(self.executable, context)}',
            *(performed(word, context) for word in self.arguments), '--ros-args',
            *(performed(word, context) for word in self.ros_arguments)]
        if self.name is not None:
            command += ['-r', f'__node:={self.name}']
        namespace = make_namespace_absolute(prefix_namespace(
            context.launch_configurations.get('ros_namespace'),
            None if self.namespace is None else performed(self.namespace, context)))
        if namespace is not None:
            if not re.fullmatch(r'/|(/[A-Za-z_]\w*)+', namespace):
                raise ValueError(f'invalid namespace {namespace}')
            command += ['-r', f'__ns:={namespace}']
        for given in self.parameters:
            command += ['--params-file', self._file(given, namespace, context)]
        return command

    def _file(self, given, namespace, context):
        if not isinstance(given, dict):
            return performed(given, context)
        values = {name: self._value(value, context) for name, value in given.items()}
        is_named = self.name is not None and namespace is not None
        section = prefix_namespace(namespace, self.name) if is_named else '/**'
        path = context.folder / f'launch_params_{len([*context.folder.iterdir()])}'
        path.write_text(json.dumps({section: {'ros__parameters': values}}))
        return str(path)

    def _value(self, value, context):
        if isinstance(value, list):
            return [self._value(element, context) for element in value]
        if isinstance(value, ParameterValue):
            return value.value_type(performed(value.value, context))
        if isinstance(value, (LaunchConfiguration, InText, str)):
            return YAML(typ='safe').load(performed(value, context))
        return value


class LifecycleNode(Node):
    pass


@dataclass
class ParameterValue:
    value: Any
    value_type: type = field(kw_only=True)


@dataclass
class PushRosNamespace(LaunchDescriptionEntity):
    namespace: Any

    def execute(self, context):
        pushed = performed(self.namespace, context)
        previous = context.launch_configurations.get('ros_namespace')
        context.launch_configurations['ros_namespace'] = prefix_namespace(previous, pushed)


def prefix_namespace(base, namespace):
    """Return the concatenation of two namespaces, of which None is none."""
    if namespace is None:
        return base
    if not base or namespace.startswith('/'):
        return namespace.rstrip('/') or namespace
    return f'{base.rstrip("/")}/{namespace}'.rstrip('/')


def make_namespace_absolute(namespace):
    return namespace if namespace is None or namespace.startswith('/') else f'/{namespace}'


@dataclass
class PythonLaunchDescriptionSource:
    location: Any


@dataclass
class IncludeLaunchDescription(LaunchDescriptionEntity):
    launch_description_source: Any
    launch_arguments: Any = field(default=(), kw_only=True)

    def execute(self, context):
        for name, value in self.launch_arguments:
            context.launch_configurations[name] = performed(value, context)
        location = performed(self.launch_description_source.location, context)
        load(Path(location)).execute(context)


MODULES = {
    'launch': (LaunchContext, LaunchDescription, LaunchDescriptionEntity),
    'launch.actions': (
        DeclareLaunchArgument, ExecuteProcess, GroupAction, IncludeLaunchDescription, LogInfo,
        OpaqueFunction, Shutdown),
    'launch.conditions': (IfCondition,),
    'launch.events': (),
    'launch.events.process': (ProcessExited,),
    'launch.launch_description_sources': (PythonLaunchDescriptionSource,),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.actions': (LifecycleNode, Node, PushRosNamespace),
    'launch_ros.parameter_descriptions': (ParameterValue,),
    'launch_ros.substitutions': (ExecutableInPackage,),
    'launch_ros.utilities': (make_namespace_absolute, prefix_namespace),
}


def install(patch):
    """Have launch files import this instead."""
    for name, classes in MODULES.items():
        module = ModuleType(name)
        vars(module).update({class_.__name__: class_ for class_ in classes})
        patch.setitem(sys.modules, name, module)


def load(path):
    """Return the description in a launch file, of Python or YAML."""
    if path.suffix == '.yaml':
        entries = YAML(typ='safe').load(path)['launch']
        return LaunchDescription([from_yaml(*pair) for tags in entries for pair in tags.items()])
    loader = SourceFileLoader(path.name.replace('.', '_'), str(path))
    module = module_from_spec(spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module.generate_launch_description()


def from_yaml(tag, given):
    """Return the action that an entry of a YAML launch file stands for."""
    if tag == 'arg':
        return DeclareLaunchArgument(
            given['name'], default_value=given.get('default') and InText(given['default']),
            description=given['description'])
    if tag == 'let':
        return SetLaunchConfiguration(given['name'], InText(given['value']))
    if tag == 'group':
        return GroupAction([from_yaml(*pair) for tags in given for pair in tags.items()])
    if tag == 'push_ros_namespace':
        return PushRosNamespace(InText(given['namespace']))
    if tag == 'node':
        return Node(
            package=given['pkg'], executable=given['exec'], name=given['name'],
            output=given['output'], parameters=[
                InText(parameter['from']) if 'from' in parameter
                else {parameter['name']: InText(parameter['value'])}
                for parameter in given['param']])
    assert tag == 'include'
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(InText(given['file'])),
        launch_arguments=[(arg['name'], InText(arg['value'])) for arg in given['arg']])


class LaunchService:
    """
    The processes of an executed description, running; `start` starts one and returns it.

    When one ends, its action follows, or it is started again; a shutdown interrupts all others.

    """

    def __init__(self, context, start):
        self._context = context
        self._start = start
        self._due = {}
        self.running = {action: start(action.command) for action in context.processes}
        self.reason = None
        self.returncodes = {}

    def step(self):
        """Handle the processes that have ended since the last step."""
        for action, process in [*self.running.items()]:
            if process.poll() is not None:
                del self.running[action]
                self._ended(action, process.returncode)
        for action, at in [*self._due.items()]:
            if monotonic() >= at:
                del self._due[action]
                self.running[action] = self._start(action.command)

    def shut_down(self, reason):
        """Interrupt all processes."""
        if self.reason is None:
            self.reason = reason
            self._due.clear()
            for process in self.running.values():
                with suppress(ProcessLookupError):
                    process.send_signal(signal.SIGINT)

    def _ended(self, action, returncode):
        self.returncodes[action.command[0]] = returncode
        after = action.after_exit(returncode, self._context)
        if after is not None:
            self.shut_down(after.reason)
        if action.respawn and self.reason is None:
            self._due[action] = monotonic() + (action.respawn_delay or 0.0)
