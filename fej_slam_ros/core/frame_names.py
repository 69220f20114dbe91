# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the frames that estimates are in, REP-105."""

#: The frame of the team; a robot that is not part of it yet has a frame of its own.
MAP = 'map'


def own_frame(robot: str) -> str:
    """Return the name of the frame of a robot that is not in ``map`` yet."""
    return f'{robot}/map'
