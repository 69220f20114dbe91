# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``adapter``: poses of tags and other objects in, landmarks and robots out."""

from collections.abc import Sequence

from fej_slam_ros.ros.files.landmark_ids import stored_ids
from fej_slam_ros.ros.nodes.front_end import check_installed, FrontEndNode, spin
from fej_slam_ros.ros.parameters.adapter_settings import (
    adapter_values, known_parameters, parse_adapter)
from fej_slam_ros.ros.session.adapter_session import AdapterSession


def main(ros_args: Sequence[str]) -> int:
    """Run the node until a signal arrives; return 0."""
    return spin(ros_args, AdapterNode)


class AdapterNode(FrontEndNode):
    """A node that publishes the objects in the messages of other packages."""

    def __init__(self) -> None:
        super().__init__('adapter')
        settings = parse_adapter(self.given, self.get_logger().warning)
        check_installed(of.type_name for of in settings.object_formats())
        self.start(
            AdapterSession(settings, *stored_ids(settings.ids_file)), adapter_values(settings),
            known_parameters(settings.robots))
