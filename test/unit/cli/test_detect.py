# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`detect` copies a bag with its landmarks, and says in one sentence what it cannot do."""

from dataclasses import replace
import re

import numpy as np
import pytest

from fej_slam_ros.ros.files import bags
from helpers.ros import (
    assert_one_sentence, cdr, odometry_message, raw, run_verb, TYPES, write_bag, write_parameters)

WORLD = {'environment': 'posts', 'steps_per_loop': 60, 'loops': 1, 'beams': 360, 'seed': 1}


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return a simulated bag of lasers and the parameters of the detector."""
    folder = tmp_path_factory.mktemp('lasers')
    world = write_parameters(folder / 'world.yaml', **WORLD)
    assert run_verb('simulate', '--params', world, '--output', folder / 'bag') == 0
    return folder / 'bag', write_parameters(folder / 'detector.yaml', robots=['r1', 'r2'])


def test_the_copy_has_all_messages_and_the_landmarks(recorded, tmp_path, capsys):
    bag, settings = recorded

    assert run_verb('detect', bag, '--params', settings, '--output', tmp_path / 'out') == 0

    before, after = bags.topics(bag), bags.topics(tmp_path / 'out')
    assert {name: after[name] for name in before} == before
    scans = after['r1/scan'].messages
    assert scans > 10
    assert after['r1/landmarks'].messages == after['r1/detection_markers'].messages == scans
    printed = capsys.readouterr().out
    assert re.search(rf'^scans +{scans} +{scans}$', printed, re.MULTILINE)
    assert re.search(r'^landmarks +\d\d+ +\d\d+$', printed, re.MULTILINE)


def test_a_bag_that_has_landmarks_is_refused(recorded, tmp_path, capsys):
    bag, settings = recorded
    run_verb('detect', bag, '--params', settings, '--output', tmp_path / 'out')
    capsys.readouterr()

    status = run_verb(
        'detect', tmp_path / 'out', '--params', settings, '--output', tmp_path / 'again')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'r1/landmarks', '--remap')


def test_scans_on_another_topic_are_named(recorded, tmp_path, capsys):
    bag, _ = recorded
    settings = write_parameters(tmp_path / 'detector.yaml', robots=['husky'])

    status = run_verb('detect', bag, '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'r1/scan, r2/scan', '--remap')


def test_the_rule_for_the_only_scans_is_named(recorded, tmp_path, capsys):
    scans = [message for message in bags.read(recorded[0]) if message.topic == 'r1/scan']
    bag = write_bag(tmp_path / 'bag', [replace(scan, topic='scan') for scan in scans])

    status = run_verb('detect', bag, '--params', recorded[1], '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, '--remap /scan:=/r1/scan')


def test_a_bag_without_scans_is_refused(recorded, tmp_path, capsys):
    bag = write_bag(tmp_path / 'bag', [raw('r1/odom', odometry_message(0), 0)])

    status = run_verb('detect', bag, '--params', recorded[1], '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'no laser scans')


@pytest.mark.parametrize('verb', ['replay', 'doctor'])
def test_scans_under_a_new_name_where_landmarks_are_needed_are_reported_with_detect(
        recorded, tmp_path, capsys, caplog, verb):
    bag = write_bag(tmp_path / 'bag', [
        replace(message, topic='scan') if message.topic == 'r1/scan' else message
        for message in bags.read(recorded[0])])
    output = {'replay': ['--output', tmp_path / 'out'], 'doctor': []}[verb]

    run_verb(verb, bag, '--params', recorded[1], *output, '--remap', '/scan:=/r1/scan')

    printed, _ = capsys.readouterr()
    assert 'find posts or reflectors in r1/scan: fej_slam detect BAG' in printed + caplog.text


def test_the_doctor_of_a_bag_with_scans_but_no_landmarks_names_detect(recorded, capsys):
    run_verb('doctor', recorded[0])

    said = capsys.readouterr().out
    assert 'cure: find posts or reflectors in r1/scan: fej_slam detect BAG' in said


def test_the_doctor_does_not_advise_to_detect_in_scans_that_are_all_rejected(
        recorded, tmp_path, capsys):
    copy = write_bag(tmp_path / 'bag', [
        without_beams(message) if message.topic == 'r1/scan' else message
        for message in bags.read(recorded[0])])

    run_verb('doctor', copy, '--params', recorded[1])

    found = [line for line in capsys.readouterr().out.splitlines() if ': r1/' in line]
    assert [line.split(': ')[1:3] for line in found if line.startswith('error')] == [
        ['r1/scan', 'scans_rejected']]


def test_scans_that_are_all_rejected_are_an_error_and_nothing_is_written(
        recorded, tmp_path, capsys):
    copy = write_bag(tmp_path / 'bag', [
        without_beams(message) if message.topic.endswith('/scan') else message
        for message in bags.read(recorded[0])])

    status = run_verb('detect', copy, '--params', recorded[1], '--output', tmp_path / 'out')

    printed, error = capsys.readouterr()
    assert (status, error.count('\n')) == (1, 1)
    assert 'r1: ' in printed
    assert 'nothing is written: correct what the lines above name' in error
    assert not (tmp_path / 'out').exists()


def without_beams(message):
    scan = TYPES.deserialize_cdr(message.raw, message.type_name)
    return replace(message, raw=cdr(replace(scan, ranges=np.empty(0, np.float32))))


@pytest.mark.parametrize(
    ('values', 'parts'),
    [
        ({'robots': ['r1'], 'min_radius': 0.3, 'max_radius': 0.2}, ['min_radius', 'exchange']),
        ({'robots': ['r1'], 'range_sigma': 0.0}, ["'range_sigma'", '0.0001']),
        ({'min_beams': 3}, ["'robots'"]),
    ],
)
def test_wrong_parameters_are_named(recorded, tmp_path, capsys, values, parts):
    settings = write_parameters(tmp_path / 'detector.yaml', **values)

    status = run_verb('detect', recorded[0], '--params', settings, '--output', tmp_path / 'out')

    assert_one_sentence((status, *capsys.readouterr()), 2, *parts)
