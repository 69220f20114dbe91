# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of one run against ground truth: errors, consistency, figures."""
