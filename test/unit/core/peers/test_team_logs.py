# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of a team do not depend on the order of blocks, and contain each block once."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.ordering.record_memory import identity
from fej_slam_ros.core.peers.blocks import encoded, RestOfScan
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.messages import MAX_BLOCK_SIZE, MessageRejectedError, MessageRejection
from fej_slam_ros.core.peers.team_logs import TeamLogs, TeamParameters
from fej_slam_ros.core.records import Observation, Odometry, Scan
from fej_slam_ros.core.settings import NoiseSettings

NOISE = NoiseSettings(
    odometry_noise_scale=2.0, odometry_scale=(0.95, 1.04), odometry_turn_bias=-0.01,
    observation_range_scale=1.03, observation_bearing_bias=-0.02, observation_noise_growth=0.2)
R = np.diag([0.01, 0.02])


def written(robot='q', count=200, run=1, seed=0, observations=3):
    """Return the logs of a robot after some measurements, and these."""
    rng = np.random.default_rng(seed)
    logs, records = TeamLogs(robot, run, NOISE), []
    for k in range(count):
        records += [
            Odometry(robot, k, rng.normal(size=3), np.eye(3)),
            Scan(robot, k, tuple(
                Observation(i, rng.normal(size=2), R) for i in range(observations)))]
    for record in records:
        logs.record(record)
    logs.flush()
    return logs, records


def blocks_of(logs, robot='q'):
    log = logs.logs[LogName(robot)]
    return [log.block(number) for number in range(len(log.blocks))]


def receiver():
    return TeamLogs('p', 1, NOISE)


def rejection(logs, block):
    with pytest.raises(MessageRejectedError) as rejected:
        logs.add(block)
    return rejected.value.reason


def contents(records):
    return [identity(record) for record in records]


def test_all_orders_and_repetitions_of_blocks_give_the_same_log():
    sender, records = written()
    blocks, rng = blocks_of(sender), np.random.default_rng(3)
    assert len(blocks) > 10

    for _ in range(20):
        logs = receiver()
        new = sum(logs.add(blocks[k]) for k in [
            *rng.permutation(len(blocks)), *rng.integers(len(blocks), size=30)])

        assert new == len(blocks)
        assert contents(logs.contents('q').measurements()) == contents(records)
        assert logs.noise['q'] == NOISE
        assert logs.logs[LogName('q')].digests == sender.logs[LogName('q')].digests


def test_own_measurements_are_known_before_their_block_is_closed():
    logs = TeamLogs('q', 1, NOISE)
    _, records = written(count=3, observations=20)

    for record in records:
        logs.record(record)

    assert logs.take_new_blocks()[1:] == []
    assert contents(logs.contents('q').measurements()) == contents(records)


def test_measurements_behind_a_missing_block_wait_for_it():
    sender, records = written()
    logs, (first, second, third, *_) = receiver(), blocks_of(sender)

    logs.add(first)
    logs.add(third)
    assert logs.contents('q').measurements() == []
    logs.add(second)

    known = contents(logs.contents('q').measurements())
    assert known == contents(records)[:len(known)]
    assert len(known) > 0


def test_blocks_fit_into_a_packet_and_large_scans_become_one_again():
    sender, records = written(count=20, observations=100)

    assert max(len(block.content) for block in blocks_of(sender)) <= MAX_BLOCK_SIZE
    logs = receiver()
    for block in blocks_of(sender):
        logs.add(block)
    assert contents(logs.contents('q').measurements()) == contents(records)
    assert contents(sender.contents('q').measurements()) == contents(records)


def test_blocks_that_compress_well_can_be_read_again():
    """Scans of a robot at rest without noise: thousands would fit into a packet."""
    logs = TeamLogs('q', 1, NOISE)
    seen = tuple(Observation(i, np.ones(2), R) for i in range(8))
    for k in range(450):
        logs.record(Scan('q', k, seen))
    logs.flush()

    assert len(logs.contents('q').measurements()) == 450


def test_a_log_cannot_begin_with_the_rest_of_a_scan():
    sender, _ = written(count=1)
    logs, (first, second) = receiver(), blocks_of(sender)
    logs.add(first)

    rest = replace(second, content=encoded([RestOfScan('q', 1, ())]))

    assert rejection(logs, rest) is MessageRejection.BAD_CONTENT


