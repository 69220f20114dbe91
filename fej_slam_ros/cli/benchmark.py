# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the speed of the filter beside this machine's own limits.

One process, one BLAS thread.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        '--output', type=Path, metavar='FILE.json', help='also write the figures as JSON')


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    raise NotImplementedError
