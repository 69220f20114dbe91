# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Draw the messages of a live view with matplotlib: python test/draw_view.py docs/view.png.

A simulated world, the estimator and the view run as processes. The messages come over the
WebSocket and are drawn with the shapes, sizes and colours of the markers and the paths in the
layout.
"""

import json
from pathlib import Path
import sys
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from helpers.foxglove_client import FoxgloveClient
from helpers.live import Domain
from helpers.paths import ROOT

MARKER = ros.visualization_msgs__msg__Marker
MARKERS, NUMBERS = '/estimator/markers', '/view/consistency'
LAYOUT = json.loads(
    (ROOT / 'config' / 'foxglove_layout.json').read_text())['configById']
GROUND, INK = LAYOUT['3D!team']['scene']['backgroundColor'], '#e0e0e0'


def watched():
    """Return the markers and the values to plot that a client receives of a simulated world."""
    with Domain() as domain, TemporaryDirectory() as folder:
        path = Path(folder) / 'parameters.yaml'
        path.write_text(json.dumps({
            'simulator': {'ros__parameters': {'clock': True, 'speed': 4.0}},
            'estimator': {'ros__parameters': {
                'robots': ['r1', 'r2'], 'use_sim_time': True, 'map_period': 0.2}}}))
        url = domain.start('view', '--port', '0').stdout.readline().split()[-1]
        domain.start('estimator', '--ros-args', '--params-file', path)
        client = FoxgloveClient(url)
        domain.until(lambda: client.sees(MARKERS))
        client.subscribe(MARKERS, NUMBERS)
        simulator = domain.start('simulator', '--ros-args', '--params-file', path)
        domain.until(lambda: (client.got(NUMBERS), simulator.poll())[1] is not None)
        client.close()
    return client.decoded(MARKERS), [
        (stamp * 1e-9, values) for (stamp, _), values in zip(
            client.received[NUMBERS], client.decoded(NUMBERS))]


def draw(path, markers, numbers):
    figure = Figure(figsize=(13.0, 8.0), layout='constrained', facecolor=GROUND)
    parts = figure.subplot_mosaic([['team', 'nis'], ['team', 'nees']], width_ratios=[3, 4])
    for axes in parts.values():
        axes.set_facecolor(GROUND)
        axes.tick_params(colors=INK)
        axes.grid(alpha=0.2)
        for spine in axes.spines.values():
            spine.set_color(INK)
    for marker in markers:
        if marker.action == MARKER.ADD:
            draw_marker(parts['team'], marker)
    parts['team'].set(aspect='equal')
    parts['team'].set_title('3D panel, from above [m]', color=INK)
    for kind in ('nis', 'nees'):
        draw_plot(parts[kind], LAYOUT[f'Plot!{kind}'], numbers)
    figure.savefig(path, dpi=90)


def draw_marker(axes, marker):
    colour = (marker.color.r, marker.color.g, marker.color.b)
    x, y = marker.pose.position.x, marker.pose.position.y
    q = marker.pose.orientation
    heading = 2.0 * np.arctan2(q.z, q.w)
    along = np.array([(p.x, p.y) for p in marker.points])
    if marker.type == MARKER.ARROW:
        dx, dy = marker.scale.x * np.cos(heading), marker.scale.x * np.sin(heading)
        axes.arrow(
            x, y, dx, dy, color=colour, length_includes_head=True, width=0.5 * marker.scale.y,
            head_width=2.0 * marker.scale.y, zorder=3)
    elif marker.type == MARKER.TEXT_VIEW_FACING:
        axes.annotate(
            marker.text, (x, y), color=colour, fontsize=14, ha='center', va='center')
    elif marker.type == MARKER.LINE_STRIP:
        axes.plot(*along.T, color=colour, linewidth=1.0)
    elif marker.type == MARKER.POINTS:
        axes.plot(*along.T, 'o', markersize=3, color=colour)
    elif marker.type == MARKER.CYLINDER:
        axes.add_patch(Ellipse(
            (x, y), marker.scale.x, marker.scale.y, angle=np.degrees(heading), color=colour,
            alpha=marker.color.a))


def draw_plot(axes, panel, numbers):
    for line in panel['paths']:
        _, place, name = line['value'].replace('[', '.').replace(']', '').rsplit('.', 2)
        points = [
            (at, robots[int(place)][name]) for at, robots in (
                (at, values['robots']) for at, values in numbers)
            if int(place) < len(robots) and name in robots[int(place)]]
        if points:
            axes.plot(
                *zip(*points), color=line['color'], label=line['label'],
                linewidth=line['lineSize'], linestyle='--' if 'lineStyle' in line else '-')
    axes.set_title(panel['title'], color=INK)
    axes.set_xlabel('time [s]', color=INK)
    axes.set_ylim(panel['minYValue'])
    axes.legend(
        facecolor=GROUND, labelcolor=INK, loc='upper left', bbox_to_anchor=(1.0, 1.0))


if __name__ == '__main__':
    marker_arrays, plotted = watched()
    draw(sys.argv[1], marker_arrays[-1].markers, plotted)
