# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A damaged bag is explained by its file and by the command that repairs it."""

import sqlite3

import pytest

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from helpers.ros import meeting

SUFFIXES = {'mcap': 'mcap', 'sqlite3': 'db3'}
RECOVERY = {
    'mcap': '"mcap recover bag.mcap -o NEW.mcap"',
    'sqlite3': '"sqlite3 bag.db3 .recover | sqlite3 NEW.db3"'}

each_storage = pytest.mark.parametrize('storage', bags.STORAGES)


@pytest.fixture
def bag(tmp_path, storage):
    """Return a bag of a storage."""
    bags.write(tmp_path / 'bag', meeting(40), storage)
    return tmp_path / 'bag'


def explained(bag):
    with pytest.raises(UserError) as error:
        bags.topics(bag)
    return str(error.value)


@each_storage
@pytest.mark.parametrize('share', [0.0, 0.02, 0.5, 0.9])
def test_a_truncated_file_is_named_with_the_command_that_recovers_it(bag, storage, share):
    file = bag / f'bag.{SUFFIXES[storage]}'
    whole = file.read_bytes()
    file.write_bytes(whole[:int(share * len(whole))])

    explanation = explained(bag)

    assert explanation.startswith(f'{file} is truncated, ')
    assert RECOVERY[storage] in explanation
    assert '"ros2 bag reindex"' in explanation


@each_storage
def test_a_bag_without_metadata_is_reindexed(bag):
    (bag / 'metadata.yaml').unlink()

    assert explained(bag) == (
        f'{bag} has no metadata.yaml, its recording was interrupted: run "ros2 bag reindex'
        f' {bag}", which writes it')


@each_storage
def test_a_truncated_file_is_recovered_before_it_is_reindexed(bag, storage):
    (bag / 'metadata.yaml').unlink()
    file = bag / f'bag.{SUFFIXES[storage]}'
    file.write_bytes(file.read_bytes()[:-20])

    assert RECOVERY[storage] in explained(bag)


def test_a_missing_bag_is_not_called_damaged(tmp_path):
    assert explained(tmp_path / 'bag') == (
        f'{tmp_path / "bag"} does not exist: give the folder of a rosbag2')


@pytest.mark.parametrize('storage', ['mcap'])
def test_other_damage_is_explained_by_the_reader(bag):
    (bag / 'metadata.yaml').write_text('{')

    assert explained(bag).startswith(f'{bag} cannot be read as a rosbag2')


@pytest.mark.parametrize('storage', ['sqlite3'])
def test_a_log_time_that_is_no_number_is_one_sentence(bag):
    with sqlite3.connect(bag / 'bag.db3') as database:
        database.execute("UPDATE messages SET timestamp = X'00FF' WHERE id = 7")
    database.close()

    with pytest.raises(UserError, match='cannot be read as a rosbag2'):
        list(bags.read(bag))
