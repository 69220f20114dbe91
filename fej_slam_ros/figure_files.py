# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as files."""

from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure


def save(file: BinaryIO, figure: Figure, legend_of: Axes, columns: int) -> None:
    """Write a figure as a PNG, with the legend of one of its axes below all of them."""
    # Beyond the edge, which is moved there; places outside axes have no names in matplotlib 3.6,
    # which Ubuntu 24.04 has.
    figure.legend(
        *legend_of.get_legend_handles_labels(), loc='upper center', bbox_to_anchor=(0.5, 0.0),
        ncols=columns)
    figure.savefig(file, dpi=110, bbox_inches='tight')