def test_a_block_that_differs_from_the_known_one_is_rejected():
    sender, _ = written()
    logs, (first, second, *_) = receiver(), blocks_of(sender)
    logs.add(first)
    logs.add(second)

    assert rejection(logs, replace(second, content=encoded([]))) is MessageRejection.CONTRADICTION
    assert rejection(logs, replace(second, digest=b'12345678')) is MessageRejection.CONTRADICTION


def test_a_block_that_does_not_follow_the_known_ones_is_rejected():
    one, _ = written(seed=0)
    other, _ = written(seed=1)
    logs = receiver()
    for block in blocks_of(one)[:3]:
        logs.add(block)

    assert rejection(logs, blocks_of(other)[3]) is MessageRejection.CONTRADICTION
    # The log goes on as its author wrote it.
    assert logs.add(blocks_of(one)[3])


def test_an_earlier_run_is_rejected_and_a_later_one_replaces_it():
    yesterday, _ = written(run=1, seed=1)
    today, records = written(run=2, seed=2)
    logs = receiver()
    for block in blocks_of(yesterday):
        logs.add(block)

    assert rejection(logs, blocks_of(today)[4]) is MessageRejection.TOO_FAR_AHEAD
    for block in blocks_of(today):
        logs.add(block)

    assert contents(logs.contents('q').measurements()) == contents(records)
    assert rejection(logs, blocks_of(yesterday)[0]) is MessageRejection.OLD_RUN


def test_later_information_replaces_the_earlier_when_its_first_block_arrives_in_whatever_order():
    name, sender, logs = LogName('q', 'p'), TeamLogs('q', 1, NOISE), receiver()
    earlier, later = [b'a', b'b'], [b'c', b'd', b'e']
    sender.publish(name, earlier)
    for number in (1, 0):
        logs.add(sender.logs[name].block(number))
    sender.publish(name, later)
    blocks = [sender.logs[name].block(number) for number in range(3)]

    assert [logs.add(blocks[k]) for k in (2, 1, 2)] == [True, True, False]
    assert logs.logs[name].blocks == earlier
    assert logs.add(blocks[0])

    assert logs.logs[name].blocks == later


def test_a_later_run_that_begins_badly_replaces_nothing():
    sender, records = written()
    logs = receiver()
    for block in blocks_of(sender):
        logs.add(block)

    first = blocks_of(sender)[0]

    assert rejection(logs, replace(first, run=9, content=b'?')) is MessageRejection.BAD_CONTENT
    other = replace(first, run=9, digest=b'12345678')
    assert rejection(logs, other) is MessageRejection.CONTRADICTION
    assert contents(logs.contents('q').measurements()) == contents(records)


def test_a_log_ends_where_its_content_is_impossible():
    sender, _ = written()
    logs, (first, second, *_) = receiver(), blocks_of(sender)
    logs.add(first)

    bad = replace(second, content=encoded([Odometry('q', 5, np.full(3, np.nan), None)]))

    assert rejection(logs, bad) is MessageRejection.BAD_CONTENT
    assert logs.logs[LogName('q')].knowledge().is_ended


@pytest.mark.parametrize('parameter', TeamParameters._fields)
def test_the_log_of_a_robot_with_other_team_parameters_is_rejected_with_the_parameter(parameter):
    common = TeamParameters(shared_landmark_ids=False, keyframe_distance=0.5)
    other = common._replace(**{parameter: {'shared_landmark_ids': True}.get(parameter, 0.6)})
    logs = TeamLogs('p', 1, NOISE, common)

    first, = blocks_of(TeamLogs('q', 1, NOISE, other))
    assert rejection(logs, first).value == f'other_{parameter}'

    assert logs.differing == {'q': parameter}
    assert logs.robots == ['p']
    # No more of it is asked for, until its author begins again.
    assert logs.logs[LogName('q')].knowledge().is_ended
    restarted, = blocks_of(TeamLogs('q', 2, NOISE, common))
    assert logs.add(restarted)
    assert (logs.differing, logs.robots) == ({}, ['p', 'q'])


@pytest.mark.parametrize('distance', [-1.0, np.nan, np.inf])
def test_an_impossible_distance_of_keyframes_ends_a_log(distance):
    parameters = TeamParameters(keyframe_distance=distance)
    first, = blocks_of(TeamLogs('q', 1, NOISE, parameters))

    assert rejection(receiver(), first) is MessageRejection.BAD_CONTENT


