# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes and of ``replay``, ``smooth``, ``calibrate``: YAML, ROS and settings."""

from fej_slam_ros.ros.parameters.node_settings import CommonNodeSettings, NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.parsing import (
    changed_team, checked_values, parse, RENAMED_PARAMETERS, RESERVED_NAMES, robot_names)
from fej_slam_ros.ros.parameters.schema import (
    as_parameters, deciding, declared_parameters, ESTIMATOR, known_parameters, QOS_OVERRIDES,
    QOS_POLICIES, SMOOTHER, Value)
from fej_slam_ros.ros.parameters.yaml_files import dump, dump_values, load, load_values

__all__ = [
    'ESTIMATOR', 'QOS_OVERRIDES', 'QOS_POLICIES', 'RENAMED_PARAMETERS', 'RESERVED_NAMES',
    'SMOOTHER', 'CommonNodeSettings', 'NodeSettings', 'RunSettings', 'Value', 'as_parameters',
    'changed_team', 'checked_values', 'deciding', 'declared_parameters', 'dump', 'dump_values',
    'known_parameters', 'load', 'load_values', 'parse', 'robot_names']
