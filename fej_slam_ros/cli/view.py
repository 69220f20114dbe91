# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Serve the running system to Foxglove: map, robots, ellipses, NIS, NEES and diagnostics.

In Foxglove (the desktop program or app.foxglove.dev) choose "Open connection", "Foxglove
WebSocket" and the address that this prints, then import the layout config/foxglove_layout.json.
Who can reach the address sees everything: there is no password.
"""

import argparse

from fej_slam_ros.errors import UsageError

PORT = 8765


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        '--host', default='127.0.0.1', metavar='ADDRESS',
        help='address to serve at; 0.0.0.0 is every address of this machine (default: 127.0.0.1)')
    parser.add_argument(
        '--port', type=_port, default=PORT, metavar='N',
        help=f'port to serve at; 0 is any that is free (default: {PORT})')


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM."""
    from fej_slam_ros.ros.nodes.foxglove import main

    return main(arguments.host, arguments.port)


def _port(word: str) -> int:
    if not word.isdecimal() or int(word) > 65535:
        raise UsageError(f'--port: {word} is not a whole number from 0 to 65535')
    return int(word)
