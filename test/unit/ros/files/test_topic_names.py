# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded topics have the names that remapping rules and a namespace give."""

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES, topic_names


def read_as(recorded, *remaps, namespace=''):
    return topic_names(remaps, namespace).name(recorded)


@pytest.mark.parametrize('old', ['/a/filtered', 'a/filtered'])
@pytest.mark.parametrize('new', ['/r1/odom', 'r1/odom'])
@pytest.mark.parametrize('recorded', ['/a/filtered', 'a/filtered'])
def test_the_recorded_name_is_on_the_left_with_or_without_slash(recorded, old, new):
    assert read_as(recorded, f'{old}:={new}') == 'r1/odom'


def test_other_topics_keep_their_names():
    assert read_as('/a/odom/raw', '/a/odom:=/r1/odom') == 'a/odom/raw'
    assert RECORDED_NAMES.name('/a/odom') == 'a/odom'


def test_two_topics_can_exchange_their_names():
    rules = '/a/odom:=/b/odom', '/b/odom:=/a/odom'

    assert (read_as('/a/odom', *rules), read_as('/b/odom', *rules)) == ('b/odom', 'a/odom')


@pytest.mark.parametrize(('rule', 'recorded', 'name'), [
    ('/husky1/:=/r1/', '/husky1/odom', 'r1/odom'),
    ('/husky1/:=/r1/', '/husky10/odom', 'husky10/odom'),
    ('/a/b/:=r1/', '/a/b/odom', 'r1/odom'),
    ('/:=/fleet/', '/r1/odom', 'fleet/r1/odom'),
    ('/fleet/:=/', '/fleet/r1/odom', 'r1/odom'),
])
def test_a_rule_with_slashes_at_its_ends_is_of_all_topics_below(rule, recorded, name):
    assert read_as(recorded, rule) == name


@pytest.mark.parametrize('rules', [
    ('/a/:=/r1/', '/a/filtered:=/r1/odom'), ('/a/filtered:=/r1/odom', '/a/:=/r1/')])
def test_the_most_specific_rule_applies_whatever_the_order(rules):
    assert read_as('/a/filtered', *rules) == 'r1/odom'
    assert read_as('/a/landmarks', *rules) == 'r1/landmarks'


@pytest.mark.parametrize('namespace', ['fleet', '/fleet', '/fleet/'])
def test_a_namespace_is_removed_and_topics_outside_have_a_slash(namespace):
    assert read_as('/fleet/r1/odom', namespace=namespace) == 'r1/odom'
    assert read_as('/r1/odom', namespace=namespace) == '/r1/odom'
    assert read_as('/tf', namespace=namespace) == '/tf'


def test_a_rule_takes_a_topic_into_the_namespace():
    assert read_as('/husky/odom', 'husky/odom:=r1/odom', namespace='fleet') == 'r1/odom'


@pytest.mark.parametrize(('topic', 'name'), [
    ('r1/pose', 'fleet/r1/pose'), ('estimator/landmarks', 'fleet/estimator/landmarks'),
    ('/tf', 'tf'), ('/diagnostics', 'diagnostics')])
def test_relative_output_topics_are_in_the_namespace(topic, name):
    assert topic_names([], '/fleet').published(topic) == name
    assert RECORDED_NAMES.published(topic) == topic.lstrip('/')


def test_rules_survive_as_plain_data():
    names = topic_names(['a/odom:=r1/odom', '/b/:=/r2/'], 'fleet')

    stored = names.as_dict()

    assert stored == {'remap': ['/a/odom:=/r1/odom', '/b/:=/r2/'], 'namespace': '/fleet'}
    assert topic_names(stored['remap'], stored['namespace']) == names
    assert RECORDED_NAMES.as_dict() == {}


@pytest.mark.parametrize(('remaps', 'namespace', 'sentence'), [
    (['/a/odom'], '', 'give OLD:=NEW'),
    ([':=/r1/odom'], '', 'give OLD:=NEW'),
    (['/a/odom:='], '', 'give OLD:=NEW'),
    (['/a/odom:=/r1/1odom'], '', '/r1/1odom is not a ROS name'),
    (['/a/odom:=~/odom'], '', '/~/odom is not a ROS name'),
    (['/a/:=/r1'], '', 'end both names in a slash'),
    (['/a:=/r1/'], '', 'end both names in a slash'),
    (['__ns:=/fleet'], '', 'give --namespace /fleet instead'),
    (['/a:=/b', 'a:=/c'], '', '/a has two new names, /b and /c'),
    (['/a:=/c', '/b:=/c'], '', '/a and /b would both be /c'),
    ([], 'a fleet', 'such as /fleet'),
])
def test_rules_that_mean_nothing_are_usage_errors(remaps, namespace, sentence):
    with pytest.raises(UsageError, match=sentence):
        topic_names(remaps, namespace)


RECORDED = ['/husky1/odometry/filtered', '/husky1/tags', '/r2/odom', '/fleet/r3/odom']


def complaint(*remaps, namespace=''):
    with pytest.raises(UsageError) as error:
        topic_names(remaps, namespace).check(RECORDED, 'BAG')
    return str(error.value)


@pytest.mark.parametrize(('remap', 'nearest'), [
    ('/husky1/odometry/filterd:=/r1/odom', '/husky1/odometry/filtered'),
    ('/husky1/odom:=/r1/odom', '/husky1/odometry/filtered'),
    ('/husk1/tags:=/r1/odom', '/husky1/tags'),
])
def test_an_unknown_recorded_name_is_reported_with_the_nearest_one(remap, nearest):
    assert complaint(remap).endswith(f'did you mean {nearest}?')


def test_an_unknown_namespace_is_reported_with_the_nearest_one():
    assert complaint(namespace='flet').endswith('did you mean /fleet?')
    assert complaint('/husky2/:=/r1/') == (
        '--remap /husky2/:=/r1/: no topic of BAG is below /husky2/, did you mean /husky1/tags?')


def test_two_topics_of_one_name_are_reported_with_a_rule_that_keeps_them_apart():
    sentence = complaint('/husky1/odometry/filtered:=/r2/odom')

    rule = sentence.rpartition('--remap ')[2]
    assert '/husky1/odometry/filtered and /r2/odom would both be /r2/odom' in sentence
    topic_names(['/husky1/odometry/filtered:=/r2/odom', rule], '').check(RECORDED, 'BAG')


def test_a_topic_outside_the_namespace_differs_from_one_inside_unless_it_is_played():
    recorded = ['/r1/odom', '/fleet/r1/odom']
    names = topic_names([], 'fleet')

    names.check(recorded, 'BAG')
    with pytest.raises(UsageError, match='would both be /r1/odom'):
        names.check(recorded, 'BAG', is_played=True)


EXPECTED = ['r1/odom', 'r1/landmarks', 'ground_truth/landmarks']


@pytest.mark.parametrize(('new', 'nearest'), [
    ('/r1/landmark', '/r1/landmarks'), ('/ground_truth/landmark', '/ground_truth/landmarks')])
def test_a_new_name_of_a_robot_that_is_not_read_is_reported(new, nearest):
    with pytest.raises(UsageError, match=f'{new} is not read, did you mean {nearest}'):
        topic_names([f'/tags:={new}'], '').check_new(EXPECTED)


def test_new_names_that_are_read_or_of_no_robot_are_accepted():
    topic_names(['/a:=/r1/odom', '/b:=/unused/b', '/c/:=/r1/'], '').check_new(EXPECTED)
