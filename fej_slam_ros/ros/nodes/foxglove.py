# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The running system, served to Foxglove over a WebSocket."""

from dataclasses import dataclass
from importlib.util import find_spec
import json

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, WebSocketServer
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import definition, deserialize, serialize
from fej_slam_ros.ros.messages.outgoing import view_frames
from fej_slam_ros.ros.nodes.ros_process import message_class, ros
from fej_slam_ros.ros.session.inputs import ODOMETRY
from fej_slam_ros.ros.session.live_plots import CONSISTENCY, consistency, FRAMES, robots_of, SCHEMA
from fej_slam_ros.ros.session.outputs import DIAGNOSTICS, ROBOT_TYPES, TF_TYPE, TYPES

#: Topics of other types are not served.
SERVED = {*TYPES.values(), *ROBOT_TYPES.values(), ODOMETRY, TF_TYPE}
#: How often [s] topics that have come, and what clients want, are looked for.
PERIOD = 0.2
#: How often [s] clients are told the time.
TICK = 0.05
#: As the publishers that there are offer it.
AS_OFFERED = QoSProfile(
    depth=100, reliability=QoSReliabilityPolicy.BEST_AVAILABLE,
    durability=QoSDurabilityPolicy.BEST_AVAILABLE)


@dataclass
class Shown:
    """
    A topic as clients see it.

    Attributes
    ----------
    channel : by which they get it
    newest : its last message, for clients that come later
    subscription : where its messages come from, while they are wanted

    """

    channel: foxglove.Channel
    newest: bytes = b''
    subscription: Subscription | None = None


class View(ServerListener):
    """
    Passes messages on as they are, and what reports tell as plain numbers.

    A topic is subscribed while a client wants it. Clients that are too slow lose messages, and
    nobody waits for them: the server sees to that.

    Parameters
    ----------
    node : whose subscriptions they are

    """

    def __init__(self, node: Node) -> None:
        self.context = foxglove.Context()
        self._node = node
        self._types: dict[str, str] = {}
        self._shown = {
            CONSISTENCY: Shown(
                foxglove.Channel(CONSISTENCY, schema=SCHEMA, context=self.context)),
            FRAMES: Shown(self._channel(FRAMES, TF_TYPE))}
        node.create_timer(PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send a client what others have got already; a thread of the server calls this."""
        shown = self._shown[channel.topic]
        if shown.newest:
            shown.channel.log(shown.newest, log_time=self.now(), sink_id=client.id)

    def now(self) -> int:
        """Return ROS time [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    def _look(self) -> None:
        """Offer the topics that have come, and subscribe what is wanted."""
        simulated = self._node.get_parameter('use_sim_time').value
        if not simulated and self._node.count_publishers('/clock'):
            self._node.set_parameters([Parameter('use_sim_time', value=True)])
        for topic, types in self._node.get_topic_names_and_types():
            # What the publishers offer must be known before it can be subscribed.
            if topic not in self._types and self._node.count_publishers(topic):
                self._offer(topic, types[0])
        for topic, type_name in self._types.items():
            self._match(topic, type_name)

    def _offer(self, topic: str, type_name: str) -> None:
        if type_name in SERVED and find_spec(type_name.partition('/')[0]):
            self._types[topic] = type_name
            self._shown[topic] = Shown(self._channel(topic, type_name))

    def _match(self, topic: str, type_name: str) -> None:
        """Have the subscription of a topic if it is wanted."""
        def receive(raw: bytes) -> None:
            self._pass_on(topic, raw)

        shown = self._shown[topic]
        wanted = topic == DIAGNOSTICS or shown.channel.has_sinks()
        if wanted and shown.subscription is None:
            shown.subscription = self._node.create_subscription(
                message_class(type_name), topic, receive, AS_OFFERED, raw=True)
        elif shown.subscription is not None and not wanted:
            self._node.destroy_subscription(shown.subscription)
            shown.subscription, shown.newest = None, b''

    def _pass_on(self, topic: str, raw: bytes) -> None:
        shown = self._shown[topic]
        shown.newest = raw
        shown.channel.log(raw, log_time=self.now())
        if topic == DIAGNOSTICS:
            robots = robots_of(deserialize(raw, TYPES[DIAGNOSTICS]))
            if robots:
                self._pass_on(CONSISTENCY, json.dumps(consistency(robots)).encode())
                self._pass_on(FRAMES, serialize(view_frames(self.now(), robots)))

    def _channel(self, topic: str, type_name: str) -> foxglove.Channel:
        text, _ = definition(type_name)
        schema = foxglove.Schema(name=type_name, encoding='ros2msg', data=text.encode())
        return foxglove.Channel(
            topic, message_encoding='cdr', schema=schema, context=self.context)


def main(host: str, port: int) -> int:
    """Serve until SIGINT or SIGTERM."""
    with ros([]) as stopped:
        node = Node('view')
        view = View(node)
        server = _serve(view, host, port)
        print(f'Foxglove: open ws://{host}:{server.port}', flush=True)
        executor = EventsExecutor()
        executor.add_node(node)
        try:
            while not stopped.is_set():
                executor.spin_once(TICK)
                server.broadcast_time(view.now())
        finally:
            server.stop()
            node.destroy_node()
    return 0


def _serve(view: View, host: str, port: int) -> WebSocketServer:
    try:
        return foxglove.start_server(
            name='fej_slam_ros', host=host, port=port, capabilities=[Capability.Time],
            server_listener=view, context=view.context)
    except RuntimeError as error:
        raise UserError(
            f'cannot serve at {host}, port {port} ({error}): give another --host or --port'
        ) from None
