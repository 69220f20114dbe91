# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The configuration of RViz shows every robot of a team, whatever the names."""

import re

import pytest
from ruamel.yaml import YAML

from fej_slam_ros.ros.files.rviz_config import team_config
from helpers.paths import ROOT

TEMPLATE = ROOT / 'config' / 'fej_slam.rviz'


def topics(text):
    return re.findall(r'^ +Value: (/.*)$', text, re.MULTILINE)


@pytest.mark.parametrize('robots', [[], ['left'], ['a', 'r1', 'atlas_3']])
def test_each_robot_has_its_displays_and_no_other_robot_has(robots):
    shown = topics(team_config(TEMPLATE, robots, '/', 'map'))

    kinds = '/pose', '/path', '/detection_markers'
    assert [topic for topic in shown if topic.endswith(kinds)] == [
        f'/{name}{kind}' for name in robots for kind in kinds]
    assert '/estimator/markers' in shown


def test_all_topics_move_into_the_namespace():
    outside = topics(team_config(TEMPLATE, ['a', 'b'], '/', 'map'))

    assert topics(team_config(TEMPLATE, ['a', 'b'], '/fleet', 'map')) == [
        f'/fleet{topic}' for topic in outside]


def test_the_fixed_frame_is_that_of_the_map():
    config = YAML(typ='safe').load(team_config(TEMPLATE, ['a'], '/', 'world'))

    assert config['Visualization Manager']['Global Options']['Fixed Frame'] == 'world'


def test_robots_have_different_colours():
    config = YAML(typ='safe').load(team_config(TEMPLATE, ['a', 'b', 'c'], '/', 'map'))

    displays = config['Visualization Manager']['Displays']
    colours = [display['Color'] for display in displays if 'Path of' in display['Name']]
    assert len(set(colours)) == 3
    assert all(re.fullmatch(r'\d+; \d+; \d+', colour) for colour in colours)


def test_the_rest_is_as_in_the_template():
    config, template = (
        YAML(typ='safe').load(text)
        for text in (team_config(TEMPLATE, ['r1'], '/', 'map'), TEMPLATE))

    assert config == template
