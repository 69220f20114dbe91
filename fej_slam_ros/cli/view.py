# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Serve the running system to Foxglove: map, robots, ellipses, NIS, NEES and diagnostics.

In Foxglove (desktop or app.foxglove.dev) choose "Open connection", "Foxglove WebSocket" and the
printed address, then import the layout config/foxglove_layout.json. There is no password: everyone
who can reach the address has access.
"""

import argparse

from fej_slam_ros.cli.arguments import integer_option

#: Default port of Foxglove WebSocket servers.
DEFAULT_PORT = 8765


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--host', default='127.0.0.1', metavar='ADDRESS',
        help='address to listen on; 0.0.0.0: all of this machine (default: 127.0.0.1)')
    parser.add_argument(
        '--port', type=integer_option('--port', 0, 65535), default=DEFAULT_PORT, metavar='N',
        help=f'port to listen on; 0: any free port (default: {DEFAULT_PORT})')


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM."""
    from fej_slam_ros.ros.nodes.foxglove import main

    return main(arguments.host, arguments.port)
