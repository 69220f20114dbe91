# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Elements of figures: styles of filters, covariance ellipses, logarithmic axes."""

import math
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import LogLocator, NullLocator

from fej_slam_ros.core.geometry import Array, ellipse

TRUTH_COLOUR = '#555555'


class FilterStyle(NamedTuple):
    """Legend label, colour, line and marker of a filter."""

    label: str
    colour: str
    line: str
    marker: str


#: By the filter's name, in colours that differ for any colour vision.
FILTER_STYLES = {
    'standard': FilterStyle('standard EKF', '#c8501e', '-', 's'),
    'fej': FilterStyle('FEJ-EKF', '#1f5fbf', '-', 'o'),
    'ideal': FilterStyle('ideal EKF', TRUTH_COLOUR, '--', 'x'),
    'invariant': FilterStyle('invariant EKF', '#56b4e9', '-', 'D'),
}


def draw_ellipses(axes: Axes, x: Array, P: Array, colour: str, sigmas: float) -> None:
    """Draw covariances P (n, d, d) of poses or points x (n, d) as position ellipses of sigmas."""
    for (x_k, y_k), P_k in zip(x[:, :2], P[:, :2, :2]):
        major, minor, angle = ellipse(P_k)
        axes.add_patch(Ellipse(
            (x_k, y_k), 2.0 * sigmas * major, 2.0 * sigmas * minor, angle=math.degrees(angle),
            fill=False, edgecolor=colour, linewidth=0.8, alpha=0.8))


def scale_by_logarithm(axes: Axes) -> None:
    """Give the y axis a logarithmic scale with ticks in plain numbers."""
    axes.set_yscale('log')
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_locator(NullLocator())
