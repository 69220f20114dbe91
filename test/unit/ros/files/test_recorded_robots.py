# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots are found by message types, and the proposed options name their topics."""

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES, topic_names
from helpers.ros import cloud, empty_cloud, odometry_message, raw, seen, write_bag

POINTS = cloud({'x': ('f4', [1.0]), 'y': ('f4', [1.0]), 'intensity': ('f4', [0.5])})


@pytest.fixture
def recorded(tmp_path):
    """Return a function that writes a bag with some topics and returns its robots."""
    def write(topics, team=(), names=RECORDED_NAMES):
        kinds = {'odometry': odometry_message(), 'observations': seen((1, 2.0, 3.0)),
                 'points': POINTS, 'empty': empty_cloud()}
        messages = [
            raw(topic, kinds[kind], 0) for topic, words in topics.items()
            for kind in words.split()]
        write_bag(tmp_path / 'bag', messages)
        return RecordedRobots(tmp_path / 'bag', names, team)

    return write


HUSKY = {'husky1/odometry/filtered': 'odometry', 'husky1/tags': 'observations'}

PROPOSALS = {
    'one robot of another name': (
        HUSKY, ['r1'],
        '--remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags:=/r1/landmarks'),
    'expected names below another one': (
        {'husky1/odom': 'odometry', 'husky1/landmarks': 'observations',
         'husky1/robots': 'observations', 'husky1/ground_truth': 'odometry'}, ['r1'],
        '--remap /husky1/:=/r1/'),
    'another robot is complete': (
        {**HUSKY, 'r2/odom': 'odometry', 'r2/landmarks': 'observations',
         'r2/wheel_odometry': 'odometry'}, ['r1', 'r2'],
        '--remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags:=/r1/landmarks'),
    'own names, other topics': (
        {'r1/odometry/filtered': 'odometry', 'r2/odometry/filtered': 'odometry',
         'r1/landmarks': 'observations', 'r2/landmarks': 'observations'}, ['r1', 'r2'],
        '--remap /r1/odometry/filtered:=/r1/odom --remap /r2/odometry/filtered:=/r2/odom'),
    'no namespace': (
        {'odometry/filtered': 'odometry', 'tags': 'observations'}, ['r1'],
        '--remap /odometry/filtered:=/r1/odom --remap /tags:=/r1/landmarks'),
    'a lidar beside observations': (
        {**HUSKY, 'husky1/lidar': 'points'}, ['r1'],
        '--remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags:=/r1/landmarks'),
    'a first scan without points': (
        {'husky1/odom': 'odometry', 'husky1/tags': 'empty observations'}, ['r1'],
        '--remap /husky1/odom:=/r1/odom --remap /husky1/tags:=/r1/landmarks'),
    'observations of robots': (
        {'husky1/filtered': 'odometry', 'husky1/robots': 'observations'}, ['r1'],
        '--remap /husky1/filtered:=/r1/odom --remap /husky1/robots:=/r1/robots'),
    'a lidar only': (
        {'husky1/odom': 'odometry', 'husky1/lidar': 'points'}, ['r1'],
        '--remap /husky1/:=/r1/'),
    'a fleet namespace': (
        {'fleet/r1/odom': 'odometry', 'fleet/r2/odom': 'odometry'}, ['r1', 'r2'],
        '--namespace /fleet'),
    'a nested namespace': ({'site/fleet/r1/odom': 'odometry'}, ['r1'], '--namespace /site/fleet'),
    'one robot in a namespace': (
        {'r1/odom': 'odometry', 'fleet/r2/odom': 'odometry'}, ['r1', 'r2'],
        '--remap /fleet/r2/:=/r2/'),
    'two namespaces': (
        {'a/r1/odom': 'odometry', 'b/r1/odom': 'odometry'}, ['r1'],
        '--namespace /a or --namespace /b'),
    'no team': (
        {'husky1/odometry': 'odometry', 'husky1/tags': 'observations'}, [],
        '--remap /husky1/odometry:=/husky1/odom --remap /husky1/tags:=/husky1/landmarks'),
    'no team, no namespace': (
        {'odom': 'odometry', 'tags': 'observations'}, [],
        '--remap /odom:=/r1/odom --remap /tags:=/r1/landmarks'),
    'no team, a fleet': (
        {'fleet/r1/odom': 'odometry', 'fleet/r2/odom': 'odometry'}, [], '--namespace /fleet'),
}


@pytest.mark.parametrize('case', PROPOSALS)
def test_options_are_proposed_where_only_one_choice_fits(recorded, case):
    topics, team, options = PROPOSALS[case]

    assert recorded(topics, team).cure() == f'add {options}'


def test_proposed_options_fit_beside_a_given_namespace(recorded):
    topics = {f'fleet/{topic}': kind for topic, kind in HUSKY.items()}

    robots = recorded(topics, ['r1'], topic_names([], 'fleet'))

    assert robots.cure() == (
        'add --remap /fleet/husky1/odometry/filtered:=/r1/odom'
        ' --remap /fleet/husky1/tags:=/r1/landmarks')


