# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``simulator``: odometry, observations and ground truth of a synthetic world out."""

from collections.abc import Mapping, Sequence

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.ros.messages.object_formats import FORMATS
from fej_slam_ros.ros.nodes.parameter_node import ParameterNode
from fej_slam_ros.ros.nodes.player import Player
from fej_slam_ros.ros.nodes.ros_process import ros, warn_of_parameter_files
from fej_slam_ros.ros.session import simulated_input, simulation
from fej_slam_ros.ros.topic_types import CLOUD, LASER_SCAN, ODOMETRY, SENT_TOPICS, TRUE_LANDMARKS
from fej_slam_ros.sim.environments import LaserEnvironment, TagEnvironment

#: Types of the topics of a robot whose data are not yet observations, by the last part of names.
SENSOR_TOPICS = {
    LaserEnvironment: {'scan': LASER_SCAN, 'odom': ODOMETRY, 'ground_truth': ODOMETRY},
    TagEnvironment: {
        'tags': FORMATS['marker_array'].type_name, 'odom': ODOMETRY, 'ground_truth': ODOMETRY}}


def main(ros_args: Sequence[str]) -> int:
    """Run the node until the world ends or a signal arrives; return 0."""
    with ros(ros_args) as stopped:
        node = SimulatorNode()
        warn_of_parameter_files(ros_args, node)
        simulated = node.simulated
        player = Player(
            node, _topic_types(simulated), [TRUE_LANDMARKS], simulated.speed, simulated.clock,
            'wait: false')
        messages = simulated_input.messages(
            simulated, None if node.has_simulated_time else node.now)
        player.run(messages, simulated.wait, stopped)
    return 0


class SimulatorNode(ParameterNode):
    """
    A node with the parameters of a simulation, all of them read-only.

    Attributes
    ----------
    simulated : the simulation
    has_simulated_time : whether stamps are simulated time

    """

    def __init__(self) -> None:
        super().__init__('simulator')
        self.simulated = simulation.parse(self.given, self.get_logger().warning)
        self.has_simulated_time = (
            self.simulated.clock or bool(self.get_parameter('use_sim_time').value))
        self.redeclare(simulation.as_parameters(self.simulated), simulation.PARAMETERS)

    def known_parameters(self) -> Mapping[str, Parameter]:
        return simulation.PARAMETERS

    def now(self) -> int:
        """Return the present time [ns]."""
        return int(self.get_clock().now().nanoseconds)


def _topic_types(simulated: simulation.Simulation) -> dict[str, str]:
    environment = simulated.environment
    kinds = SENSOR_TOPICS.get(type(environment), SENT_TOPICS)
    types = {
        f'{name}/{kind}': type_name
        for name in environment.world.robots for kind, type_name in kinds.items()
        if kind != 'robots' or name in environment.observers}
    if environment.shared_landmark_ids:
        types[TRUE_LANDMARKS] = CLOUD
    return types
