# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch the estimator and play a bag to it, with RViz if wanted."""

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, Shutdown)
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the estimator and the player."""
    share = get_package_share_path('fej_slam_ros')
    passed_on = ('robots', 'params_file', 'use_sim_time', 'rviz')
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='folder of a rosbag2'),
        DeclareLaunchArgument(
            'rate', default_value='1.0', description='seconds of the bag per second'),
        DeclareLaunchArgument(
            'robots', default_value='',
            description='names of the robots, for example r1,r2; empty: those of params_file'),
        DeclareLaunchArgument(
            'params_file', default_value='',
            description='ROS parameter file of the estimator; empty: defaults, with robots'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='true', description='use the time of the bag'),
        DeclareLaunchArgument(
            'rviz', default_value='auto',
            description='start RViz; auto: if it is installed and there is a display'),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(share / 'launch' / 'estimator.launch.py')),
            launch_arguments=[
                *((name, LaunchConfiguration(name)) for name in passed_on), ('required', 'true')]),
        # A Node action would add ROS arguments, which play does not accept.
        ExecuteProcess(
            cmd=[
                ExecutableInPackage(package='fej_slam_ros', executable='play'),
                LaunchConfiguration('bag'), '--clock', '--rate', LaunchConfiguration('rate')],
            output='screen', on_exit=_end_after_failure),
    ])


def _end_after_failure(event: ProcessExited, _context: LaunchContext) -> Shutdown | None:
    """End the launch unless the bag has simply ended, which leaves its map in view."""
    return Shutdown(reason='play has failed') if event.returncode else None
