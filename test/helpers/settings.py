# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strategies of hypothesis for settings: every combination that parameters allow."""

from dataclasses import replace

from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.parameters import NodeSettings, RESERVED_NAMES, RunSettings
from helpers.optional import strategies as st

NUMBERS = st.floats(-1e9, 1e9)
NOT_NEGATIVE = st.floats(0.0, 1e6)
POSITIVE = st.floats(1e-6, 1e6)
POSES = st.tuples(NUMBERS, NUMBERS, NUMBERS)
PERIOD = st.floats(0.01, 1e6)
POSE_SIGMAS = st.tuples(NOT_NEGATIVE, NOT_NEGATIVE, NOT_NEGATIVE)
POINT_SIGMAS = st.tuples(POSITIVE, POSITIVE)
SCALES = st.floats(1e-3, 1e3)
ODOMETRY_SCALES = st.tuples(st.floats(0.1, 10.0), st.floats(0.1, 10.0))
TURN_BIASES = st.floats(-10.0, 10.0)
RANGE_SCALES, BEARING_BIASES = st.floats(0.1, 10.0), st.floats(-3.2, 3.2)
LINES = st.text(st.characters(codec='utf-8', exclude_categories=('Cc', 'Cn', 'Zl', 'Zp')))
# Names that YAML or ROS could misinterpret.
TRICKY_NAMES = ['no', 'on', 'true', 'null', 'nan', 'e5', 'fej', 'qos_overrides', 'ros__parameters']
NAMES = st.sampled_from(TRICKY_NAMES) | st.from_regex(
    '[A-Za-z][A-Za-z0-9_]{0,20}', fullmatch=True
).filter(lambda name: name not in RESERVED_NAMES)
ROBOTS = st.builds(
    RobotSettings,
    name=NAMES,
    id=st.integers(0, 2**31 - 1),
    sensor_pose=POSES,
    max_speed=POSITIVE,
    max_turn_rate=POSITIVE,
    sensor_frame=st.none() | LINES,
    base_frame=st.none() | st.from_regex('[a-z][a-z_/]{0,9}', fullmatch=True),
    odometry_sigma=POSE_SIGMAS,
    landmark_sigma=POINT_SIGMAS,
    odometry_scale=ODOMETRY_SCALES,
    odometry_turn_bias=TURN_BIASES,
    observation_range_scale=RANGE_SCALES,
    observation_bearing_bias=BEARING_BIASES,
    odometry_noise_scale=SCALES,
    landmark_noise_scale=SCALES,
    robot_noise_scale=SCALES,
)
UNIQUE = (lambda robot: robot.name, lambda robot: robot.id)


@st.composite
def valid_settings(draw):
    """Draw settings of a run that parameters allow."""
    first, *others = draw(st.lists(ROBOTS, min_size=1, max_size=4, unique_by=UNIQUE))
    started = [replace(r, start_pose=draw(POSES), start_sigma=draw(POSE_SIGMAS)) for r in others]
    prior = draw(LINES)
    robots = draw(st.permutations([first, *draw(st.sampled_from([others, started]))]))
    estimation = Settings(
        robots=tuple(robots),
        anchor=draw(st.sampled_from([first.name, ''])) if prior else first.name,
        anchor_pose=draw(POSES),
        anchor_sigma=draw(POSE_SIGMAS),
        filter=draw(st.sampled_from(['fej', 'invariant', 'standard', 'ideal'])),
        update_iterations=draw(st.integers(0, 100)),
        compressed=draw(st.booleans()),
        start_covariance=draw(st.sampled_from(['anchored', 'independent'])),
        gate_probability=draw(st.floats(0.0, 1.0, exclude_min=True)),
        match_probability=draw(st.floats(0.0, 1.0, exclude_min=True)),
        inflate_rejected_scans=draw(st.booleans()),
        moved_landmarks=draw(st.sampled_from(['report', 'forget', 'ignore'])),
        max_delay=draw(NOT_NEGATIVE),
        stale_after=draw(NOT_NEGATIVE),
        future_limit=draw(NOT_NEGATIVE),
        join_heading_sigma=draw(NOT_NEGATIVE),
        shared_landmark_ids=draw(st.just(True) if prior else st.booleans()),
        odometry_sigma=draw(POSE_SIGMAS),
        landmark_sigma=draw(POINT_SIGMAS),
        odometry_scale=draw(ODOMETRY_SCALES),
        odometry_turn_bias=draw(TURN_BIASES),
        observation_range_scale=draw(RANGE_SCALES),
        observation_bearing_bias=draw(BEARING_BIASES),
        odometry_noise_scale=draw(SCALES),
        landmark_noise_scale=draw(SCALES),
        robot_noise_scale=draw(SCALES),
    )
    node = NodeSettings(
        clock_limit=draw(NOT_NEGATIVE),
        on_time_jump=draw(st.sampled_from(['refuse', 'reset'])),
        prior_landmarks=prior,
        unused_variance=draw(NOT_NEGATIVE),
        map_period=draw(PERIOD),
        publish_tf=draw(st.booleans()),
        map_frame=draw(st.sampled_from(['map', 'world'])),
        tf_topics=draw(st.sampled_from(['shared', 'robot', 'both'])),
        transform_tolerance=draw(st.floats(0.0, 3600.0)),
        output=draw(LINES),
        checkpoint=draw(LINES.filter(lambda line: line not in ('', prior))),
        autosave_period=draw(NOT_NEGATIVE),
        restore=draw(LINES),
        autostart=draw(st.booleans()),
        strict_parameters=draw(st.booleans()),
    )
    return RunSettings(estimation, node)
