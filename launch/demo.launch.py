# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the simulator, the estimator and RViz."""

import re

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown)
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the estimator and the simulator."""
    share = get_package_share_path('fej_slam_ros')
    passed_on = ('robots', 'params_file', 'namespace', 'use_sim_time', 'log_level', 'rviz')
    return LaunchDescription([
        DeclareLaunchArgument(
            'robots', default_value='',
            description='names of two robots, for example a,b; empty: those of params_file'),
        DeclareLaunchArgument(
            'params_file', default_value=str(share / 'config' / 'demo.yaml'),
            description='ROS parameter file with a section for simulator and one for estimator'),
        DeclareLaunchArgument(
            'namespace', default_value='',
            description='namespace of all topics and services of the team, for example fleet'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='true',
            description='publish simulated time on /clock and use it'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='debug, info, warn, error or fatal'),
        DeclareLaunchArgument(
            'rviz', default_value='auto',
            description='start RViz; auto: if it is installed and there is a display'),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(share / 'launch' / 'estimator.launch.py')),
            launch_arguments=[
                *((name, LaunchConfiguration(name)) for name in passed_on), ('required', 'true')]),
        OpaqueFunction(function=_simulator),
    ])


def _simulator(context: LaunchContext) -> list[Node]:
    robots = re.findall(r"[^\s,'\"\[\]]+", LaunchConfiguration('robots').perform(context))
    return [Node(
        package='fej_slam_ros', executable='simulator', name='simulator', output='screen',
        namespace=LaunchConfiguration('namespace'),
        parameters=[
            LaunchConfiguration('params_file'),
            {'clock': LaunchConfiguration('use_sim_time')},
            *([{'robots': robots}] if robots else [])],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        on_exit=_end_after_failure)]


def _end_after_failure(event: ProcessExited, _context: LaunchContext) -> Shutdown | None:
    """End the launch unless the simulated world has simply ended, which leaves its map in view."""
    return Shutdown(reason='the simulator has failed') if event.returncode else None
