# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator: numpy, scipy and the standard library; no I/O, clock, logging or randomness."""
