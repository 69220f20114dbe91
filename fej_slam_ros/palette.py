# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colours that people tell apart however they see colours: those of Okabe and Ito."""

#: Of robots, in their order.
ROBOTS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9')
#: Of landmarks in ``map``, on a dark ground.
LANDMARKS = '#f0e442'
#: Of names, there, too.
NAMES = '#ffffff'
#: Of what has no place in ``map`` yet.
NOT_JOINED = '#808080'


def robot_colour(index: int) -> str:
    """Return the colour of the robot at a place in the order of robots."""
    return ROBOTS[index % len(ROBOTS)]


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red / 255.0, green / 255.0, blue / 255.0
