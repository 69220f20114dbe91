# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics and services of a node that follow the team of its session."""

from collections.abc import Callable, Sequence

from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.nodes.endpoints import check_topic_names, is_installed
from fej_slam_ros.ros.nodes.managed_node import ManagedNode
from fej_slam_ros.ros.nodes.relocalize_services import RelocalizeServices
from fej_slam_ros.ros.nodes.topics import NodeTopics
from fej_slam_ros.ros.session.session import Session
from fej_slam_ros.ros.topic_types import TF_TYPE


class TeamEndpoints:
    """Creates the topics and services of the present team, and destroys those of others."""

    def __init__(
        self, node: ManagedNode, topics: NodeTopics, request: Callable[[str], PosePrior]
    ) -> None:
        self._node = node
        self._topics = topics
        self._services = RelocalizeServices(node, request)

    def match(self, session: Session, is_active: bool) -> None:
        """Match the outputs, the services and, if the node is active, the inputs to the team."""
        outputs, inputs = session.outputs.topics, _input_types(session)
        check_topic_names(self._node, [*outputs, *inputs])
        self._topics.match_outputs(outputs, is_active)
        self._topics.match_inputs(inputs if is_active else {})
        self._services.match(
            name for name in session.consumer.robots if f'{name}/set_pose' in inputs)
        if is_active:
            # The anchor of a smoother may have left, or be that of other smoothers.
            self._topics.watch_first(
                topic for topic in session.inputs.start_check.topics() if topic in inputs)

    def check_robots(self, session: Session, names: Sequence[str]) -> None:
        """Check the names of the topics of robots while the team is as it was."""
        member = next(iter(session.consumer.robots))
        topics = [*session.outputs.topics, *_input_types(session), f'{member}/relocalize']
        check_topic_names(self._node, (
            f'{name}/{topic.removeprefix(f"{member}/")}' for topic in topics
            if topic.startswith(f'{member}/') for name in parameters.robot_names(names)))

    def close(self) -> None:
        """Destroy the outputs and services of all robots; the inputs end with the activity."""
        self._services.match(())
        self._topics.match_outputs({}, active=False)


def _input_types(session: Session) -> dict[str, str]:
    inputs = session.inputs
    return inputs.topics | (inputs.static_topics if is_installed(TF_TYPE) else {})
