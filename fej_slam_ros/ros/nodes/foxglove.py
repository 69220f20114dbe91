# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""WebSocket server that shows the running system in Foxglove."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
import json
from time import monotonic

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, WebSocketServer
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import decoded, definition, serialize, stamp_of
from fej_slam_ros.ros.messages.outgoing import view_frames
from fej_slam_ros.ros.nodes.endpoints import is_installed, message_class
from fej_slam_ros.ros.nodes.parameter_node import CheckedClockNode
from fej_slam_ros.ros.nodes.ros_process import ros
from fej_slam_ros.ros.session.live_plots import (
    CONSISTENCY, consistency, FRAMES, PlottedNode, SCHEMA)
from fej_slam_ros.ros.topic_types import (
    DIAGNOSTICS_TOPIC, ODOMETRY, OUTPUT_TYPES, ROBOT_OUTPUT_TYPES, TF_TYPE)

#: Types of the served topics.
SERVED_TYPES = {*OUTPUT_TYPES.values(), *ROBOT_OUTPUT_TYPES.values(), ODOMETRY, TF_TYPE}
#: Period [s] of the check for new topics and for the subscriptions of clients.
TOPIC_CHECK_PERIOD = 0.2
#: Period [s] of the time sent to clients; 20 Hz looks smooth.
TIME_PERIOD = 0.05
#: Maximum number of topics that are offered, and size [bytes] of messages that are passed on: a
#: large map with its markers stays below 2 MB.
MAX_TOPICS = 1000
MAX_MESSAGE_SIZE = 4_000_000
#: Maximum number of messages that wait for each client; the oldest are dropped.
MAX_WAITING_MESSAGES = 256
#: Quality of service that adapts to the publishers.
AS_OFFERED = QoSProfile(
    depth=100, reliability=QoSReliabilityPolicy.BEST_AVAILABLE,
    durability=QoSDurabilityPolicy.BEST_AVAILABLE)


@dataclass
class ServedTopic:
    """A topic that is offered to clients."""

    channel: foxglove.Channel  #: through which clients receive it
    newest: bytes = b''  #: its last message, for clients that subscribe later
    subscription: Subscription | None = None  #: to the topic, while a client wants it
    is_incompatible: bool = False  #: whether a publisher does not fit the subscription


