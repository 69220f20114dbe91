# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic worlds; every draw comes from a numpy Generator that is passed in."""
