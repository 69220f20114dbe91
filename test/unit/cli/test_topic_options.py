# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""--remap and --namespace: every verb that reads a bag has them, mistakes are one sentence."""

from dataclasses import replace

import pytest

from helpers.ros import (
    assert_one_sentence, meeting, odometry_message, raw, raw_record, run_verb, write_bag,
    write_parameters)

VERBS = 'replay', 'smooth', 'calibrate', 'doctor', 'evaluate', 'play'

HUSKY = {'r1/odom': 'husky1/odometry/filtered', 'r1/landmarks': 'husky1/tags'}


@pytest.fixture
def use(places, capsys):
    """Return a function that uses a verb on the meeting with other names."""
    bag, params, output = places
    write_bag(bag, [
        replace(m, topic=HUSKY.get(m.topic, m.topic)) for m in map(raw_record, meeting())])

    def run(verb, *options):
        needed = {'doctor': [], 'play': ['--no-wait'], 'evaluate': ['--output', output]}
        words = needed.get(verb, ['--params', params, '--output', output])
        return run_verb(verb, bag, *words, *options), *capsys.readouterr()

    return run


@pytest.mark.parametrize('verb', VERBS)
def test_the_help_says_the_direction_with_an_example(verb, capsys):
    assert run_verb(verb, '--help') == 0

    text = ' '.join(capsys.readouterr().out.split())
    assert 'read the recorded topic OLD as NEW' in text
    assert '/husky1/odometry/filtered:=/r1/odom' in text
    assert '--namespace NAMESPACE' in text


@pytest.mark.parametrize('verb', VERBS)
@pytest.mark.parametrize(('options', 'part'), [
    (['--remap', '/husky1/odom:=/r1/odom'], 'did you mean /husky1/odometry/filtered?'),
    (['--remap', '/husky1/odometry/filtered:=/r2/odom'], 'would both be /r2/odom'),
    (['--remap', '/r1/odom'], 'give OLD:=NEW'),
    (['--remap', '/r2/odom:=/r2/odom', 'BAG'], '--remap BAG: give OLD:=NEW'),
    (['--namespace', 'fleet'], 'did you mean /'),
    (['--namespace', 'my fleet'], 'such as /fleet'),
])
def test_a_mistake_is_one_sentence_with_status_2(use, verb, options, part):
    assert_one_sentence(use(verb, *options), 2, part)


@pytest.mark.parametrize('verb', [verb for verb in VERBS if verb != 'play'])
def test_a_type_that_does_not_fit_is_one_sentence_with_status_2(use, verb):
    assert_one_sentence(
        use(verb, '--remap', '/husky1/tags:=/r1/odom'), 2, '/husky1/tags is sensor_msgs/msg/Po',
        'rename a topic of type nav_msgs/msg/Odometry')


@pytest.mark.parametrize('verb', ['replay', 'smooth', 'calibrate', 'doctor'])
def test_a_new_name_that_is_not_read_is_one_sentence_with_status_2(use, verb):
    names = '/husky1/odometry/filtered:=/r1/odom', '/husky1/tags:=/r1/landmark'

    assert_one_sentence(use(verb, '--remap', *names), 2, 'did you mean /r1/landmarks?')


@pytest.mark.parametrize('verb', ['replay', 'smooth', 'calibrate'])
def test_without_odometry_of_the_team_the_options_are_proposed_with_status_1(
        places, capsys, verb):
    bag, params, output = places
    write_bag(bag, [raw('fleet/r1/odom', odometry_message(), 0)])

    status = run_verb(verb, bag, '--params', params, '--output', output)

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, 'none of the topics r1/odom, r2/odom',
        'nav_msgs/msg/Odometry on /fleet/r1/odom (1)', 'add --namespace /fleet')


def test_a_robot_without_odometry_is_reported_with_the_options_and_the_run_goes_on(use, caplog):
    status, printed, _ = use('replay')

    assert status == 0
    assert 'state hash' in printed
    assert 'has no r1/odom' in caplog.text
    assert (
        'add --remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags:=/r1/landmarks'
        in caplog.text)


def test_doctor_finds_robots_by_message_types(places, capsys):
    write_bag(places[0], [raw('husky1/wheel_odometry', odometry_message(), 0)])

    status = run_verb('doctor', places[0])

    assert_one_sentence(
        (status, *capsys.readouterr()), 1, '/husky1/wheel_odometry (1)',
        'add --remap /husky1/wheel_odometry:=/husky1/odom')


def test_doctor_names_a_topic_of_the_missing_robot(use, places):
    status, printed, _ = use('doctor', '--params', places[1])

    assert status == 1
    assert 'cure: add --remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags' in printed


def test_options_without_a_bag_are_one_sentence(tmp_path, capsys):
    run, truth = tmp_path / 'run', tmp_path / 'truth'
    run.mkdir()
    truth.mkdir()

    status = run_verb('evaluate', run, '--truth', truth, '--no-plots', '--namespace', 'fleet')

    assert_one_sentence((status, *capsys.readouterr()), 2, 'no bag is read, leave the options out')


@pytest.mark.parametrize('verb', ['replay', 'smooth', 'doctor', 'calibrate'])
def test_parameters_are_those_of_a_node_in_the_namespace(places, capsys, verb):
    bag, params, output = places
    write_bag(bag, [raw('fleet/r7/odom', odometry_message(), 0)])
    write_parameters(params, node='/fleet/estimator', robots=['r8'])
    words = () if verb == 'doctor' else ('--output', output)

    status = run_verb(verb, bag, '--params', params, *words, '--namespace', 'fleet/')

    assert status == 1
    assert 'r8/odom' in ''.join(capsys.readouterr())