def test_another_robot_of_the_same_name_is_noticed():
    _, other = written('p'), written('p', run=7)[0]

    assert rejection(receiver(), blocks_of(other, 'p')[0]) is MessageRejection.SAME_NAME


def test_what_others_still_have_of_an_own_earlier_run_is_of_no_other_robot():
    earlier, logs = TeamLogs('p', 10, NOISE), TeamLogs('p', 20, NOISE)
    earlier.publish(LogName('p', 'q'), [b'information'])
    earlier.flush()

    for block in earlier.take_new_blocks():
        assert rejection(logs, block) is MessageRejection.OLD_RUN


def test_an_own_block_that_another_robot_sends_back_is_known():
    logs, _ = written('p')

    assert not any(logs.add(block) for block in blocks_of(logs, 'p'))


def test_a_restarted_robot_continues_its_run():
    sender, records = written(count=50)
    stored = sender.take_new_blocks()
    restarted = TeamLogs('q', 99, NoiseSettings())
    for block in stored:
        restarted.restore(block)
    restarted.record(Odometry('q', 1000, np.ones(3), None))
    restarted.flush()

    assert restarted.run == 1
    assert contents(restarted.contents('q').measurements())[:-1] == contents(records)
    logs = receiver()
    for block in [*stored, *blocks_of(restarted)]:
        logs.add(block)
    known, stored_by_q = (
        team_logs.contents('q').measurements() for team_logs in (logs, restarted))
    assert contents(known) == contents(stored_by_q)
    assert restarted.take_new_blocks()[0].number == len(stored)


def test_full_blocks_can_be_given_to_others_before_the_newest_one_is_closed():
    logs = TeamLogs('q', 1, NOISE)
    _, records = written(count=25, observations=8)

    for record in records:
        logs.record(record)

    _, first, *_ = logs.take_new_blocks()
    assert len(first.content) > MAX_BLOCK_SIZE / 2


def test_information_has_at_most_sixteen_blocks():
    name, sender, logs = LogName('q', 'p'), TeamLogs('q', 1, NOISE), receiver()
    sender.publish(name, [b'%d' % number for number in range(17)])

    assert logs.add(sender.logs[name].block(15))
    assert rejection(logs, sender.logs[name].block(16)) is MessageRejection.TOO_FAR_AHEAD


def test_information_that_has_arrived_in_part_is_replaced_by_a_later_one():
    name, sender, logs = LogName('q', 'p'), TeamLogs('q', 1, NOISE), receiver()
    # The first part of the second information is lost.
    for contents_, numbers in (
            ([b'a', b'b'], (0, 1)), ([b'c', b'd'], (1,)), ([b'e', b'f'], (1, 0))):
        sender.publish(name, contents_)
        for number in numbers:
            assert logs.add(sender.logs[name].block(number))

    assert logs.logs[name].blocks == [b'e', b'f']


def test_a_delayed_part_of_earlier_information_does_not_replace_what_has_arrived_since():
    name, sender, logs, blocks = LogName('q', 'p'), TeamLogs('q', 1, NOISE), receiver(), []
    for contents_ in ([b'a'], [b'c', b'd'], [b'e', b'f']):
        sender.publish(name, contents_)
        blocks.append([sender.logs[name].block(k) for k in range(len(contents_))])
    (first,), (_, delayed), (head, rest) = blocks

    assert all(map(logs.add, (first, rest)))
    assert rejection(logs, delayed) is MessageRejection.OLD_RUN
    assert logs.add(head)

    assert logs.logs[name].blocks == [b'e', b'f']


def test_a_later_run_does_not_go_on_with_the_last_scan_of_the_earlier_one():
    yesterday, _ = written(run=1)
    today = TeamLogs('q', 2, NOISE)
    today.record(RestOfScan('q', 1, ()))
    today.flush()
    logs = receiver()
    for block in (*blocks_of(yesterday), blocks_of(today)[0]):
        logs.add(block)

    assert rejection(logs, blocks_of(today)[1]) is MessageRejection.BAD_CONTENT


def test_after_a_block_that_does_not_follow_the_known_ones_others_are_asked_for_the_right_one():
    one, other = written(seed=0)[0], written(seed=1)[0]
    logs = receiver()
    for block in blocks_of(one)[:3]:
        logs.add(block)

    rejection(logs, blocks_of(other)[3])

    knowledge = logs.logs[LogName('q')].knowledge()
    assert 3 in one.logs[LogName('q')].missing(knowledge)
