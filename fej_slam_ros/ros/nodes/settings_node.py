# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes whose parameters are the settings of a run."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.nodes.endpoints import is_installed
from fej_slam_ros.ros.nodes.managed_node import ManagedNode
from fej_slam_ros.ros.topic_types import TF_TYPE


class SettingsNode(ManagedNode):
    """A lifecycle node that declares the parameters of its settings as they are parsed."""

    #: Settings whose parameters the node reads.
    audience: parameters.Audience = parameters.ESTIMATOR
    #: Parameter that says whether the node publishes transforms.
    tf_parameter: str

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._settings = parameters.parse(self.given, self.get_logger().warning)
        robots = self._robot_names()
        known = parameters.known_parameters(robots)
        # Every node counts the peers among its robots.
        self._log_ignored(
            known.keys() - {*parameters.known_parameters(robots, self.audience), 'peers'})
        self.redeclare(
            parameters.as_parameters(self._settings), known, self.changeable_parameters())
        if self._lacks_tf():
            without: dict[str, Any] = {self.tf_parameter: False}
            self._settings = replace(
                self._settings, node=replace(self._settings.node, **without))
        self._next_settings = self._settings

    def known_parameters(self) -> Mapping[str, Parameter]:
        return parameters.known_parameters(self._robot_names())

    def changeable_parameters(self) -> Collection[str]:
        return parameters.changeable_parameters(self._robot_names(), self.audience)

    def _robot_names(self) -> list[str]:
        return [robot.name for robot in self._settings.estimation.robots]

    def _changeable_values(self) -> dict[str, parameters.Value]:
        """Return the values in force of the parameters that may change."""
        names, values = self.changeable_parameters(), parameters.as_parameters(self._settings)
        return {name: value for name, value in values.items() if name in names}

    def _lacks_tf(self) -> bool:
        """Return whether the node cannot publish the transforms that it is to publish."""
        is_wanted = self.get_parameter(self.tf_parameter).value
        return bool(is_wanted) and not is_installed(TF_TYPE)

    def _log_ignored(self, of_other_nodes: Collection[str]) -> None:
        ignored = [name for name in self.given if name in of_other_nodes]
        if ignored:
            self.get_logger().info(
                f'parameters that this node does not read: {", ".join(ignored)}')

    def _warn_of_unused_overrides(self) -> None:
        for name in self.given:
            if name.startswith(parameters.QOS_OVERRIDES) and not self.has_parameter(name):
                self.get_logger().warning(
                    f'parameter {name!r} has no effect: this node has no such topic or policy')
