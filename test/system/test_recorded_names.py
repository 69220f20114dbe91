# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag recorded with other topic names gives the same results as with the expected ones."""

from dataclasses import replace
import json

import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize
from helpers.faults import entries, Entry, framed, planted
from helpers.paths import BAGS
from helpers.ros import (
    csv_rows, header, meeting, raw_record, run_verb, summary_of, write_bag, write_parameters)

#: Options for a bag whose topics another function has renamed.
RENAMED = {
    'another robot': (
        lambda topic: topic.replace('r1/', 'husky1/'), ['--remap', '/husky1/:=/r1/']),
    'other topics': (
        {'r1/odom': 'husky1/odometry/filtered', 'r1/landmarks': 'husky1/tags',
         'r1/ground_truth': 'vicon/husky1'}.get,
        ['--remap', '/husky1/odometry/filtered:=/r1/odom', '--remap', 'husky1/tags:=r1/landmarks',
         '--remap', '/vicon/husky1:=/r1/ground_truth']),
    'exchanged robots': (
        lambda topic: topic.translate(str.maketrans('12', '21')),
        ['--remap', '/r1/:=/r2/', '/r2/:=/r1/']),
    'a fleet': (lambda topic: f'fleet/{topic}', ['--namespace', 'fleet']),
    'other names in a fleet': (
        lambda topic: f'site/fleet/{topic.replace("/odom", "/wheel/odometry")}',
        ['--namespace', '/site/fleet', '--remap',
         '/site/fleet/r1/wheel/odometry:=/r1/odom', '/site/fleet/r2/wheel/odometry:=/r2/odom']),
}
PARAMETERS = BAGS / 'two_circles.yaml'

each_renaming = pytest.mark.parametrize('renaming', RENAMED)


@pytest.fixture(scope='module')
def original(tmp_path_factory):
    """Return the results of the bag with the expected names."""
    output = tmp_path_factory.mktemp('original') / 'results'
    assert run_verb(
        'replay', BAGS / 'two_circles', '--params', PARAMETERS, '--output', output, '--bag') == 0
    return output


@pytest.fixture
def renamed(tmp_path):
    """Return a function that writes a bag with other names and returns it with its options."""
    def write(renaming, name='two_circles'):
        other, options = RENAMED[renaming]
        messages = [
            replace(m, topic=other(m.topic) or m.topic) for m in bags.read(BAGS / name)]
        return write_bag(tmp_path / 'renamed', messages), options

    return write


@each_renaming
def test_a_renamed_bag_has_the_state_hash_of_the_original(original, renamed, tmp_path, renaming):
    bag, options = renamed(renaming)

    status = run_verb(
        'replay', bag, '--params', PARAMETERS, '--output', tmp_path / 'out', *options)

    ours, theirs = summary_of(tmp_path / 'out'), summary_of(original)
    assert status == 0
    assert ours['state_hash'] == theirs['state_hash']
    assert ours['nees'] == theirs['nees']
    for name in ('trajectory_r1.csv', 'trajectory_r2.csv', 'landmarks.csv'):
        assert csv_rows(tmp_path / 'out' / name) == csv_rows(original / name)


def test_topics_outside_the_namespace_are_not_read(original, tmp_path):
    outside = [
        replace(m, topic=topic, raw=m.raw) for m in bags.read(BAGS / 'two_circles')
        for topic in (f'fleet/{m.topic}', m.topic.replace('r1', 'r0').replace('r2', 'r1'))]
    bag = write_bag(tmp_path / 'bag', outside)

    run_verb('replay', bag, '--params', PARAMETERS, '--output', tmp_path / 'out',
             '--namespace', 'fleet')

    summary = summary_of(tmp_path / 'out')
    assert summary['state_hash'] == summary_of(original)['state_hash']
    assert '/r1/odom' in summary['unused_topics']


