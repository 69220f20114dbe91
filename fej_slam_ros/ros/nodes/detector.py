# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``detector``: scans of planar lasers and odometry in, landmarks out."""

from functools import partial

from fej_slam_ros.ros.nodes.front_end import FrontEndNode, spin
from fej_slam_ros.ros.parameters.detector_settings import known_parameters, parse_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession


class DetectorNode(FrontEndNode):
    """A node that publishes the landmarks in the scans of some robots."""

    def __init__(self) -> None:
        super().__init__('detector')
        settings = parse_detector(self.given, self.get_logger().warning)
        self.start(DetectorSession(settings), settings, known_parameters(settings.robots))


#: Runs the node until a signal arrives; returns 0.
main = partial(spin, make_node=DetectorNode)
