# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags are compatible with other programs, and appear only when complete."""

from collections import Counter
from contextlib import suppress
from dataclasses import replace
import json
import re
from time import process_time

import pytest
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader, Writer
from ruamel.yaml import YAML

from fej_slam_ros.core.records import fingerprint, TrueLandmarks
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES
from fej_slam_ros.ros.messages.cloud import read_cloud
from helpers.optional import given, settings, strategies as st
from helpers.records import odometry, robot_scan
from helpers.ros import (
    CLOUD, decoded, empty_cloud, meeting, meeting_truth, ODOMETRY, odometry_message, raw,
    raw_record, seen, TYPES, write_bag)

SUFFIXES = {'mcap': 'mcap', 'sqlite3': 'db3'}

RECORDS = [*meeting_truth(), *meeting()]

each_storage = pytest.mark.parametrize('storage', SUFFIXES)


@pytest.fixture
def path(tmp_path):
    return tmp_path / 'bag'


def metadata(path):
    content = YAML(typ='safe').load(path / 'metadata.yaml')
    return content['rosbag2_bagfile_information']


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@each_storage
def test_messages_are_read_in_the_order_of_writing(path, storage):
    bags.write(path, RECORDS, storage)

    in_time = sorted(RECORDS, key=lambda record: record.stamp)
    assert list(bags.read(path)) == [raw_record(record) for record in in_time]


@each_storage
def test_messages_are_counted_in_the_files_and_not_in_the_metadata(path, storage):
    bags.write(path, meeting(), storage)
    listed = (path / 'metadata.yaml').read_text()
    (path / 'metadata.yaml').write_text(re.sub('message_count: .*', 'message_count: 0', listed))

    counts = {name: topic.messages for name, topic in bags.topics(path).items()}

    assert counts == Counter(message.topic for message in bags.read(path))
    # The records are those of two robots at five steps, scans from the second on.
    assert counts == {'r1/odom': 5, 'r2/odom': 5, 'r1/landmarks': 4, 'r2/landmarks': 4}


@each_storage
def test_messages_of_two_types_on_one_topic_are_counted_apart(path, storage):
    with Writer(path, version=9, storage_plugin=bags.STORAGES[storage]) as bag:
        for type_name, count in (ODOMETRY, 5), (CLOUD, 3):
            connection = bag.add_connection('/r1/odom', type_name, typestore=TYPES)
            for k in range(count):
                bag.write(connection, k, b'')

    assert bags.miscounted(path, RECORDED_NAMES) == {}


@each_storage
def test_the_records_of_a_bag_equal_the_written_ones(path, storage):
    records = meeting()
    bags.write(path, records, storage)

    read = [decoded(message) for message in bags.read(path)]

    assert [type(record) for record in read] == [type(record) for record in records]
    assert [(r.robot, r.stamp, fingerprint(r)) for r in read] == [
        (r.robot, r.stamp, fingerprint(r)) for r in records]


def test_a_bag_has_observed_robots_by_id(path):
    bags.write(path, [robot_scan('r1', 5, [('r2', (3.0, 1.0))])], robot_ids={'r1': 4, 'r2': 9})

    (message,) = bags.read(path)

    columns = read_cloud(TYPES.deserialize_cdr(message.raw, message.type_name), ['x', 'y', 'id'])
    assert message.topic == 'r1/robots'
    assert {name: column.tolist() for name, column in columns.items()} == {
        'x': [3.0], 'y': [1.0], 'id': [9]}


@each_storage
def test_the_reader_of_another_program_finds_every_message(path, storage):
    bags.write(path, RECORDS, storage)

    with Reader(path) as reader:
        found = [(c.topic, stamp, TYPES.deserialize_cdr(data, c.msgtype))
                 for c, stamp, data in reader.messages()]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, _, m in found]
    assert len(found) == len(RECORDS)
    assert [stamp for _, stamp, _ in found] == stamps
    assert {topic for topic, _, _ in found} == {
        '/r1/odom', '/r1/landmarks', '/r1/ground_truth', '/r2/odom', '/r2/landmarks',
        '/r2/ground_truth', '/ground_truth/landmarks'}


@each_storage
def test_a_bag_of_another_program_is_read(path, storage):
    messages = [
        raw('r1/odom', odometry_message(10), 10), raw('r1/landmarks', seen((1, 2.0, 3.0)), 20)]

    write_bag(path, messages, storage)

    assert list(bags.read(path)) == messages


def test_a_bags_file_is_read_without_its_folder(path):
    bags.write(path, RECORDS)

    assert list(bags.read(path / 'bag.mcap')) == list(bags.read(path))


