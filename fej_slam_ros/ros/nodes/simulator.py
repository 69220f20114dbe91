# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``simulator``: odometry, observations and ground truth of a synthetic world out."""

from collections.abc import Iterator, Sequence

from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.nodes.player import Player
from fej_slam_ros.ros.nodes.ros_process import ParameterNode, ros
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.inputs import CLOUD, SENT_TOPICS, TRUE_LANDMARKS


def main(ros_args: Sequence[str]) -> int:
    """Run the node until the world ends; return 0, or 130 after an interrupt."""
    with ros(ros_args) as stopped:
        node = ParameterNode('simulator')
        simulated = simulation.parse(node.given, node.get_logger().warning)
        player = Player(
            node, _topic_types(simulated), [TRUE_LANDMARKS], simulated.speed, simulated.clock)
        return player.run(_messages(simulated), simulated.wait, stopped)


def _topic_types(simulated: simulation.Simulation) -> dict[str, str]:
    environment = simulated.environment
    types = {
        f'{name}/{kind}': type_name
        for name in environment.world.robots for kind, type_name in SENT_TOPICS.items()
        if kind != 'robots' or name in environment.observers}
    if environment.shared_landmark_ids:
        types[TRUE_LANDMARKS] = CLOUD
    return types


def _messages(simulated: simulation.Simulation) -> Iterator[RawMessage]:
    for record in simulated.records():
        topic, message = outgoing.input_message(record, simulated.robot_ids)
        yield RawMessage(topic, message.__msgtype__, record.stamp, serialize(message))