class View(ServerListener):
    """
    Passes messages on unchanged, and values of diagnostics as plain numbers.

    A topic is subscribed while a client wants it. The server drops messages for slow clients
    instead of waiting for them.

    """

    def __init__(self, node: CheckedClockNode) -> None:
        self.context = foxglove.Context()
        self._node = node
        self._types: dict[str, str] = {}
        self._plotted = PlottedNode()
        self._warnings: set[str] = set()
        self._follows_clock = False
        self._served = {
            CONSISTENCY: ServedTopic(
                foxglove.Channel(CONSISTENCY, schema=SCHEMA, context=self.context)),
            FRAMES: ServedTopic(self._channel(FRAMES, TF_TYPE))}
        node.create_steady_timer(TOPIC_CHECK_PERIOD, self._update)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send the newest message to a new client; called from a thread of the server."""
        served = self._served.get(channel.topic)
        if served is not None and served.newest:
            served.channel.log(served.newest, log_time=self.now(), sink_id=client.id)

    def now(self) -> int:
        """Return ROS time [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    def _update(self) -> None:
        self._follow_clock()
        for topic, types in self._node.get_topic_names_and_types():
            # A subscription adapts to the publishers that exist when it is created.
            if topic not in self._served and self._node.count_publishers(topic):
                self._offer(topic, types)
        for topic, type_name in self._types.items():
            self._match(topic, type_name)

    def _follow_clock(self) -> None:
        """Use simulated time while it is published, unless the user has decided."""
        is_simulated = bool(self._node.get_parameter('use_sim_time').value)
        has_clock = self._node.count_publishers('/clock') > 0
        if has_clock != is_simulated and (has_clock or self._follows_clock):
            self._node.set_parameters([Parameter('use_sim_time', value=has_clock)])
            self._follows_clock = has_clock

    def _offer(self, topic: str, types: Sequence[str]) -> None:
        # Another node may publish a topic of the same name with a type of its own.
        known = [name for name in types if name in SERVED_TYPES and is_installed(name)]
        if known and len(self._served) >= MAX_TOPICS:
            self._warn(f'only {MAX_TOPICS} topics are offered: use a ROS domain of fewer topics')
        elif known:
            self._types[topic] = known[0]
            self._served[topic] = ServedTopic(self._channel(topic, known[0]))

    def _match(self, topic: str, type_name: str) -> None:
        def note_incompatible(_: object) -> None:
            served.is_incompatible = True

        served = self._served[topic]
        wanted = topic == DIAGNOSTICS_TOPIC or served.channel.has_sinks()
        if served.subscription is not None and (served.is_incompatible or not wanted):
            self._node.destroy_subscription(served.subscription)
            served.subscription, served.newest, served.is_incompatible = None, b'', False
        # Later publishers may offer less: a new subscription adapts to them, too.
        if wanted and served.subscription is None:
            served.subscription = self._node.create_subscription(
                message_class(type_name), topic, partial(self._pass_on, topic), AS_OFFERED,
                raw=True, event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=note_incompatible))

    def _pass_on(self, topic: str, raw: bytes) -> None:
        if len(raw) > MAX_MESSAGE_SIZE:
            self._warn(
                f'messages on {topic} above {MAX_MESSAGE_SIZE / 1e6:g} MB are not passed on')
            return
        served = self._served[topic]
        served.newest = raw
        served.channel.log(raw, log_time=self.now())
        if topic == DIAGNOSTICS_TOPIC:
            self._plot(raw)

    def _plot(self, raw: bytes) -> None:
        """Pass on the values of diagnostics of an estimator as numbers."""
        report = decoded(raw, OUTPUT_TYPES[DIAGNOSTICS_TOPIC])
        if report is None:
            self._warn(f'messages on {DIAGNOSTICS_TOPIC} that cannot be decoded are not plotted')
            return
        robots = self._plotted.robots_of(report, monotonic())
        if robots:
            # Where the clock goes on from simulated to real time, the plot must not. Foxglove has
            # no negative time.
            at = max(0, stamp_of(raw))
            self._served[CONSISTENCY].channel.log(
                json.dumps(consistency(robots)).encode(), log_time=at)
            self._pass_on(FRAMES, serialize(view_frames(self.now(), robots)))
        for name in self._plotted.take_ignored():
            self._warn(f'{name} reports robots too, but {self._plotted.name} is plotted')

    def _warn(self, text: str) -> None:
        """Log a warning once."""
        if text not in self._warnings:
            self._warnings.add(text)
            self._node.get_logger().warning(text)

    def _channel(self, topic: str, type_name: str) -> foxglove.Channel:
        text, _ = definition(type_name)
        schema = foxglove.Schema(name=type_name, encoding='ros2msg', data=text.encode())
        return foxglove.Channel(
            topic, message_encoding='cdr', schema=schema, context=self.context)


def main(host: str, port: int) -> int:
    """Serve until SIGINT or SIGTERM."""
    with ros([]) as stopped:
        node = CheckedClockNode('view')
        view = View(node)
        server = _serve(view, host, port)
        print(f'Foxglove: open ws://{host}:{server.port}', flush=True)
        executor = EventsExecutor()
        executor.add_node(node)
        try:
            while not stopped.is_set():
                executor.spin_once(TIME_PERIOD)
                server.broadcast_time(view.now())
        finally:
            server.stop()
            node.destroy_node()
    return 0


def _serve(view: View, host: str, port: int) -> WebSocketServer:
    try:
        return foxglove.start_server(
            name='fej_slam_ros', host=host, port=port, capabilities=[Capability.Time],
            server_listener=view, context=view.context, message_backlog_size=MAX_WAITING_MESSAGES)
    except RuntimeError as error:
        raise UserError(
            f'cannot serve at {host}, port {port} ({error}): give another --host or --port'
        ) from None
