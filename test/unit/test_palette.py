# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colour-blind readers can distinguish the colours."""

from itertools import combinations, product

import numpy as np
import pytest

from fej_slam_ros import palette

#: How colours in linear RGB look without red or without green cones: Viénot, Brettel and Mollon,
#: Digital video colourmaps for checking the legibility of displays by dichromats, 1999.
SEEN_BY = {
    'all cones': np.eye(3),
    'protanopia': np.array([
        [0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]),
    'deuteranopia': np.array([
        [0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]),
}
TEAM = (*palette.ROBOT_COLOURS, palette.LANDMARK_COLOUR, palette.NOT_JOINED_COLOUR)
#: Of the views in RViz and Foxglove, as their files have it.
GROUND = '#202020'


def linear(colour):
    """Return linear RGB, by the definition of sRGB."""
    values = np.array(palette.rgb(colour))
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def luminance(colour):
    return linear(colour) @ (0.2126, 0.7152, 0.0722)


def lab(rgb):
    """Return CIE L*a*b* of linear RGB under D65."""
    to_xyz = np.array([
        [0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(np.maximum(to_xyz @ rgb / (0.9505, 1.0, 1.089), 0.008856))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize(
    ('seen_by', 'pair'), product(SEEN_BY, combinations(TEAM, 2)),
    ids=lambda value: value if isinstance(value, str) else ' '.join(value))
def test_colours_of_six_robots_landmarks_and_separate_frames_differ(seen_by, pair):
    first, second = (lab(SEEN_BY[seen_by] @ linear(colour)) for colour in pair)

    # Side by side a difference of 2.3 is just seen; thin lines far apart need several times that.
    assert np.linalg.norm(first - second) > 10.0


@pytest.mark.parametrize('colour', [
    *palette.ROBOT_COLOURS, palette.LANDMARK_COLOUR, palette.NOT_JOINED_COLOUR])
def test_colours_contrast_with_the_background(colour):
    # WCAG 2.1, 1.4.11: parts of a picture that matter need a contrast of 3 to 1.
    assert (luminance(colour) + 0.05) / (luminance(GROUND) + 0.05) >= 3.0


def test_colours_repeat_after_the_last():
    colours = [palette.robot_colour(k) for k in range(2 * len(palette.ROBOT_COLOURS))]

    assert colours == [*palette.ROBOT_COLOURS, *palette.ROBOT_COLOURS]
