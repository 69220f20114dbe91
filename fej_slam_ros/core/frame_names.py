# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the frames of estimates, REP-105."""

#: Frame of the team; a robot that has not joined it has a frame of its own.
MAP = 'map'


def own_frame(robot: str) -> str:
    """Return the frame of a robot that has not joined ``map``."""
    return f'{robot}/map'
