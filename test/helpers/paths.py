# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Paths of the project."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
BAGS = ROOT / 'bags'
#: What the linters check, relative to ROOT.
SOURCES = 'setup.py', 'docs', 'fej_slam_ros', 'launch', 'test'
