# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Content of a figure, by its PNG and its SVG."""

from io import BytesIO
import re
import struct

import matplotlib as mpl
import numpy as np


def png_size(draw, *what):
    """Return width and height of a picture."""
    file = BytesIO()
    draw(file, *what)
    assert file.getvalue().startswith(b'\x89PNG\r\n\x1a\n')
    return struct.unpack('>II', file.getvalue()[16:24])


def svg(draw, *what):
    """Return a picture in SVG, with words as words."""
    file = BytesIO()
    with mpl.rc_context({'savefig.format': 'svg', 'svg.fonttype': 'none'}):
        draw(file, *what)
    return file.getvalue().decode()


def words(picture):
    return re.findall(r'<text[^>]*>([^<]*)</text>', picture)


def paths(picture, style):
    """Return the points (n, 2) of the paths of a style, panel by panel; the legend is the last."""
    return [
        np.array(re.findall(r'[ML] (\S+) (\S+)', points), dtype=float)
        for points, its in re.findall(r'<path d="([^"]*)"[^>]* style="([^"]*)"', picture)
        if re.search(style, its)]
