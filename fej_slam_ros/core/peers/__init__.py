# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""C-SAM between robots: logs of measurements that robots in reach give each other."""
