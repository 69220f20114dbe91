# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic worlds and measurements; all randomness comes from a numpy Generator passed in."""
