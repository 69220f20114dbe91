# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Process that publishes messages of robots from a bag and logs each sent message in a file.

Arguments: bag, rate of playing, log file, names of the robots. It prints "ready", reads the time
[s since 1970] at which the bag begins, and leaves out messages that are due before now.
"""

from pathlib import Path
import sys
from threading import Event
from time import time

from rclpy.node import Node

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.nodes.player import Player
from fej_slam_ros.ros.nodes.ros_process import ros


def due_from_now_on(messages, rate, begin):
    """Return when the first message is due that is not overdue, and the messages from it on."""
    first = messages[0].received
    now = first + (time() - begin) * rate * 1e9
    remaining = [message for message in messages if message.received >= now]
    return begin + (remaining[0].received - first) * 1e-9 / rate, remaining


def logged(messages, file):
    """Yield messages; log each when the next one is requested."""
    for message in messages:
        yield message
        file.write(f'{message.topic} {message.received}\n')


def main(bag, rate, sent, *robots):
    own = [m for m in bags.read(Path(bag)) if m.topic.partition('/')[0] in robots]
    with ros([]) as stopped, Path(sent).open('a', buffering=1, encoding='utf-8') as file:
        node = Node(f'robot_{robots[0]}')
        topics = {m.topic: m.type_name for m in own}
        player = Player(node, topics, (), rate, clock=False)
        player.wait_for_subscribers(stopped)
        sys.stdout.write('ready\n')
        sys.stdout.flush()
        begin = float(sys.stdin.readline())
        due, remaining = due_from_now_on(own, rate, begin)
        Event().wait(max(0.0, due - time()))
        player.play(logged(remaining, file), stopped)
        node.destroy_node()


if __name__ == '__main__':
    bag, rate, *rest = sys.argv[1:]
    main(bag, float(rate), *rest)