def test_a_namespace_that_no_robot_needs_is_left_out(recorded):
    topics = {'r1/odom': 'odometry', 'r2/odom': 'odometry'}

    robots = recorded(topics, ['r1', 'r2'], topic_names([], 'r1'))

    assert robots.missing == ['r1', 'r2']
    assert robots.cure() == 'leave out --namespace'


def test_a_rule_that_hides_the_odometry_of_a_robot_is_left_out(recorded):
    topics = {'r1/odom': 'odometry', 'r2/odom': 'odometry'}

    robots = recorded(topics, ['r1', 'r2'], topic_names(['/r1/:=/other/'], ''))

    assert robots.missing == ['r1']
    assert robots.cure() == 'leave out the --remap of /r1/odom'


def test_proposed_options_make_every_robot_complete(recorded, tmp_path):
    cure = recorded({**HUSKY, 'r2/odom': 'odometry'}, ['r1', 'r2']).cure()

    names = topic_names([word for word in cure.split() if ':=' in word], '')

    assert bags.topics(tmp_path / 'bag', names).keys() == {'r1/odom', 'r1/landmarks', 'r2/odom'}
    assert not RecordedRobots(tmp_path / 'bag', names, ['r1', 'r2']).missing


@pytest.mark.parametrize(('topics', 'team'), [
    ({**HUSKY, 'husky2/odom': 'odometry'}, ['r1']),
    ({**HUSKY, 'husky2/odom': 'odometry'}, ['r1', 'r2']),
    ({**HUSKY, 'husky1/odom': 'odometry'}, ['r1']),
    (HUSKY, ['r1', 'r2']),
    ({'husky1/odom': 'odometry', 'husky1/a/landmarks': 'observations',
      'husky1/b/landmarks': 'observations'}, ['r1']),
])
def test_an_ambiguous_choice_is_left_to_the_user(recorded, topics, team):
    cure = recorded(topics, team).cure()

    assert cure.startswith('choose the topics of each robot with --remap, for example --remap /h')


def test_one_topic_without_namespace_is_not_proposed_for_several_robots(recorded):
    robots = recorded({'odom': 'odometry'}, ['r1', 'r2'])

    assert robots.cure('r2') == robots.cure() == (
        'start the drivers of each robot in its namespace (-r __ns:=/r1), as /odom is of one'
        ' robot, or of several that are mixed up')


def test_topics_are_listed_by_type_with_their_counts(recorded):
    topics = {**HUSKY, 'husky1/lidar': 'points points', 'ground_truth/landmarks': 'observations'}

    assert recorded(topics, ['r1']).found() == (
        'nav_msgs/msg/Odometry on /husky1/odometry/filtered (1) and sensor_msgs/msg/PointCloud2 on'
        ' /husky1/lidar (2), /husky1/tags (1)')


def test_a_long_list_is_cut(recorded):
    topics = {f'robot{k}/wheel': 'odometry' for k in range(9)}

    assert recorded(topics, ['r1']).found() == (
        'nav_msgs/msg/Odometry on '
        + ', '.join(f'/robot{k}/wheel (1)' for k in range(6)) + ', 3 more topics and'
        ' sensor_msgs/msg/PointCloud2 on no topic')


def test_a_bag_without_robots_needs_odometry(recorded):
    robots = recorded({}, ['r1'])

    assert robots.found() == 'no topics'
    assert robots.cure().startswith('record nav_msgs/msg/Odometry on r1/odom')


def test_a_robot_outside_a_complete_team_has_odometry_and_observations(recorded):
    topics = {**HUSKY, 'r1/odom': 'odometry', 'camera/odom': 'odometry', 'r1/raw': 'odometry'}

    odometry, options = recorded(topics, ['r1']).unknown_robots()['husky1']

    assert odometry == 'husky1/odometry/filtered'
    assert options == (
        '--remap /husky1/odometry/filtered:=/husky1/odom'
        ' --remap /husky1/tags:=/husky1/landmarks')


@pytest.mark.parametrize(('topics', 'team', 'cure'), [
    ({**HUSKY}, ['r1'],
     'add --remap /husky1/odometry/filtered:=/r1/odom --remap /husky1/tags:=/r1/landmarks'),
    ({'r1/odom': 'odometry', 'r1/posts': 'observations'}, ['r1'],
     'add --remap /r1/posts:=/r1/landmarks'),
    ({'r1/odom': 'odometry', 'tags': 'observations'}, ['r1'],
     'add --remap /tags:=/r1/landmarks'),
    ({'r1/odom': 'odometry', 'r2/odom': 'odometry', 'r2/posts': 'observations'}, ['r1', 'r2'],
     ''),
    ({'r1/odom': 'odometry', 'r1/a': 'observations', 'r1/b': 'observations'}, ['r1'], ''),
    ({'r1/odom': 'odometry', 'r1/lidar': 'points'}, ['r1'], ''),
    ({'r1/wheel': 'odometry'}, ['r1'], '')])
def test_a_topic_that_may_be_the_landmarks_of_a_robot_is_proposed(recorded, topics, team, cure):
    assert recorded(topics, team).landmarks_cure('r1') == cure
