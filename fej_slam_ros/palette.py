# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colours that colour-blind readers can distinguish too, by Okabe and Ito."""

#: Of robots, in their order.
ROBOT_COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9')
#: Lines that distinguish curves of the same colour, where there are more than colours.
LINE_STYLES = ('-', '--', ':', '-.')
#: Of landmarks in ``map``, on a dark background.
LANDMARK_COLOUR = '#f0e442'
#: Of robots' names, on a dark background.
NAME_COLOUR = '#ffffff'
#: Of everything that has not joined ``map``.
NOT_JOINED_COLOUR = '#808080'


def robot_colour(index: int) -> str:
    """Return the colour of the robot with an index in the order of robots."""
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def line_style(index: int) -> tuple[str, str]:
    """Return the colour and the line of the curve with an index, in a figure of many."""
    line = LINE_STYLES[index // len(ROBOT_COLOURS) % len(LINE_STYLES)]
    return robot_colour(index), line


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red / 255.0, green / 255.0, blue / 255.0
