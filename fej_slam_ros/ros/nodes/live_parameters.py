# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of parameters while a node runs: types, reasons of rejection, and the log."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.parameters import QOS_OVERRIDES, Value

Type = Parameter.Type
#: The floating-point type that accepts values of an integer type.
FLOAT_TYPE_OF = {Type.INTEGER: Type.DOUBLE, Type.INTEGER_ARRAY: Type.DOUBLE_ARRAY}


class LiveParameters:
    """
    Callbacks of a node for parameters that are set.

    Parameters
    ----------
    change : changes the run by new values of parameters, or raises a UserError
    present : returns the values in force of the parameters that may change

    """

    def __init__(
        self, node: Node, change: Callable[[Mapping[str, Any]], None],
        present: Callable[[], Mapping[str, Value]],
    ) -> None:
        self._node = node
        self._change = change
        self._present = present
        self._is_matching = False
        node.add_pre_set_parameters_callback(
            lambda changes: [self._with_float(change) for change in changes])
        node.add_on_set_parameters_callback(self._apply)
        node.add_post_set_parameters_callback(self._match_others)

    def match(self) -> None:
        """Set the parameters of the node to the values in force."""
        changed = [
            Parameter(name, value=value) for name, value in self._present().items()
            if self._node.has_parameter(name) and self._value(name) != value]
        self._is_matching = True
        if changed:
            self._log(changed)
            self._node.set_parameters(changed)
        self._is_matching = False

    def _with_float(self, change: Parameter) -> Parameter:
        """Return a change, with a float where an integer is given for one."""
        name, wanted = change.name, FLOAT_TYPE_OF.get(change.type_)
        if wanted is None or not self._node.has_parameter(name):
            return change
        if self._node.get_parameter(name).type_ != wanted:
            return change
        value = float(change.value) if wanted is Type.DOUBLE else [*map(float, change.value)]
        return Parameter(name, wanted, value)

    def _apply(self, changes: Sequence[Parameter]) -> SetParametersResult:
        changes = self._changeable(changes)
        if changes and not self._is_matching:
            try:
                self._change({change.name: _plain(change.value) for change in changes})
            except UserError as error:
                return SetParametersResult(successful=False, reason=str(error))
            self._log(changes)
        return SetParametersResult(successful=True)

    def _match_others(self, changes: Sequence[Parameter]) -> None:
        """Set the parameters that follow others, such as the noise of robots that of the team."""
        if not self._is_matching and self._changeable(changes):
            self.match()

    def _changeable(self, changes: Sequence[Parameter]) -> list[Parameter]:
        """Return the changes of parameters that may change, without those of topics."""
        # rclpy declares one parameter after another for each topic.
        changes = [change for change in changes if not change.name.startswith(QOS_OVERRIDES)]
        present = self._present() if changes else {}
        return [change for change in changes if change.name in present]

    def _log(self, changes: Sequence[Parameter]) -> None:
        for change in changes:
            before, after = self._value(change.name), _plain(change.value)
            if after != before:
                self._node.get_logger().info(
                    f'parameter {change.name!r} changed from {before!r} to {after!r}')

    def _value(self, name: str) -> Value:
        value: Value = _plain(self._node.get_parameter(name).value)
        return value


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, array) else value
