# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS nodes: they declare parameters, pass messages to a session and publish its results."""
