# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes and of ``replay``, ``smooth``, ``calibrate``: YAML, ROS and settings."""

from fej_slam_ros.ros.parameters.changes import (
    changeable_parameters, changed_peers, changed_team, changes_before, checked_changes,
    ParameterChange, rejection, with_node_values, with_values)
from fej_slam_ros.ros.parameters.node_settings import CommonNodeSettings, NodeSettings, RunSettings
from fej_slam_ros.ros.parameters.parsing import check_peer_files, estimation_of, parse
from fej_slam_ros.ros.parameters.schema import (
    as_parameters, Audience, deciding, declared_parameters, ESTIMATOR, known_parameters,
    QOS_OVERRIDES, QOS_POLICIES, SMOOTHER, Value)
from fej_slam_ros.ros.parameters.values import (
    given_values, no_warning, PARAMETERS_OF_ROS, RENAMED_PARAMETERS, RESERVED_NAMES, robot_names,
    STRICT_PARAMETERS, Warn, warn_once)
from fej_slam_ros.ros.parameters.yaml_files import (
    dump, dump_values, load, load_current_values, load_parsed, load_values)

__all__ = [
    'ESTIMATOR', 'PARAMETERS_OF_ROS', 'QOS_OVERRIDES', 'QOS_POLICIES', 'RENAMED_PARAMETERS',
    'RESERVED_NAMES', 'SMOOTHER', 'STRICT_PARAMETERS', 'Audience', 'CommonNodeSettings',
    'NodeSettings', 'ParameterChange', 'RunSettings', 'Value', 'Warn', 'as_parameters',
    'changeable_parameters', 'changed_peers', 'changed_team', 'changes_before',
    'check_peer_files', 'checked_changes', 'deciding', 'declared_parameters', 'dump',
    'dump_values', 'estimation_of', 'given_values', 'known_parameters', 'load',
    'load_current_values', 'load_parsed', 'load_values', 'no_warning', 'parse', 'rejection',
    'robot_names', 'warn_once', 'with_node_values', 'with_values']
