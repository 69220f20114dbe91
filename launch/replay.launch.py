# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the estimator with a bag that is played to it, and RViz to look at the team."""

from ament_index_python.packages import get_package_share_path
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage


def generate_launch_description() -> LaunchDescription:
    """Return player and estimator with their arguments."""
    share = get_package_share_path('fej_slam_ros')
    passed_on = ('robots', 'params_file', 'use_sim_time', 'rviz')
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='folder of a rosbag2'),
        DeclareLaunchArgument(
            'rate', default_value='1.0', description='seconds of the bag in one second'),
        DeclareLaunchArgument(
            'robots', default_value='',
            description='names of the robots, for example r1,r2; empty: those of params_file'),
        DeclareLaunchArgument(
            'params_file', default_value='',
            description='ROS parameters (YAML) of the estimator; empty: none, then give robots'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='true', description='take the time from the bag'),
        DeclareLaunchArgument(
            'rviz', default_value='false', description='look at the team in RViz'),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(share / 'launch' / 'estimator.launch.py')),
            launch_arguments=[(name, LaunchConfiguration(name)) for name in passed_on]),
        # Not a Node, which would be given ROS arguments.
        ExecuteProcess(
            cmd=[
                ExecutableInPackage(package='fej_slam_ros', executable='play'),
                LaunchConfiguration('bag'), '--clock', '--rate', LaunchConfiguration('rate')],
            output='screen'),
    ])