@each_storage
def test_a_bag_has_the_layout_of_version_9(path, storage):
    bags.write(path, RECORDS, storage)

    info = metadata(path)
    assert names(path) == [f'bag.{SUFFIXES[storage]}', 'metadata.yaml']
    assert (info['version'], info['storage_identifier']) == (9, storage)
    assert info['relative_file_paths'] == [f'bag.{SUFFIXES[storage]}']
    assert info['message_count'] == len(RECORDS)
    assert {t['topic_metadata']['serialization_format']
            for t in info['topics_with_message_count']} == {'cdr'}
    assert all(t['topic_metadata']['type_description_hash'].startswith('RIHS01_')
               for t in info['topics_with_message_count'])


@each_storage
def test_every_topic_offers_a_quality_of_service(path, storage):
    with bags.BagWriter(path, storage) as bag:
        for topic in ('r1/odom', 'r1/landmarks', 'r1/map_landmarks', 'estimator/landmarks',
                      'ground_truth/landmarks', 'r1/ground_truth', 'estimator/joint_covariance'):
            bag.write(topic, 5, empty_cloud())

    with Reader(path) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert {len(profiles) for profiles in offered.values()} == {1}
    assert {qos.reliability for (qos,) in offered.values()} == {QosReliability.RELIABLE}
    assert {qos.history for (qos,) in offered.values()} == {QosHistory.KEEP_LAST}
    assert {
        topic for topic, (qos,) in offered.items()
        if qos.durability is QosDurability.TRANSIENT_LOCAL
    } == {'/r1/map_landmarks', '/estimator/landmarks', '/ground_truth/landmarks'}


@each_storage
def test_topics_have_type_count_and_durability(path, storage):
    bags.write(path, [TrueLandmarks({}, 0), odometry('r1', 0), odometry('r1', 100)], storage)

    assert bags.topics(path) == {
        'ground_truth/landmarks': bags.BagTopic(CLOUD, 1, latched=True),
        'r1/odom': bags.BagTopic(ODOMETRY, 2, latched=False)}


@each_storage
def test_a_time_of_recording_that_no_clock_of_ros_has_is_unknown(path, storage):
    messages = [replace(m, received=t) for m, t in zip(
        map(raw_record, meeting()), (0, 2**31 * 10**9 - 1, 2**31 * 10**9, 2**63 - 1))]
    write_bag(path, messages, storage)

    assert [m.received for m in bags.read(path)] == [0, 2**31 * 10**9 - 1, None, None]


@each_storage
def test_an_empty_bag_is_a_bag(path, storage):
    bags.write(path, [], storage)

    assert (bags.topics(path), list(bags.read(path))) == ({}, [])


@pytest.mark.parametrize('force', [False, True])
@pytest.mark.parametrize('make', [
    lambda path: path.mkdir(), lambda path: path.write_text('precious'),
    lambda path: (path / 'metadata.yaml').mkdir(parents=True)])
def test_a_path_that_is_no_bag_is_never_replaced(path, make, force):
    make(path)

    with pytest.raises(UsageError, match='choose another path'):
        bags.write(path, RECORDS, force=force)

    assert names(path.parent) == ['bag']
    assert path.is_dir() or path.read_text() == 'precious'


def test_a_bag_is_replaced_only_with_force(path):
    bags.write(path, RECORDS)

    with pytest.raises(UsageError, match=r'bag exists: .*--force'):
        bags.write(path, RECORDS[:1])
    bags.write(path, RECORDS[:1], 'sqlite3', force=True)

    assert len(list(bags.read(path))) == 1
    assert names(path) == ['bag.db3', 'metadata.yaml']
    assert names(path.parent) == ['bag']


@pytest.mark.parametrize('make', [
    lambda path: path.write_text('precious'), lambda path: path.mkdir()], ids=['file', 'folder'])
def test_a_bag_in_a_folder_with_something_else_is_never_replaced(path, make):
    bags.write(path, RECORDS)
    make(path / 'notes')

    with pytest.raises(UsageError, match='notes is in the folder that would be replaced'):
        bags.write(path, RECORDS[:1], force=True)

    assert names(path) == ['bag.mcap', 'metadata.yaml', 'notes']
    assert len(list(bags.read(path))) == len(RECORDS)


@each_storage
@pytest.mark.parametrize('error', [ZeroDivisionError, KeyboardInterrupt])
def test_an_interrupted_bag_leaves_nothing_behind(path, storage, error):
    def interrupted():
        yield from RECORDS
        raise error

    with pytest.raises(error):
        bags.write(path, interrupted(), storage)

    assert names(path.parent) == []


