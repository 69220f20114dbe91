# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the estimator, and RViz if wanted."""

import re

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the estimator and RViz."""
    rviz_file = get_package_share_path('fej_slam_ros') / 'config' / 'fej_slam.rviz'
    return LaunchDescription([
        DeclareLaunchArgument(
            'robots', default_value='',
            description='names of the robots, for example r1,r2; empty: those of params_file'),
        DeclareLaunchArgument(
            'params_file', default_value='',
            description='ROS parameter file, such as config/estimator.yaml; empty: defaults, which'
            ' need the argument robots'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false', description='use the time on /clock'),
        DeclareLaunchArgument(
            'rviz', default_value='false',
            description='start RViz with the configuration of the package'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='namespace of the estimator'),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='configure and activate the estimator at its start'),
        OpaqueFunction(function=_estimator),
        Node(
            package='rviz2', executable='rviz2', arguments=['-d', str(rviz_file)],
            parameters=[{'use_sim_time': LaunchConfiguration('use_sim_time')}],
            condition=IfCondition(LaunchConfiguration('rviz'))),
    ])


def _estimator(context: LaunchContext) -> list[LifecycleNode]:
    robots = re.findall(r'\w+', LaunchConfiguration('robots').perform(context))
    params_file = LaunchConfiguration('params_file').perform(context)
    given = {
        name: LaunchConfiguration(name) for name in ('use_sim_time', 'autostart')}
    return [LifecycleNode(
        package='fej_slam_ros', executable='estimator', name='estimator', output='screen',
        namespace=LaunchConfiguration('namespace'),
        # Later parameters override earlier ones.
        parameters=[
            *([params_file] if params_file else []), given,
            *([{'robots': robots}] if robots else [])])]
