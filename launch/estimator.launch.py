# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the estimator, and RViz if wanted."""

import os
from pathlib import Path
import re
from tempfile import NamedTemporaryFile

from ament_index_python.packages import (
    get_package_prefix, get_package_share_path, PackageNotFoundError)
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.utilities import make_namespace_absolute, prefix_namespace

from fej_slam_ros.ros.files.rviz_config import team_config
from fej_slam_ros.ros.parameters import load_values

#: Delay of a respawn [s], as in Nav2.
RESPAWN_DELAY = 2.0


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the estimator and RViz."""
    return LaunchDescription([
        DeclareLaunchArgument(
            'robots', default_value='',
            description='names of the robots, for example r1,r2; empty: those of params_file'),
        DeclareLaunchArgument(
            'params_file', default_value='',
            description='ROS parameter file, such as config/estimator.yaml; empty: defaults, which'
            ' need the argument robots'),
        DeclareLaunchArgument(
            'filter', default_value='',
            description='fej, invariant, standard or ideal; empty: that of params_file'),
        DeclareLaunchArgument(
            'output', default_value='',
            description='folder for the files of the run; empty: that of params_file'),
        DeclareLaunchArgument(
            'initialpose_robot', default_value='',
            description='robot that "2D Pose Estimate" places; empty: that of params_file, or none'
            ' with robots'),
        DeclareLaunchArgument(
            'namespace', default_value='',
            description='namespace of all topics and services of the team, for example fleet'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false', description='use the time on /clock'),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='configure and activate the estimator at its start'),
        DeclareLaunchArgument(
            'log_level', default_value='info',
            description='debug, info, warn, error or fatal; estimator:=debug for its own lines'),
        DeclareLaunchArgument(
            'respawn', default_value='false',
            description='start the estimator again when it ends; set checkpoint and restore'),
        DeclareLaunchArgument(
            'required', default_value='false',
            description='end the whole launch when the estimator or RViz ends'),
        DeclareLaunchArgument(
            'rviz', default_value='false', choices=['auto', 'true', 'True', 'false', 'False'],
            description='start RViz; auto: if it is installed and there is a display'),
        DeclareLaunchArgument(
            'rviz_config', default_value='',
            description='configuration of RViz; empty: one for the robots'),
        OpaqueFunction(function=_processes),
    ])


def _processes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """
    Return the estimator and RViz.

    If a process cannot be started, launch may leave those running that it started before. So
    everything that can be wrong is found here, before the first one starts.

    """
    return [_estimator(context), *_rviz(context)]


def _estimator(context: LaunchContext) -> LifecycleNode:
    params_file, output, log_level = (
        _text(context, name) for name in ('params_file', 'output', 'log_level'))
    robots = _robots(context)
    if output in ('screen', 'log', 'both'):
        raise RuntimeError(
            f'output:={output}: give a folder for the files of the run; the environment variable'
            f' OVERRIDE_LAUNCH_PROCESS_OUTPUT={output} decides where log lines go')
    if params_file and not Path(params_file).is_file():
        raise RuntimeError(f'params_file:={params_file}: there is no such file')
    given = {name: _flag(context, name) for name in ('use_sim_time', 'autostart')}
    texts = {name: _text(context, name) for name in ('filter', 'output', 'initialpose_robot')}
    given |= {
        name: ParameterValue(text, value_type=str) for name, text in texts.items()
        # The robot that a parameter file names may not be one of the argument.
        if text or (robots and name == 'initialpose_robot')}
    if robots:
        given['robots'] = robots
    respawn = _flag(context, 'respawn')
    return LifecycleNode(
        package='fej_slam_ros', executable='estimator', name='estimator',
        namespace=_text(context, 'namespace'), output='screen',
        # Later parameters override earlier ones.
        parameters=[*([params_file] if params_file else []), given],
        ros_arguments=['--log-level', log_level],
        respawn=respawn, respawn_delay=RESPAWN_DELAY,
        on_exit=None if respawn else _end_if_required(context, 'estimator'))


def _rviz(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    wanted = _text(context, 'rviz').lower()
    if wanted == 'false':
        return []
    if not _rviz_is_installed():
        if wanted == 'true':
            raise RuntimeError('rviz:=true: install rviz2, or give rviz:=auto or rviz:=false')
        return [LogInfo(msg='RViz is not started: rviz2 is not installed')]
    if wanted == 'auto' and not {'DISPLAY', 'WAYLAND_DISPLAY'} & os.environ.keys():
        return [LogInfo(msg='RViz is not started: there is no display')]
    return [Node(
        package='rviz2', executable='rviz2',
        arguments=['-d', _text(context, 'rviz_config') or _rviz_config(context)],
        parameters=[{'use_sim_time': _flag(context, 'use_sim_time')}],
        on_exit=_end_if_required(context, 'RViz'))]


def _rviz_is_installed() -> bool:
    try:
        return (Path(get_package_prefix('rviz2')) / 'lib' / 'rviz2' / 'rviz2').exists()
    except PackageNotFoundError:
        return False


def _rviz_config(context: LaunchContext) -> str:
    """Write a configuration of RViz for the robots and return its path."""
    namespace = make_namespace_absolute(prefix_namespace(
        context.launch_configurations.get('ros_namespace'), _text(context, 'namespace')))
    params_file = _text(context, 'params_file')
    values = (
        load_values(Path(params_file), ['estimator'], namespace=namespace) if params_file else {})
    robots = _robots(context) or values.get('robots', [])
    template = get_package_share_path('fej_slam_ros') / 'config' / 'fej_slam.rviz'
    with NamedTemporaryFile('w', prefix='fej_slam_', suffix='.rviz', delete=False) as file:
        file.write(team_config(template, robots, namespace, values.get('map_frame', 'map')))
    return file.name


def _end_if_required(context: LaunchContext, name: str) -> Shutdown | None:
    return Shutdown(reason=f'{name} has ended') if _flag(context, 'required') else None


def _robots(context: LaunchContext) -> list[str]:
    return re.findall(r"[^\s,'\"\[\]]+", _text(context, 'robots'))


def _text(context: LaunchContext, name: str) -> str:
    return LaunchConfiguration(name).perform(context)


def _flag(context: LaunchContext, name: str) -> bool:
    return IfCondition(LaunchConfiguration(name)).evaluate(context)
