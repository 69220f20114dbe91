# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where the project's files are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
BAGS = ROOT / 'bags'