def mount(parent, child):
    """Return a static transform that changes nothing."""
    transform = ros.geometry_msgs__msg__Transform(
        translation=ros.geometry_msgs__msg__Vector3(x=0.0, y=0.0, z=0.0),
        rotation=ros.geometry_msgs__msg__Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
    return ros.tf2_msgs__msg__TFMessage(transforms=[ros.geometry_msgs__msg__TransformStamped(
        header=header(0, parent), child_frame_id=child, transform=transform)])


def test_frames_keep_their_recorded_names(original, tmp_path):
    found = entries('two_circles')
    for entry in found:
        if entry.topic == 'r1/odom':
            framed('husky1/odom', 'husky1/base')(entry)
        elif entry.topic == 'r1/landmarks':
            framed('husky1/laser')(entry)
        entry.topic = f'fleet/{entry.topic.replace("r1/", "husky1/")}'
    of_sensor = Entry('tf_static', mount('husky1/base', 'husky1/laser'), 0)
    bag = planted(tmp_path / 'renamed', [of_sensor, *found])
    words = '--params', PARAMETERS, '--namespace', 'fleet', '--remap', '/fleet/husky1/:=/r1/'

    assert run_verb('replay', bag, *words, '--output', tmp_path / 'out') == 0
    assert run_verb('doctor', bag, *words, '--json', tmp_path / 'findings.json') == 0

    assert summary_of(tmp_path / 'out')['state_hash'] == summary_of(original)['state_hash']
    assert json.loads((tmp_path / 'findings.json').read_text()) == []


def test_output_topics_are_written_in_the_namespace(original, renamed, tmp_path):
    bag, options = renamed('a fleet')

    run_verb(
        'replay', bag, '--params', PARAMETERS, '--output', tmp_path / 'out', '--bag', *options)

    plain, ours = bags.topics(original / 'bag'), bags.topics(tmp_path / 'out' / 'bag')
    diagnostics = (
        deserialize(m.raw, m.type_name) for m in bags.read(tmp_path / 'out' / 'bag')
        if m.topic == 'diagnostics')
    absolute = {'tf', 'diagnostics'}
    assert {status.name for message in diagnostics for status in message.status} >= {
        'fleet/estimator: r1', 'fleet/estimator: r2'}
    assert ours == {
        topic if topic in absolute else f'fleet/{topic}': info for topic, info in plain.items()}


def evaluation(run, output, *options):
    assert run_verb('evaluate', run, '--output', output, '--no-plots', *options) == 0
    return json.loads((output / 'evaluation.json').read_text())['robots']


@pytest.mark.parametrize(
    'renaming', [pytest.param(name, marks=[] if 'in a fleet' in name else [pytest.mark.slow])
                 for name in RENAMED])
def test_a_run_is_evaluated_with_the_names_of_its_bag(original, renamed, tmp_path, renaming):
    bag, options = renamed(renaming)
    out = tmp_path / 'out'
    run_verb('replay', bag, '--params', PARAMETERS, '--output', out, '--bag', *options)

    expected = evaluation(original, tmp_path / 'original')

    assert evaluation(out, tmp_path / 'folder') == expected
    assert evaluation(out, tmp_path / 'given', '--truth', bag, *options) == expected
    of_bag = evaluation(out / 'bag', tmp_path / 'bag')
    # The heading is rounded by its quaternion.
    assert of_bag['r1']['nees']['mean'] == pytest.approx(expected['r1']['nees']['mean'], abs=1e-9)


@pytest.mark.parametrize('renaming', ['other topics', 'a fleet'])
def test_doctor_finds_nothing_in_a_renamed_bag(renamed, capsys, renaming):
    bag, options = renamed(renaming)

    assert run_verb('doctor', bag, '--params', PARAMETERS, *options) == 0
    assert '0 errors, 0 warnings' in capsys.readouterr().out


def test_calibration_of_a_renamed_bag_is_that_of_the_original(renamed, tmp_path):
    bag, options = renamed('other names in a fleet')
    words = '--params', PARAMETERS, '--from', 'truth'

    run_verb('calibrate', BAGS / 'two_circles', *words, '--output', tmp_path / 'theirs.yaml')
    assert run_verb('calibrate', bag, *words, '--output', tmp_path / 'ours.yaml', *options) == 0

    assert (tmp_path / 'ours.yaml').read_text() == (tmp_path / 'theirs.yaml').read_text()


def test_smoothing_a_renamed_bag_gives_the_original_trajectories(tmp_path):
    messages = [*map(raw_record, meeting())]
    original = write_bag(tmp_path / 'original', messages)
    renamed = write_bag(tmp_path / 'renamed', [
        replace(m, topic=f'fleet/{m.topic.replace("r1/", "husky/")}') for m in messages])
    words = '--params', write_parameters(tmp_path / 'params.yaml'), '--output'

    assert run_verb('smooth', original, *words, tmp_path / 'theirs') == 0
    assert run_verb('smooth', renamed, *words, tmp_path / 'ours', '--namespace', 'fleet',
                    '--remap', '/fleet/husky/:=/r1/') == 0

    ours, theirs = (
        csv_rows(tmp_path / name / 'trajectory_r1.csv') for name in ('ours', 'theirs'))
    assert len(ours) == 5
    assert ours == theirs
