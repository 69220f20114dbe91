# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames have the names of the parameters, else those of the odometry, with or without prefix."""

from dataclasses import replace
import json

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.parameters import NodeSettings, parse
from fej_slam_ros.ros.session.estimator_outputs import EstimatorOutputs
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.frames import FrameNames
from fej_slam_ros.ros.session.live_outputs import LiveOutputs
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.records import odometry, team
from helpers.ros import (
    drive, header, meeting, odometry_message, raw, raw_record, run_settings, seen)

#: Frames without a robot prefix, as on robots that each have a namespace and transforms.
NAV2 = {
    'robots': ['r1', 'r2'], 'tf_topics': 'robot',
    **{f'{robot}.{name}_frame': frame for robot in ('r1', 'r2')
       for name, frame in (('odom', 'odom'), ('base', 'base_link'))}}


def named(robot_frames, **node):
    """Return the names of frames after odometry with (frame, child frame) of some robots."""
    names = FrameNames(Estimator(team()), NodeSettings(**node))
    for robot, (frame, child) in robot_frames.items():
        names.add(robot, replace(odometry_message(child=child), header=header(0, frame)))
    return names


def published(messages=None, live=False, **values):
    """Return what a run publishes for the meeting, by topic."""
    outputs = LiveOutputs if live else EstimatorOutputs
    run = EstimatorSession(parse({'robots': ['r1', 'r2'], **values}), None, outputs=outputs)
    messages = list(map(raw_record, meeting())) if messages is None else messages
    found = {}
    for message in messages:
        for topic, content in [*run.receive(message), *run.take()]:
            found.setdefault(topic, []).append(content)
    for topic, content in [*run.close(), *run.outputs.maps_and_paths()]:
        found.setdefault(topic, []).append(content)
    return run, found


def links(messages):
    """Return parent and child frames of transforms."""
    return {
        (t.header.frame_id, t.child_frame_id) for message in messages for t in message.transforms}


@pytest.mark.parametrize(
    ('frames', 'expected'),
    [
        ({'r1': 'odom'}, ['odom', 'r2/odom']),
        ({'r1': '/wheels', 'r2': 'visual'}, ['wheels', 'visual']),
        ({'r1': '', 'r2': ''}, ['r1/odom', 'r2/odom']),
        ({'r1': 'odom', 'r2': 'odom'}, ['r1/odom', 'r2/odom']),
        ({'r1': 'map', 'r2': 'r2/map'}, ['r1/odom', 'r2/odom']),
    ],
)
def test_the_frame_of_odometry_is_taken_from_its_messages_if_unambiguous(frames, expected):
    names = named({robot: (frame, '') for robot, frame in frames.items()})

    assert [names.odometry(robot) for robot in ('r1', 'r2')] == expected


def test_the_frame_of_odometry_stays_the_first_one():
    names = named({'r1': ('r1/odom', '')})

    names.add('r1', replace(odometry_message(), header=header(100, 'elsewhere')))

    assert names.odometry('r1') == 'r1/odom'


@pytest.mark.parametrize(('frame', 'child', 'parts'), [
    ('r1/odom', 'r1/base_link', []),
    ('odom', 'r1/base_link', ["has changed from 'r1/odom' to 'odom'"]),
    ('r1/odom', 'base_link', ['changes (base_link, r1/base_link)']),
])
def test_a_frame_that_a_driver_has_renamed_is_reported(frame, child, parts):
    names = named({'r1': ('/r1/odom', 'r1/base_link')})

    names.add('r1', replace(odometry_message(child=child), header=header(100, frame)))

    sentences = list(names.faults('r1'))
    assert len(sentences) == len(parts)
    assert all(part in sentence for part, sentence in zip(parts, sentences))


@pytest.mark.parametrize('frame', ['world', 'r1/map'])
def test_odometry_of_a_localisation_is_reported(frame):
    names = named({'r1': (frame, 'r1/base_link')}, map_frame='world')

    sentence, = names.faults('r1')

    assert f'is in the frame {frame!r}, as that of a localisation' in sentence


@pytest.mark.parametrize(
    ('node', 'frames', 'is_reported'),
    [
        ({}, ('odom', 'odom'), True),
        ({'tf_topics': 'both'}, ('odom', 'odom'), True),
        ({'tf_topics': 'robot'}, ('odom', 'odom'), False),
        ({}, ('odom', 'r2/odom'), False),
        ({}, ('', ''), False),
        ({'publish_tf': False}, ('odom', 'odom'), False),
    ],
)
def test_a_transform_to_a_frame_that_no_driver_has_is_reported(node, frames, is_reported):
    run = EstimatorSession(parse({'robots': ['r1', 'r2'], **node}), None)

    for robot, frame in zip(('r1', 'r2'), frames):
        run.receive(raw(
            f'{robot}/odom', replace(odometry_message(child=''), header=header(0, frame))))

    _, report = run.diagnostics.report(10**9, at_rest=False)
    messages = {status.name: status.message for status in report.status}
    for robot, other in ('r1', 'r2'), ('r2', 'r1'):
        sentence = (
            f"its odometry is in the frame 'odom', as that of {other}, so that the transform from"
            f" map leads to '{robot}/odom': set tf_topics to robot")
        assert (sentence in messages[f'estimator: {robot}']) == is_reported


