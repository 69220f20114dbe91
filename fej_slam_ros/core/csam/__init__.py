# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Collaborative smoothing and mapping: maps of robots that met become one, [Andersson]."""
