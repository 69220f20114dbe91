# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A damaged bag is explained by its file and by the command that repairs it."""

import shlex
import sqlite3
import subprocess
import sys

import pytest
from rosbags.rosbag2 import ReaderError

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags, damaged_bags
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
def test_metadata_that_an_interrupted_recording_left_empty_are_named(bag):
    (bag / 'metadata.yaml').write_text('')

    assert explained(bag).startswith(
        f'{bag} has an empty metadata.yaml, its recording was interrupted: run "ros2 bag reindex')


@each_storage
def test_a_bag_without_metadata_is_reindexed_or_converted(bag, storage, monkeypatch):
    whole = [*bags.read(bag)]
    (bag / 'metadata.yaml').unlink()
    monkeypatch.chdir(bag.parent)

    explanation = explained(bag)

    assert explanation.startswith(
        f'{bag} has no metadata.yaml, its recording was interrupted: run "ros2 bag reindex {bag}"')
    command = shlex.split(explanation.split('"')[-2])
    assert command[:3] == ['rosbags-convert', '--src', f'{bag}/bag.{SUFFIXES[storage]}']
    # The program of rosbags may not be on the PATH of the tests.
    subprocess.run(
        [sys.executable, '-c', 'from rosbags.convert.cli import main; main()', *command[1:]],
        check=True)
    assert [*bags.read(bag.with_name('NEW'))] == whole


def test_a_bag_of_ros_1_is_named_with_the_command_that_converts_it(tmp_path):
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V2.0')

    assert explained(tmp_path / 'old.bag') == (
        f'{tmp_path}/old.bag is a bag of ROS 1: convert it with "rosbags-convert --src'
        f' {tmp_path}/old.bag --dst NEW --dst-storage mcap"')


@pytest.mark.parametrize('storage', ['mcap'])
def test_the_bags_in_a_folder_that_is_none_are_named(bag):
    assert explained(bag.parent) == (
        f'{bag.parent} is no rosbag2, it has no metadata.yaml: give one of {bag}')


def test_an_empty_folder_is_no_bag(tmp_path):
    assert explained(tmp_path) == (
        f'{tmp_path} is no rosbag2, it has no metadata.yaml: give the folder of one')


@pytest.mark.parametrize('cause', [None, PermissionError()])
def test_a_bag_without_permission_is_not_called_incomplete(tmp_path, cause):
    # As the reader raises it for metadata.yaml, and for the files of a bag.
    error = ReaderError('Could not open file') if cause else PermissionError()
    error.__cause__ = cause

    assert damaged_bags.explanation(tmp_path, error) == (
        f'{tmp_path} cannot be read: permission denied: run as its owner, or change the'
        ' permissions')


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