def test_frames_of_parameters_do_not_change_with_the_odometry():
    names = FrameNames(
        Estimator(parse({**NAV2, 'robots': ['r1', 'r2']}).estimation), NodeSettings())

    for frame in ('wheels', 'visual'):
        names.add('r1', replace(odometry_message(child=frame), header=header(0, frame)))

    assert list(names.faults('r1')) == []


@pytest.mark.parametrize(
    ('children', 'expected'),
    [
        ({'r1': '/base_footprint'}, ['base_footprint', 'r2/base_link']),
        ({'r1': 'base_link', 'r2': 'base_link'}, ['r1/base_link', 'r2/base_link']),
        ({'r1': '', 'r2': 'torso'}, ['r1/base_link', 'torso']),
    ],
)
def test_the_base_frame_is_the_child_frame_of_the_odometry_if_unambiguous(children, expected):
    names = named({robot: ('', child) for robot, child in children.items()})

    assert [names.base(robot) for robot in ('r1', 'r2')] == expected


def test_restored_names_of_frames_are_those_before():
    before = named({'r1': ('odom', 'base'), 'r2': ('odom_2', 'base_2')})
    names = named({})

    names.restore(json.loads(json.dumps(before.snapshot())))

    for robot, frame, child in (('r1', 'odom', 'base'), ('r2', 'odom_2', 'base_2')):
        assert names.odometry(robot) == before.odometry(robot) == frame
        assert names.knows_base(robot)
        assert names.is_base(robot, child)


def test_robots_with_transforms_of_their_own_may_share_names_of_frames():
    names = named(dict.fromkeys(('r1', 'r2'), ('odom', 'base_link')), tf_topics='robot')

    assert {names.odometry(robot) for robot in ('r1', 'r2')} == {'odom'}
    assert {names.base(robot) for robot in ('r1', 'r2')} == {'base_link'}


@pytest.mark.parametrize(
    ('tf_topics', 'topics'),
    [('shared', {'/tf'}), ('robot', {'r1/tf', 'r2/tf'}), ('both', {'/tf', 'r1/tf', 'r2/tf'})])
@pytest.mark.parametrize('live', [False, True])
def test_transforms_are_published_on_the_chosen_topics(tf_topics, topics, live):
    run, found = published(live=live, tf_topics=tf_topics)

    assert {topic for topic in found if topic.endswith('/tf')} == topics
    assert {topic for topic in run.outputs.topics if topic.endswith('/tf')} == topics
    for robot in ('r1', 'r2'):
        if f'{robot}/tf' in found:
            assert {child for _, child in links(found[f'{robot}/tf'])} == {f'{robot}/odom'}


def test_frames_of_the_parameters_have_no_prefix_where_each_robot_has_its_transforms():
    _, found = published(live=True, map_frame='world', relative_poses=['r1:r2'], **NAV2)

    assert links(found['r1/tf']) == {('world', 'odom')}
    assert links(found['r2/tf']) <= {('world', 'odom'), ('r2/map', 'odom')}
    fused = found['r2/odometry/filtered'][-1]
    assert (fused.header.frame_id, fused.child_frame_id) == ('world', 'base_link')
    assert found['r1/relative_pose/r2'][-1].header.frame_id == 'base_link'


@pytest.mark.parametrize('live', [False, True])
def test_no_message_names_map_if_it_has_another_name(live):
    _, found = published(live=live, map_frame='world')

    frames = {
        part.header.frame_id for messages in found.values() for message in messages
        for part in (
            message, *getattr(message, 'markers', ()), *getattr(message, 'transforms', ()),
            *getattr(message, 'poses', ()))
        if hasattr(part, 'header')}
    assert frames == {'world', 'r2/map'}


def test_the_smoother_names_its_maps_likewise():
    run = SmootherSession(run_settings(map_frame='world'), None)

    found = drive(run, map(raw_record, meeting()))

    assert {m.header.frame_id for topic, m in found if topic == 'r2/base_node'} == {'world'}
    assert {m.header.frame_id for t, m in run.outputs.maps_and_paths()
            if t == '~/landmarks'} == {'world'}


@pytest.mark.parametrize(('frame', 'rejected'), [('world', 0), ('map', 1)])
def test_a_pose_is_set_in_the_named_map_frame(frame, rejected):
    run = EstimatorSession(run_settings(map_frame='world'), None)
    drive(run, [raw_record(odometry('r2', 0))])
    _, message = outgoing.input_message(PosePrior('r2', 0, np.zeros(3), 0.01 * np.eye(3)))
    message.header.frame_id = frame

    run.receive(raw('r2/set_pose', message, 0))

    assert run.estimator.statistics.total(RejectionReason.WRONG_FRAME) == rejected


def test_scans_may_be_in_the_base_frame_of_the_parameters():
    run, _ = published(
        [raw('r1/odom', odometry_message(0), 0),
         raw('r1/landmarks', seen((1, 2.0, 0.0), frame='torso'), 0),
         raw('r1/landmarks', seen((1, 2.0, 0.0), frame='head', ms=0), 0)],
        **{'r1.base_frame': 'torso'})

    assert run.estimator.statistics.total(RejectionReason.WRONG_FRAME) == 1


@pytest.mark.parametrize(('tf_topics', 'expected'), [
    ('shared', ['/tf_static']), ('robot', ['r1/tf_static']),
    ('both', ['r1/tf_static', '/tf_static'])])
def test_static_transforms_of_a_robot_of_its_own_topic_come_first(tf_topics, expected):
    assert named({}, tf_topics=tf_topics).static_topics('r1') == expected
