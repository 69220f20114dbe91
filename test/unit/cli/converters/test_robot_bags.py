# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`convert robot_bags`: bags that robots have recorded by themselves are one of the team."""

from dataclasses import replace

import pytest

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from helpers.paths import BAGS
from helpers.ros import assert_one_sentence, run_bag, run_verb, write_bag

TEAM = BAGS / 'two_circles'


@pytest.fixture
def convert(tmp_path, capsys):
    """Return a function that merges bags and returns status and both outputs."""

    def run(*words):
        status = run_verb(
            'convert', 'robot_bags', '--input', *words, '--output', tmp_path / 'team')
        return status, *capsys.readouterr()

    return run


def recorded(path, robot, prefix):
    """Write what a robot would record of `TEAM`, its topics below a prefix; return the path."""
    write_bag(path, [
        replace(m, topic=f'{prefix}{m.topic.removeprefix(f"{robot}/")}')
        for m in bags.read(TEAM) if m.topic.startswith(f'{robot}/')])
    return path


@pytest.mark.parametrize('prefixes', [('', ''), ('r1/', ''), ('r1/', 'r2/')])
def test_the_team_has_the_estimate_of_a_bag_recorded_at_one_place(convert, tmp_path, prefixes):
    first, second = (
        recorded(tmp_path / robot, robot, prefix)
        for robot, prefix in zip(('r1', 'r2'), prefixes))
    amounts = {name: topic.messages for name, topic in bags.topics(TEAM).items()}

    status, said, error = convert(f'r1={first}', f'r2={second}')

    assert (status, error) == (0, '')
    for robot in ('r1', 'r2'):
        own = [amounts[name] for name in amounts if name.startswith(f'{robot}/')]
        assert f'{robot}: topics: {len(own)}, messages: {sum(own)}\n' in said
    made = tmp_path / 'team.yaml'
    assert [robot.name for robot in parameters.load(made).estimation.robots] == ['r1', 'r2']
    made.write_text(TEAM.with_suffix('.yaml').read_text())
    assert run_bag(tmp_path / 'team').state_hash() == run_bag(TEAM).state_hash()


def test_other_names_are_below_that_of_the_robot(convert, tmp_path):
    second = recorded(tmp_path / 'b', 'r2', 'husky/')

    convert(f'r1={recorded(tmp_path / "a", "r1", "")}', f'r2={second}')

    assert {'r1/odom', 'r2/husky/odom'} <= bags.topics(tmp_path / 'team').keys()


def test_a_latched_topic_stays_latched(convert, tmp_path):
    with bags.BagWriter(tmp_path / 'a') as bag:
        for message in bags.read(TEAM):
            if message.topic == 'r1/odom':
                bag.copy(message, latched=True)

    convert(f'r1={tmp_path / "a"}')

    assert bags.topics(tmp_path / 'team')['r1/odom'].latched


def test_two_topics_of_one_name_are_an_error(convert, tmp_path):
    odometry = [m for m in bags.read(TEAM) if m.topic == 'r1/odom']
    write_bag(tmp_path / 'a', [*odometry, *(replace(m, topic='odom') for m in odometry)])

    assert_one_sentence(
        convert(f'r1={tmp_path / "a"}'), 1, '/r1/odom and /odom', 'rosbags-convert')
    assert not (tmp_path / 'team').exists()


@pytest.mark.parametrize(('words', 'status', 'part'), [
    (['r1'], 2, 'give ROBOT=BAG'), (['=bag'], 2, 'give ROBOT=BAG'),
    (['r1=absent'], 1, 'absent does not exist'),
    (['r1=absent', 'r1=other'], 2, "contains 'r1' twice"),
    (['1=absent'], 2, 'robots'), (['r1={team}'], 2, 'choose another output'),
])
def test_bad_input_is_an_error(convert, tmp_path, words, status, part):
    words = [word.format(team=tmp_path / 'team') for word in words]

    assert_one_sentence(convert(*words), status, part)