def test_an_interrupted_bag_leaves_the_one_that_it_was_to_replace(path):
    bags.write(path, RECORDS)

    with pytest.raises(ZeroDivisionError):
        bags.write(path, (RECORDS[1 // k] for k in (1, 0)), force=True)

    assert len(list(bags.read(path))) == len(RECORDS)
    assert names(path.parent) == ['bag']


def test_remains_of_a_killed_writer_are_deleted(path):
    (path.parent / '.bag.partial' / 'bag').mkdir(parents=True)

    bags.write(path, RECORDS)

    assert names(path.parent) == ['bag']


def test_missing_parent_folders_are_created(path):
    bags.write(path / 'of' / 'today', RECORDS[:1])

    assert len(list(bags.read(path / 'of' / 'today'))) == 1


def test_a_path_that_cannot_be_written_is_named(path):
    path.write_text('')

    with pytest.raises(UserError, match=r'cannot write to .*bag: File exists: '):
        bags.write(path / 'new', RECORDS)


def unreadable(path):
    """Read a bag in both ways; return the explanation, which is one line either way."""
    messages = []
    for read in (bags.topics, lambda path: list(bags.read(path))):
        with pytest.raises(UserError) as error:
            read(path)
        messages.append(str(error.value))
    assert messages[0] == messages[1]
    assert '\n' not in messages[0]
    assert messages[0].startswith(str(path))
    return messages[0].removeprefix(f'{path} ')


def test_a_missing_bag_is_named(path):
    assert 'does not exist' in unreadable(path)


def test_a_folder_that_is_no_bag_is_named(path):
    path.mkdir()

    assert 'metadata' in unreadable(path)


@pytest.mark.parametrize(
    'text', ['', 'x', '{', '[1, 2', 'rosbag2_bagfile_information: {}', '\x00', 'a: b: c\n- d',
             'rosbag2_bagfile_information: {version: 99}', 'rosbag2_bagfile_information: 7'])
def test_damaged_metadata_are_explained(path, text):
    bags.write(path, RECORDS)
    (path / 'metadata.yaml').write_text(text)

    assert unreadable(path)


MERGED = 'a0: &a0 {a: 1}\n' + ''.join(
    f'a{k}: &a{k} {{<<: [{",".join([f"*a{k - 1}"] * 9)}]}}\n' for k in range(1, 11))


@pytest.mark.parametrize('text', [
    MERGED, '[' * 3000, 'a: &a [*a]\n',
    f'rosbag2_bagfile_information: {{offered_qos_profiles: {json.dumps(MERGED)}}}\n'])
def test_metadata_that_describe_more_than_they_contain_are_explained_at_once(path, text):
    bags.write(path, RECORDS)
    (path / 'metadata.yaml').write_text(text)
    begin = process_time()

    assert unreadable(path)
    assert process_time() - begin < 1.0


def test_metadata_that_are_not_text_are_explained(path):
    bags.write(path, RECORDS)
    (path / 'metadata.yaml').write_bytes(b'\xff\xfe\x00')

    assert unreadable(path)


@each_storage
@pytest.mark.parametrize('share', [0.0, 0.1, 0.5, 0.9])
def test_a_truncated_bag_is_explained(path, storage, share):
    bags.write(path, RECORDS, storage)
    file = path / f'bag.{SUFFIXES[storage]}'
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])

    assert unreadable(path)


def test_a_bag_whose_data_are_missing_is_explained(path):
    bags.write(path, RECORDS)
    (path / 'bag.mcap').unlink()

    assert 'bag.mcap' in unreadable(path)


@pytest.fixture(scope='module', params=SUFFIXES)
def whole(request, tmp_path_factory):
    """Return the data file of a small bag, and its bytes."""
    path = tmp_path_factory.mktemp('damaged') / 'bag'
    bags.write(path, meeting(2), request.param)
    file = path / f'bag.{SUFFIXES[request.param]}'
    return file, file.read_bytes()


@given(st.dictionaries(st.integers(0, 2**20), st.integers(0, 255), min_size=1, max_size=5))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_damaged_data_are_read_or_explained(whole, damage):
    file, intact = whole
    damaged = bytearray(intact)
    for place, value in damage.items():
        damaged[place % len(damaged)] = value
    file.write_bytes(damaged)

    with suppress(UserError):
        assert len(list(bags.read(file.parent))) <= len(meeting(2))


def test_a_reader_that_stops_early_raises_nothing(path):
    bags.write(path, RECORDS)
    messages = bags.read(path)

    next(messages)
    messages.close()
