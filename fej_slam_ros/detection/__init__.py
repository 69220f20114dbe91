# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks from raw sensor data: posts in scans of planar lasers; arrays in, observations out."""
