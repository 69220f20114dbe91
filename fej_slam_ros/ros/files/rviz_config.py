# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Configurations of RViz for teams of any robots, in any namespace."""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from fej_slam_ros.palette import rgb, robot_colour

#: Robot whose displays in the template are repeated for each robot.
TEMPLATE_ROBOT = 'r1'


def team_config(template: Path, robots: Sequence[str], namespace: str, map_frame: str) -> str:
    """Return an RViz configuration for a team of robots in a namespace."""
    yaml = YAML()
    config = yaml.load(template)
    manager = config['Visualization Manager']
    manager['Global Options']['Fixed Frame'] = map_frame
    manager['Displays'] = list(_displays(manager['Displays'], robots))
    for shown in [*manager['Displays'], *manager['Tools']]:
        if 'Topic' in shown:
            shown['Topic']['Value'] = namespace.rstrip('/') + shown['Topic']['Value']
    text = StringIO()
    yaml.dump(config, text)
    return text.getvalue()


def _displays(displays: Sequence[Any], robots: Sequence[str]) -> Iterator[Any]:
    of_robot = [
        display for display in displays if _topic(display).startswith(f'/{TEMPLATE_ROBOT}/')]
    yield from (display for display in displays if display not in of_robot)
    for index, name in enumerate(robots):
        yield from (_robot_display(display, name, robot_colour(index)) for display in of_robot)


def _robot_display(template: Any, name: str, colour: str) -> Any:
    display = deepcopy(template)
    display['Name'] = template['Name'].replace(TEMPLATE_ROBOT, name)
    display['Topic']['Value'] = _topic(template).replace(TEMPLATE_ROBOT, name)
    for coloured in (display, display.get('Covariance', {}).get('Position', {})):
        if 'Color' in coloured:
            coloured['Color'] = '; '.join(str(round(255.0 * part)) for part in rgb(colour))
    return display


def _topic(display: Any) -> str:
    return str(display.get('Topic', {}).get('Value', ''))
