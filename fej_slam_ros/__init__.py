# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
SLAM for a team of robots with first-estimate Jacobians.

References
----------
[Liu] Liu, Song, Huang, First Estimate Jacobian EKF for Multi-robot SLAM.
[Andersson] Andersson, Nygards, C-SAM: Multi-Robot SLAM using Square Root Information Smoothing,
ICRA 2008.

"""

__version__ = '1.1.0'
