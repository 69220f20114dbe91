# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The topics that RViz and Foxglove are configured to show are published."""

import json
import re

import pytest
from ruamel.yaml import YAML

from fej_slam_ros import palette
from fej_slam_ros.ros.files.rviz_config import team_config
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.live_plots import CONSISTENCY, PLOTTED
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.paths import ROOT
from helpers.ros import run_settings

CONFIG = ROOT / 'config'
RVIZ = YAML(typ='safe').load(
    team_config(CONFIG / 'fej_slam.rviz', ['r1', 'r2'], '/', 'map'))['Visualization Manager']
LAYOUT = json.loads((CONFIG / 'foxglove_layout.json').read_text())
PANELS = LAYOUT['configById']
SHOWN_BY_RVIZ = {display['Name']: display for display in RVIZ['Displays']}
#: What a display of RViz takes.
TYPES = {
    'MarkerArray': 'visualization_msgs/msg/MarkerArray', 'Path': 'nav_msgs/msg/Path',
    'PointCloud2': 'sensor_msgs/msg/PointCloud2',
    'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped'}


def published():
    """Return the full names and types of what the nodes for r1 and r2 publish."""
    outputs = {
        'estimator': EstimatorSession(run_settings(), None).outputs.topics,
        'smoother': SmootherSession(run_settings(), None).outputs.topics,
        'detector': DetectorSession(DetectorSettings(('r1', 'r2'))).outputs}
    return {
        '/' + topic.lstrip('/').replace('~', node): type_name
        for node, topics in outputs.items() for topic, type_name in topics.items()}


def strings(tree):
    """Return every text in a tree of dictionaries and lists."""
    if isinstance(tree, str):
        return [tree]
    branches = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return [text for branch in branches for text in strings(branch)]


@pytest.mark.parametrize(
    'name', [name for name, display in SHOWN_BY_RVIZ.items() if 'Topic' in display])
def test_rviz_displays_match_type_and_qos_of_their_topics(name):
    display = SHOWN_BY_RVIZ[name]
    topic = display['Topic']

    assert published()[topic['Value']] == TYPES[display['Class'].partition('/')[2]]
    assert topic['Reliability Policy'] == 'Reliable'
    assert topic['Durability Policy'] == (
        'Transient Local' if topic['Value'].endswith('landmarks') else 'Volatile')


def test_rviz_shows_the_team_in_map_and_its_frames():
    on = {name for name, display in SHOWN_BY_RVIZ.items() if display['Enabled']}

    assert RVIZ['Global Options']['Fixed Frame'] == 'map'
    assert on == {'Grid of 10 m', 'Team (estimator)', 'Landmarks (estimator)', 'Frames'}


@pytest.mark.parametrize(('robot', 'place'), [('r1', 0), ('r2', 1)])
@pytest.mark.parametrize('kind', ['Pose', 'Path'])
def test_a_robot_has_the_same_colour_in_all_displays(robot, place, kind):
    colour = SHOWN_BY_RVIZ[f'{kind} of {robot}']['Color']

    shown = '#{:02x}{:02x}{:02x}'.format(*map(int, colour.split('; ')))
    assert shown == palette.ROBOT_COLOURS[place]


def test_rviz_and_foxglove_have_the_same_background():
    colour = RVIZ['Global Options']['Background Color']

    assert PANELS['3D!team']['scene']['backgroundColor'] == '#202020'
    assert [int(value) for value in colour.split('; ')] == 3 * [0x20]


def test_foxglove_draws_published_topics():
    assert PANELS['3D!team']['topics'].keys() <= published().keys()
    assert '/estimator/markers' in PANELS['3D!team']['topics']


def test_panels_and_layout_correspond_one_to_one():
    placed = [text for text in strings(LAYOUT['layout']) if '!' in text]

    assert sorted(placed) == sorted(PANELS)


@pytest.mark.parametrize('kind', ['nis', 'nees'])
def test_foxglove_plots_published_values_in_the_colours_of_the_robots(kind):
    lines = PANELS[f'Plot!{kind}']['paths']

    numbers = [
        re.fullmatch(rf'{CONSISTENCY}\.robots\[(\d)\]\.(\w+)', line['value']).groups()
        for line in lines]
    assert {name for _, name in numbers} == {kind, f'{kind}_low', f'{kind}_high'} < set(PLOTTED)
    assert [line['color'] for line in lines if line['label'].startswith('robot')] == [
        *palette.ROBOT_COLOURS]


@pytest.mark.parametrize('panel', ['DiagnosticSummary!all', 'DiagnosticStatusPanel!one'])
def test_foxglove_shows_diagnostics(panel):
    assert PANELS[panel]['topicToRender'] == '/diagnostics'
