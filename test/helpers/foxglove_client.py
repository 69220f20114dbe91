# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Client of a live view that speaks the public protocol of Foxglove."""

from contextlib import ExitStack, suppress
import json
from socket import create_connection
import struct
from urllib.parse import urlsplit

import numpy as np
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

PROTOCOL = 'foxglove.sdk.v1'
#: First byte of the binary messages, and what follows before the payload, little-endian.
MESSAGE_DATA, TIME = 1, 2
MESSAGE_HEADER, TIME_HEADER = struct.Struct('<xIQ'), struct.Struct('<xQ')


class FoxgloveClient:
    """
    A connection to a server.

    Attributes
    ----------
    server_info : description that the server sends
    channels : its topics, by name
    received : time [ns] and bytes of each received message, by topic
    times : times that the server has sent [ns]

    """

    def __init__(self, url):
        self._stack = ExitStack()
        # Pings would end a client that reads nothing.
        self._socket = self._stack.enter_context(_connected(url))
        assert self._socket.subprotocol == PROTOCOL
        self.server_info = json.loads(self._socket.recv())
        self.channels, self.received, self.times = {}, {}, []

    def close(self):
        self._stack.close()

    def sees(self, topic):
        """Return whether a topic is offered."""
        self._take()
        return topic in self.channels

    def subscribe(self, *topics):
        """Subscribe to topics that are offered."""
        for topic in topics:
            number = self.channels[topic]['id']
            self.received[topic] = []
            self._socket.send(json.dumps(
                {'op': 'subscribe', 'subscriptions': [{'id': number, 'channelId': number}]}))

    def got(self, topic, count=1):
        """Return whether `count` messages of a topic have been received."""
        self._take()
        return len(self.received[topic]) >= count

    def decoded(self, topic):
        """Return the messages of a topic, decoded by their schema."""
        channel = self.channels[topic]
        if channel['encoding'] == 'json':
            return [json.loads(raw) for _, raw in self.received[topic]]
        assert (channel['encoding'], channel['schemaEncoding']) == ('cdr', 'ros2msg')
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(channel['schema'], channel['schemaName']))
        return [
            store.deserialize_cdr(raw, channel['schemaName']) for _, raw in self.received[topic]]

    def _take(self):
        """Store the messages that have arrived."""
        with suppress(TimeoutError):
            while True:
                message = self._socket.recv(timeout=0.0)
                if isinstance(message, str):
                    self._take_text(json.loads(message))
                elif message[0] == MESSAGE_DATA:
                    number, stamp = MESSAGE_HEADER.unpack_from(message)
                    topic, = (t for t, c in self.channels.items() if c['id'] == number)
                    self.received[topic].append((stamp, message[MESSAGE_HEADER.size:]))
                elif message[0] == TIME:
                    self.times += TIME_HEADER.unpack(message)

    def _take_text(self, message):
        if message['op'] == 'advertise':
            self.channels |= {channel['topic']: channel for channel in message['channels']}


def send_garbage(url, channel, seed):
    """Send to a server what no client should, each on a connection of its own, and leave."""
    rng = np.random.default_rng(seed)
    subscribe = json.dumps({'op': 'subscribe', 'subscriptions': [
        {'id': 1, 'channelId': channel}, {'id': 1, 'channelId': channel},
        {'id': 2, 'channelId': 4_000_000_000}]})
    texts = [
        '', '{', '[]', 'null', '{"op": "unknown"}', '{"op": 7}', '{"op": "subscribe"}',
        subscribe, subscribe, '{"op": "unsubscribe", "subscriptionIds": [9]}',
        '{"op": "subscribe", "subscriptions": "x"}', '[' * 100_000, 'x' * 1_000_000,
        '{"op": "advertise", "channels": [{"id": 1, "topic": "/r1/pose"}]}',
        '{"op": "getParameters", "parameterNames": ["a"]}', '{"op": "fetchAsset", "uri": "/etc"}']
    binary = [b'', b'\x00', b'\x01', bytes(range(256)), *(rng.bytes(n) for n in (1, 13, 4000))]
    for content in [*texts, *binary]:
        with suppress(ConnectionClosed), _connected(url) as socket:
            socket.send(content)
    # Before, and in the middle of, the handshake and a frame.
    address = urlsplit(url).hostname, urlsplit(url).port
    for content in (b'', b'GET /', rng.bytes(2000), b'GET / HTTP/1.1\r\n\r\n'):
        with create_connection(address) as plain:
            plain.sendall(content)
    with _connected(url) as socket:
        socket.socket.sendall(b'\x82\xfe\x40\x00half')
        socket.socket.close()


def _connected(url):
    return connect(
        url, subprotocols=[PROTOCOL], max_size=None, compression=None, ping_interval=None,
        close_timeout=0.2)
