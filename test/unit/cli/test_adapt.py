# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`adapt` copies a bag with the landmarks of tags, and says in one sentence what it cannot do."""

from dataclasses import replace
import json

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import RawMessage
from helpers import foreign
from helpers.ros import (
    assert_one_sentence, header, odometry_message, raw, run_verb, summary_of, write_bag,
    write_parameters)

TAGS = {'tag36h11:4': (2.0, 1.0, 0.3), 'tag36h11:5': (3.0, -1.0, 0.3)}


def recording(path, *more):
    """Return a bag of a robot that stands still and sees two tags from a camera at its base."""
    messages = [
        message for ms in range(0, 1000, 100) for message in (
            raw('r1/odom', odometry_message(ms), ms),
            foreign.april_tags(ms, 'r1/base_link', TAGS, 'tf'))]
    return write_bag(path / 'bag', [*messages, *more])


def test_the_landmarks_of_the_copy_are_those_of_the_tags(tmp_path):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'])
    bag = recording(tmp_path)

    assert run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out') == 0

    before, after = bags.topics(bag), bags.topics(tmp_path / 'out')
    assert {name: after[name] for name in before} == before
    assert (after['r1/landmarks'].messages, after['landmark_ids'].latched) == (10, True)
    words = tmp_path / 'out', '--params', settings, '--output', tmp_path / 'run'
    assert run_verb('replay', *words) == 0
    assert summary_of(tmp_path / 'run')['landmarks'] == 2


def test_messages_of_other_packages_are_copied_too(tmp_path):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['aruco'])
    bag = recording(tmp_path, foreign.aruco(1000, 'r1/base_link', {7: (1.0, 2.0, 0.3)}))

    assert run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out') == 0

    after = bags.topics(tmp_path / 'out')
    assert after['r1/aruco_detections'].messages == after['r1/landmarks'].messages == 1


def test_messages_of_another_type_on_the_topic_of_a_format_are_named(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['aruco'])
    markers = foreign.aruco_ros(1000, 'r1/base_link', {7: (1.0, 2.0, 0.3)})
    bag = recording(tmp_path, replace(markers, topic='r1/aruco_detections'))

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, 'r1/aruco_detections of the type aruco_msgs/msg/')


def test_static_transforms_are_not_taken_for_tags(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'])
    mount = foreign.april_tags(0, 'r1/base_link', TAGS, 'tf_static')
    bag = write_bag(tmp_path / 'bag', [raw('r1/odom', odometry_message(0), 0), mount])

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, 'nor messages of another format that could be read',
        'record /tf, where apriltag_ros publishes the tags')


def test_ids_of_names_are_kept_in_a_file(tmp_path):
    ids = tmp_path / 'ids.json'
    ids.write_text('{"tag36h11:5": 500}')
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], ids_file=str(ids))

    words = recording(tmp_path), '--params', settings, '--output', tmp_path / 'out'
    assert run_verb('adapt', *words) == 0

    assert json.loads(ids.read_text()) == {'tag36h11:4': 4, 'tag36h11:5': 500}


@pytest.mark.parametrize('content', ['[1]', '{"a": -1}', '{"a": 1, "b": 1}', '{"a": true}', 'no'])
def test_a_wrong_file_of_ids_is_refused(tmp_path, capsys, content):
    ids = tmp_path / 'ids.json'
    ids.write_text(content)
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], ids_file=str(ids))

    status = run_verb(
        'adapt', recording(tmp_path), '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, str(ids), 'JSON object of names')


def test_a_bag_without_the_messages_of_the_formats_is_refused(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['detection3d'])

    status = run_verb(
        'adapt', recording(tmp_path), '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, '<robot>/detections',
        'choose formats that it has, apriltag for tags on /tf')


def test_messages_of_another_format_and_robot_are_named(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r2'], formats=['detection3d'])
    bag = write_bag(tmp_path / 'bag', [
        raw('r1/odom', odometry_message(0), 0),
        foreign.aruco(1000, 'r1/base_link', {7: (1.0, 2.0, 0.3)})])

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence(
        (status, *capsys.readouterr()), 1,
        'but messages of other formats on r1/aruco_detections: correct robots and formats')


def test_a_bag_without_the_messages_of_any_format_is_refused(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'])
    bag = write_bag(tmp_path / 'bag', [raw('r1/odom', odometry_message(0), 0)])

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, 'bag has no tf of the robots in robots, nor messages')


def test_messages_of_another_release_are_refused(tmp_path, capsys):
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(
        'std_msgs/Header header\nfloat64[] boxes\n', 'vision_msgs/msg/Detection3DArray'))
    kind = types.types['vision_msgs/msg/Detection3DArray']
    message = kind(header=header(0, 'r1/base_link'), boxes=np.empty(0))
    name = kind.__msgtype__
    raw_message = RawMessage(
        'r1/detections', name, 0, bytes(types.serialize_cdr(message, name)))
    bag = write_bag(tmp_path / 'bag', [raw_message], types=types)
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['detection3d'])

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'vision_msgs', 'another release')


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'robots': ['r1'], 'formats': ['april']}, ["'formats'", "'apriltag'"]),
        ({'robots': ['r1'], 'names': '('}, ["'names'", 'regular expression']),
        ({'robots': ['r1', 'r2'], 'r1.tags': ['a'], 'r2.tags': ['a']}, ["'r1.tags'", "'r2.tags'"]),
        ({'robots': ['r1'], 'r1.sensor_pose': [0.0, 0.0, 0.0]}, ["'r1.sensor_pose'", 'six']),
        ({'formats': ['aruco']}, ["'robots'"]),
    ],
)
def test_wrong_parameters_are_named(tmp_path, capsys, values, parts):
    settings = write_parameters(tmp_path / 'p.yaml', **values)

    status = run_verb(
        'adapt', recording(tmp_path), '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 2, *parts)


def test_the_format_of_a_bag_that_has_another_is_named(tmp_path, capsys):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'], formats=['detection3d'])
    bag = recording(tmp_path, foreign.aruco(1000, 'r1/base_link', {7: (1.0, 2.0, 0.3)}))

    status = run_verb('adapt', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'formats: [aruco]')


def test_doctor_and_replay_name_adapt_for_a_bag_with_objects_only(tmp_path, capsys, caplog):
    settings = write_parameters(tmp_path / 'p.yaml', robots=['r1'])
    bag = recording(tmp_path, foreign.aruco(1000, 'r1/base_link', {7: (1.0, 2.0, 0.3)}))

    assert run_verb('doctor', bag, '--params', settings) == 1
    printed = capsys.readouterr().out
    assert 'use r1/aruco_detections (formats: [aruco]): fej_slam adapt BAG' in printed
    assert 'never_joins' not in printed
    assert run_verb('replay', bag, '--params', settings, '--output', tmp_path / 'out') == 0
    assert 'formats: [aruco]): fej_slam adapt BAG' in caplog.text
