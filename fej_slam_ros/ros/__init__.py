# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The edge to ROS: topics, messages, parameters, files, sessions and the nodes that run these."""
