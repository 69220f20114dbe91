# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a run are complete and free of contradictions, or an error of one sentence."""

import re

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import parse


def test_a_robot_without_noise_of_its_own_has_that_of_the_team():
    own, inherited = parse(
        {
            'robots': ['r1', 'r2'],
            'odometry_sigma': [0.1, 0.2, 0.3],
            'landmark_sigma': [0.4, 0.5],
            'odometry_noise_scale': 2.0,
            'r1.odometry_sigma': [0.6, 0.7, 0.8],
            'r1.landmark_sigma': [0.9, 1.0],
            'r1.odometry_noise_scale': 3.0,
        }
    ).estimation.robots
    assert (own.odometry_sigma, own.landmark_sigma) == ((0.6, 0.7, 0.8), (0.9, 1.0))
    assert (inherited.odometry_sigma, inherited.landmark_sigma) == ((0.1, 0.2, 0.3), (0.4, 0.5))
    assert (own.odometry_noise_scale, inherited.odometry_noise_scale) == (3.0, 2.0)


@pytest.mark.parametrize(
    ('wrong', 'sentence'),
    [
        (
            {'robots': []},
            ("parameter 'robots' is missing or empty: list the robots, for example [r1, r2];"
             ' of a parameter file, only the sections for this node and /** count'),
        ),
        (
            {'robots': ['r1', 'r1']},
            "parameter 'robots' contains 'r1' twice: give each robot its own name",
        ),
        (
            {'anchor': 'r3'},
            "parameter 'anchor' must be one of 'r1', 'r2', '', not 'r3'",
        ),
        (
            {'filter': 'ekf'},
            "parameter 'filter' must be one of 'fej', 'invariant', 'standard', 'ideal', not 'ekf'",
        ),
        (
            {'update_iterations': 101},
            "parameter 'update_iterations' must be an integer from 0 to 100, not 101",
        ),
        (
            {'start_covariance': 'exact'},
            "parameter 'start_covariance' must be one of 'anchored', 'independent', not 'exact'",
        ),
        (
            {'r1.id': 2},
            "parameters 'r1.id' and 'r2.id' are both 2: give each robot its own",
        ),
        (
            {'r2.start_sigma': [0, 0, 0]},
            "parameter 'r2.start_sigma' needs a start: give 'r2.start_pose' too",
        ),
        (
            {'autosave_period': 5.0},
            "parameter 'autosave_period' needs a file: give 'checkpoint' too",
        ),
        (
            {'prior_landmarks': 'survey.csv', 'shared_landmark_ids': False},
            (
                "parameter 'prior_landmarks' needs IDs that all robots share: leave out "
                "'shared_landmark_ids'"
            ),
        ),
        (
            {'prior_landmarks': 'run', 'checkpoint': 'run'},
            "parameters 'prior_landmarks' and 'checkpoint' are one file: save to another one",
        ),
        (
            {'anchor': ''},
            (
                "parameter 'anchor' is empty, so that the frame map is undefined: name a robot, "
                "or give 'prior_landmarks'"
            ),
        ),
        (
            {'robots': ['r1', 'ground_truth']},
            "parameter 'robots' contains the reserved name 'ground_truth': choose another",
        ),
        (
            {'r1.start_pose': [0, 0, 0]},
            (
                "parameter 'r1.start_pose' is for robots other than the anchor: "
                "give 'anchor_pose' instead"
            ),
        ),
        (
            {'anchor': 'r2', 'r2.start_sigma': [0, 0, 0]},
            (
                "parameter 'r2.start_sigma' is for robots other than the anchor: "
                "give 'anchor_sigma' instead"
            ),
        ),
    ],
)
def test_a_mistake_is_explained_in_one_sentence(wrong, sentence):
    with pytest.raises(UsageError, match=f'^{re.escape(sentence)}$'):
        parse({'robots': ['r1', 'r2'], **wrong})


@pytest.mark.parametrize(
    ('given', 'reason'),
    [
        ({'map_frame': 'r2/map'}, "'map_frame' is 'r2/map', the frame of r2 until it has joined"),
        ({'r1.odom_frame': 'map'}, "'r1.odom_frame' is 'map', the name of a map or base frame"),
        ({'map_frame': 'odom', 'r1.odom_frame': 'odom'}, 'the name of a map or base frame'),
        ({'r1.odom_frame': 'r1/map'}, 'the name of a map or base frame'),
        ({'r1.odom_frame': 'base', 'r1.base_frame': 'base'}, 'the name of a map or base frame'),
        ({'r1.odom_frame': 'odom', 'r2.odom_frame': 'odom'}, "set tf_topics to 'robot'"),
        ({'r1.odom_frame': '/odom'}, "must be a frame name without spaces and leading '/'"),
        ({'map_frame': ''}, 'must be a frame name'),
    ],
)
def test_frames_that_form_no_tree_are_refused(given, reason):
    with pytest.raises(UsageError, match=re.escape(reason)):
        parse({'robots': ['r1', 'r2'], **given})
