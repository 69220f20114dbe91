# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strategies of hypothesis for settings: every combination that parameters allow."""

from ast import literal_eval
from dataclasses import fields, replace

from fej_slam_ros.core.parameter_kinds import FRAME, parameters_of, PATH, TEXT
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.parameters import NodeSettings, RESERVED_NAMES, RunSettings
from helpers.optional import strategies as st

LINES = st.text(st.characters(codec='utf-8', exclude_categories=('Cc', 'Cn', 'Zl', 'Zp')))
FRAMES = st.from_regex('[a-z][a-z_/]{0,9}', fullmatch=True)
# Names that YAML or ROS could misinterpret.
TRICKY_NAMES = ['no', 'on', 'true', 'null', 'nan', 'e5', 'fej', 'qos_overrides', 'ros__parameters']
NAMES = st.sampled_from(TRICKY_NAMES) | st.from_regex(
    '[A-Za-z][A-Za-z0-9_]{0,20}', fullmatch=True
).filter(lambda name: name not in RESERVED_NAMES)

#: Parameters of known starts, which an anchor has not; those of a smoother with peers, which is
#: left out; and others that depend on the names of robots or frames.
START = {'start_pose', 'start_sigma'}
OF_PEERS = {'peers', 'exchange_file'}
DEPENDENT = {'robots', 'anchor', 'initialpose_robot', 'relative_poses', 'odom_frame', 'map_frame'}


def of_kind(kind):
    """Return the strategy of values as settings store them."""
    if kind is TEXT:
        element = LINES
    elif kind is PATH:
        element = LINES.filter(lambda line: not line.startswith('~'))
    elif kind is FRAME:
        element = FRAMES
    elif kind.element is bool:
        element = st.booleans()
    elif kind.element is str:
        element = st.sampled_from(literal_eval(kind.expected.removeprefix('one of ')))
    elif kind.element is int:
        element = st.integers(kind.within.low, kind.within.high)
    else:
        element = st.floats(
            kind.within.low, kind.within.high, exclude_min=kind.within.excludes_low)
    return st.tuples(*[element] * kind.shape[0]) if kind.shape else element


def parameters(settings):
    """Return the strategies of the independent parameters that some settings declare."""
    optional = {field.name for field in fields(settings) if field.default is None}
    return {
        name: st.none() | of_kind(p.kind) if name in optional else of_kind(p.kind)
        for name, p in parameters_of(settings).items()
        if name not in START | OF_PEERS | DEPENDENT}


ROBOTS = st.builds(RobotSettings, name=NAMES, **parameters(RobotSettings))
UNIQUE = (lambda robot: robot.name, lambda robot: robot.id)
STARTS = st.fixed_dictionaries({
    name: of_kind(p.kind) for name, p in parameters_of(RobotSettings).items() if name in START})


@st.composite
def valid_settings(draw):
    """Draw settings of a run that parameters allow."""
    first, *others = draw(st.lists(ROBOTS, min_size=1, max_size=4, unique_by=UNIQUE))
    started = [replace(robot, **draw(STARTS)) for robot in others]
    team = draw(st.permutations([first, *draw(st.sampled_from([others, started]))]))
    estimation = draw(st.builds(
        Settings, robots=st.just(tuple(team)), anchor=st.just(first.name),
        initialpose_robot=st.sampled_from(['', *(robot.name for robot in team)]),
        **parameters(Settings)))
    node = draw(st.builds(
        NodeSettings, map_frame=st.sampled_from(['map', 'world']), **parameters(NodeSettings)))
    if node.prior_landmarks:
        estimation = replace(
            estimation, shared_landmark_ids=True, anchor=draw(st.sampled_from([first.name, ''])))
    if node.checkpoint in {'', node.prior_landmarks}:
        node = replace(node, checkpoint='', autosave_period=0.0)
    return RunSettings(estimation, node)
