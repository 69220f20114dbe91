# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the estimator with a parameter file."""

from ament_index_python.packages import get_package_share_path
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    """Return the estimator with its arguments."""
    example = get_package_share_path('fej_slam_ros') / 'config' / 'estimator.yaml'
    return LaunchDescription([
        DeclareLaunchArgument(
            'params_file', default_value=str(example), description='ROS parameters (YAML)'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false', description='take the time from /clock'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='namespace of the estimator'),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='whether the estimator configures and activates itself'),
        LifecycleNode(
            package='fej_slam_ros', executable='estimator', name='estimator', output='screen',
            namespace=LaunchConfiguration('namespace'),
            parameters=[
                LaunchConfiguration('params_file'),
                {
                    'use_sim_time': LaunchConfiguration('use_sim_time'),
                    'autostart': LaunchConfiguration('autostart')}]),
    ])
