# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of poses and landmarks in the text files of g2o, TORO, iSAM and GTSAM."""
