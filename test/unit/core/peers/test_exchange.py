# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots that give each other their logs over bad links: all arrives, once, within the rate."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.ordering.record_memory import identity
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.messages import BlockMessage, MessageRejection, read, write
from fej_slam_ros.core.records import NS, Observation, Odometry, Scan
from helpers.radio import Radio, Robot, team_settings, TICK

R = np.diag([0.01, 0.02])


def drive(robot, first=0, count=100, seed=0):
    """Let a robot measure; return what it measured."""
    rng, name = np.random.default_rng(seed), robot.logs.robot
    records = []
    for k in range(first, first + count):
        records += [
            Odometry(name, k, rng.normal(size=3), np.eye(3)),
            Scan(name, k, (Observation(k % 7, rng.normal(size=2), R),))]
    for record in records:
        robot.logs.record(record)
    return records


def team(*names, **options):
    settings = team_settings(names)
    options = {'information_first': 0, **options}
    return {name: Robot(name, settings, **options) for name in names}


def known(robot, author):
    return [identity(record) for record in robot.logs.contents(author).measurements()]


def identities(records):
    return [identity(record) for record in records]


@pytest.mark.parametrize(('loss', 'repeated'), [(0.0, 0.0), (0.2, 0.0), (0.2, 0.3), (0.5, 0.1)])
def test_everything_arrives_once_over_a_link_that_loses_and_repeats(loss, repeated):
    robots = team('p', 'q')
    driven = {name: drive(robot, seed=k) for k, (name, robot) in enumerate(robots.items())}
    radio = Radio(robots, np.random.default_rng(1), loss, repeated)

    radio.run(20.0)

    for robot in robots.values():
        assert {name: known(robot, name) for name in robots} == {
            name: identities(records) for name, records in driven.items()}
        assert robot.exchange.is_complete(radio.now)
        assert robot.exchange.bytes_sent.total() == radio.bytes[robot.logs.robot]
    # A lost packet is sent again, and little else.
    sent = sum(robot.exchange.bytes_sent['block'] for robot in robots.values())
    size = robots['p'].logs.size()
    assert sent < 1.3 * size / (1.0 - loss) + 2_000


@pytest.mark.parametrize('loss', [0.0, 0.2])
@pytest.mark.parametrize('delay', [0.05, 0.3, 0.5, 1.0, 2.0])
def test_only_lost_blocks_are_sent_again_whatever_the_delay_of_the_link(delay, loss):
    robots = team('p', 'q')
    radio = Radio(robots, np.random.default_rng(1), loss, delay=delay)
    for k in range(60):
        for name, robot in robots.items():
            drive(robot, first=3 * k, count=3, seed=ord(name) + k)
        radio.run(0.5)

    radio.run(30.0)

    assert all(len(known(robot, name)) == 360 for robot in robots.values() for name in robots)
    sent = sum(robot.exchange.bytes_sent['block'] for robot in robots.values())
    # Headers of blocks with the measurements of one period are 18 % of their size.
    assert sent < 1.3 * robots['p'].logs.size() / (1.0 - loss)


@pytest.mark.parametrize('delay', [0.0, 0.3, 2.0])
def test_a_lost_block_is_sent_again_after_a_round_trip_and_two_periods_at_most(delay):
    is_lost = [False]

    def damaged(data):
        if is_lost[0] and isinstance(read(data), BlockMessage):
            is_lost[0] = False
            return data[:-1]
        return data

    robots = team('p', 'q')
    radio = Radio(robots, np.random.default_rng(1), damage=damaged, delay=delay)
    radio.run(10.0)
    is_lost[0] = True
    driven = drive(robots['p'], count=5)

    # Until the block is sent, its way and that of the next hello, and its way again.
    radio.run(0.5 + 2.0 * delay + 2.0 * 0.5 + delay + 0.1)

    assert radio.rejected.total() == 1
    assert known(robots['q'], 'p') == identities(driven)


def test_the_round_trip_is_measured_whatever_the_clocks_of_the_robots():
    robots = team('p', 'q')
    there, waiting, back, ahead = 3 * NS // 10, NS // 7, NS, 7 * 10**15 + 123

    hello, = robots['p'].exchange.due(0)
    robots['q'].exchange.receive(hello, ahead + there)
    answer, *_ = robots['q'].exchange.due(ahead + there + waiting)
    robots['p'].exchange.receive(answer, there + waiting + back)

    # Times in hellos are in milliseconds.
    measured = robots['p'].exchange.peers['q'].round_trip
    assert measured == pytest.approx(there + back, abs=2e6)


def test_measurements_made_in_reach_arrive_within_two_periods():
    robots = team('p', 'q')
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(2.0)
    driven = drive(robots['p'], count=5)

    radio.run(1.1)

    assert known(robots['q'], 'p') == identities(driven)


def test_logs_reach_robots_that_never_meet_their_author_and_only_what_is_new_is_sent():
    robots = team('p', 'q', 'r')
    radio = Radio(robots, np.random.default_rng(1), loss=0.2)
    driven = drive(robots['p'])

    radio.run(6.0, lambda a, b: {a, b} == {'p', 'q'})
    assert known(robots['r'], 'p') == []
    radio.run(6.0, lambda a, b: {a, b} == {'q', 'r'})

    assert known(robots['r'], 'p') == identities(driven)
    before = radio.bytes.copy()
    more = drive(robots['p'], first=100, count=2, seed=5)
    # A triangle: the same blocks are offered from two sides.
    radio.run(6.0)
    assert known(robots['r'], 'p') == known(robots['q'], 'p') == identities(driven + more)
    hellos = 3 * 12 * 220
    assert (radio.bytes - before).total() < 2_500 + hellos


def test_no_more_bytes_are_sent_than_the_rate_allows():
    robots = team('p', 'q', rate=5_000.0)
    drive(robots['p'], count=1000)
    radio = Radio(robots, np.random.default_rng(1))

    radio.run(4.0)

    size = robots['p'].logs.size()
    assert size > 30_000
    # One packet more than the rate, and no savings of the time before the first hello.
    assert robots['p'].exchange.bytes_sent['block'] <= 5_000 * 4.1 + 1_300


def test_no_blocks_are_sent_while_no_robot_is_in_reach():
    robots = team('p', 'q')
    drive(robots['p'])
    radio = Radio(robots, np.random.default_rng(1))

    radio.run(5.0, lambda a, b: False)

    assert robots['p'].exchange.bytes_sent['block'] == 0
    assert robots['p'].exchange.in_reach(radio.now) == []


def test_information_about_the_rendezvous_is_sent_before_measurements():
    robots = team('p', 'q', information_first=5 * NS)
    drive(robots['p'])
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(2.0)
    assert known(robots['q'], 'p') == []

    for name, other in ('pq', 'qp'):
        robots[name].logs.publish(LogName(name, other), [b'A_m'])
    radio.run(2.0)

    assert robots['q'].logs.logs[LogName('p', 'q')].blocks == [b'A_m']
    assert len(known(robots['q'], 'p')) == 200


@pytest.mark.parametrize('author', ['p', 'q'])
@pytest.mark.parametrize('number', [0, 1])
def test_measurements_wait_for_every_block_of_the_information(author, number):
    is_lost = [True]

    def damaged(data):
        message = read(data)
        is_of_author = isinstance(message, BlockMessage) and message.block.log.about and (
            message.block.log.author, message.block.number) == (author, number)
        return data[:-1] if is_of_author and is_lost[0] else data

    robots = team('p', 'q', information_first=5 * NS)
    drive(robots['p'])
    for name, other in ('pq', 'qp'):
        robots[name].logs.publish(LogName(name, other), [b'A', b'm'])
    radio = Radio(robots, np.random.default_rng(1), damage=damaged)
    other = robots['q' if author == 'p' else 'p']
    log = LogName(author, other.logs.robot)

    radio.run(2.0)
    assert [k for k in (0, 1) if other.logs.logs[log].contains(k)] == [1 - number]
    assert known(robots['q'], 'p') == []
    is_lost[0] = False
    radio.run(2.0)

    assert other.logs.logs[log].blocks == [b'A', b'm']
    assert len(known(robots['q'], 'p')) == 200


def test_without_a_rendezvous_measurements_wait_no_longer_than_stated():
    robots = team('p', 'q', information_first=3 * NS)
    drive(robots['p'])
    radio = Radio(robots, np.random.default_rng(1))

    radio.run(2.5)
    assert known(robots['q'], 'p') == []
    radio.run(2.5)

    assert len(known(robots['q'], 'p')) == 200


def test_messages_of_yesterday_change_nothing():
    yesterday = team('p', 'q')
    drive(yesterday['p'], seed=1)
    old = []
    for k in range(40):
        # The hellos of q let p send its blocks.
        for data in yesterday['q'].exchange.due(k * TICK):
            yesterday['p'].exchange.receive(data, k * TICK)
        old += yesterday['p'].exchange.due(k * TICK)
    assert sum(isinstance(read(data), BlockMessage) for data in old) > 5
    settings = team_settings(['p', 'q'])
    robots = {
        'p': Robot('p', settings, run=2, information_first=0),
        'q': Robot('q', settings, run=2, information_first=0)}
    driven = drive(robots['p'], seed=2)
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(5.0)

    rejected = {robots['q'].exchange.receive(data, radio.now) for data in old}

    assert rejected == {MessageRejection.OLD_RUN}
    radio.run(5.0)
    assert known(robots['q'], 'p') == identities(driven)


def test_a_restarted_robot_receives_everything_again():
    robots = team('p', 'q')
    driven = drive(robots['p'])
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(3.0)
    robots['q'] = Robot('q', robots['p'].settings, run=2, information_first=0)

    radio.run(3.0)

    assert known(robots['q'], 'p') == identities(driven)


def test_a_log_that_a_restarted_robot_has_lost_is_sent_to_it_again():
    """As after a disk that was full when the log arrived: its file continues the same run."""
    robots = team('p', 'q')
    for robot in robots.values():
        drive(robot)
        robot.logs.flush()
    file = robots['p'].logs.take_new_blocks()
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(6.0)
    assert known(robots['p'], 'q') == known(robots['q'], 'q')

    robots['p'] = Robot('p', robots['p'].settings)
    for block in file:
        robots['p'].logs.restore(block)
    radio.run(6.0)

    assert known(robots['p'], 'q') == known(robots['q'], 'q')


def test_a_robot_that_is_not_a_peer_is_rejected_by_name():
    robots = team('p', 'q')
    stranger = team('q', 'stranger')['stranger']
    drive(stranger)

    rejected = {robots['q'].exchange.receive(data, k * NS)
                for k in range(3) for data in stranger.exchange.due(k * NS)}

    assert rejected == {MessageRejection.UNKNOWN_ROBOT}
    assert robots['q'].exchange.rejected_unread[MessageRejection.UNKNOWN_ROBOT] == 3


def test_random_changes_of_messages_are_rejected_and_the_rest_arrives():
    robots = team('p', 'q')
    driven = drive(robots['p'])
    rng = np.random.default_rng(3)

    def damaged(data):
        if rng.random() < 0.3:
            k = int(rng.integers(len(data)))
            data = data[:k] + bytes([data[k] ^ int(rng.integers(1, 256))]) + data[k + 1:]
        return data[:int(rng.integers(len(data)))] if rng.random() < 0.1 else data

    radio = Radio(robots, rng, damage=damaged)
    radio.run(20.0)

    assert known(robots['q'], 'p') == identities(driven)
    assert radio.rejected.keys() <= {
        MessageRejection.CORRUPT, MessageRejection.TRUNCATED, MessageRejection.OTHER_VERSION}
    assert radio.rejected.total() > 10


def test_contacts_that_are_short_add_up():
    robots = team('p', 'q', information_first=5 * NS)
    drive(robots['p'], count=20)
    radio = Radio(robots, np.random.default_rng(1))

    for _ in range(4):
        radio.run(3.0)
        radio.run(4.0, lambda a, b: False)

    assert len(known(robots['q'], 'p')) == 40


def test_a_second_robot_of_the_same_name_is_named_by_the_first():
    settings = team_settings(['p', 'q'])
    robots = {'p': Robot('p', settings, run=3, information_first=0), 'q': Robot('q', settings)}
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(3.0)
    # It begins with a clock that has gone back, or is another one.
    robots['p'] = Robot('p', settings, run=2, information_first=0)

    radio.run(2.0)

    assert robots['p'].exchange.peers['q'].rejected[MessageRejection.SAME_NAME] > 0


def test_hellos_are_heard_again_after_the_clock_of_a_robot_has_gone_back():
    robots = team('p', 'q')
    radio = Radio(robots, np.random.default_rng(1))
    for data in robots['q'].exchange.due(10**15):
        robots['p'].exchange.receive(data, 1)
    driven = drive(robots['p'])

    radio.run(5.0)

    assert known(robots['q'], 'p') == identities(driven)
    assert robots['p'].exchange.bytes_sent['block'] < 1.1 * robots['p'].logs.size()


def test_blocks_are_not_sent_again_without_a_newer_hello():
    robots = team('p', 'q')
    drive(robots['p'])
    hello, = robots['q'].exchange.due(0)
    robots['p'].exchange.receive(hello, 0)

    sent = [data for k in range(1, 100) for data in robots['p'].exchange.due(k * TICK)]

    blocks = [data for data in sent if isinstance(read(data), BlockMessage)]
    assert len(blocks) == len({*blocks}) == len(robots['p'].logs.logs[LogName('p')].blocks)


def test_logs_of_robots_outside_of_the_team_are_neither_stored_nor_waited_for():
    robots = team('p', 'q')
    stranger = team('q', 'stranger')['stranger']
    drive(stranger, count=3)
    stranger.logs.flush()
    block = stranger.logs.logs[LogName('stranger')].block(0)
    data = write(BlockMessage('q', block))

    assert robots['p'].exchange.receive(data, 0) is MessageRejection.UNKNOWN_ROBOT
    about = write(BlockMessage('q', replace(block, log=LogName('q', 'x'))))
    assert robots['p'].exchange.receive(about, 0) is MessageRejection.UNKNOWN_ROBOT
    assert robots['p'].logs.logs.keys() == {LogName('p')}


def bytes_of_blocks(robots, radio, seconds):
    """Return the bytes of blocks that each robot sends in a time."""
    before = {name: robot.exchange.bytes_sent['block'] for name, robot in robots.items()}
    radio.run(seconds)
    return {
        name: robot.exchange.bytes_sent['block'] - before[name]
        for name, robot in robots.items()}


def test_logs_of_a_former_peer_are_given_once_to_robots_that_lack_them():
    robots = team('p', 'q', 'z')
    driven = {name: drive(robot, seed=k) for k, (name, robot) in enumerate(robots.items())}
    radio = Radio(robots, np.random.default_rng(1), loss=0.2)
    radio.run(20.0)
    del robots['z']
    # q is restarted and p continues with its logs, both without z among their peers.
    stored = robots['p'].logs.take_new_blocks()
    robots['p'] = Robot('p', team_settings(['p', 'q']), run=2, information_first=0)
    for block in stored:
        robots['p'].logs.restore(block)
    robots['q'] = Robot('q', robots['q'].settings, run=2, information_first=0)

    radio.run(20.0)

    assert known(robots['q'], 'z') == identities(driven['z'])
    assert bytes_of_blocks(robots, radio, 20.0) == {'p': 0, 'q': 0}
    assert robots['p'].exchange.is_complete(radio.now)


def test_a_log_that_another_robot_does_not_want_is_not_sent_to_it_for_ever():
    robots = team('p', 'q', 'z')
    robots['q'] = Robot('q', team_settings(['p', 'q']), information_first=0)
    for robot in robots.values():
        drive(robot)
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(20.0, lambda a, b: {a, b} != {'q', 'z'})
    del robots['z']

    sent = bytes_of_blocks(robots, radio, 20.0)

    # The first block, in case that all of it was lost, each time a robot would be out of reach.
    size = len(robots['p'].logs.logs[LogName('z')].blocks[0]) + 100
    assert sent['p'] <= size * 20.0 / 2.0 < 0.5 * robots['p'].logs.size()
    assert sent['q'] == 0


def test_nothing_more_is_sent_of_a_robot_that_is_no_longer_a_peer_of_the_receiver():
    robots = team('p', 'q')
    drive(robots['p'], count=3)
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(3.0)
    robots['q'].exchange.change_peers([])
    radio.run(1.0)
    drive(robots['p'], first=3)

    assert bytes_of_blocks(robots, radio, 10.0)['p'] == 0


def test_a_robot_that_overheard_a_part_of_a_log_sends_nothing_to_one_that_has_all_of_it():
    robots = team('p', 'q', 'z')
    radio = Radio(robots, np.random.default_rng(1))
    radio.run(1.0)
    name = LogName('p', 'q')
    robots['p'].logs.publish(name, [b'A', b'_', b'm'])
    for block in map(robots['p'].logs.logs[name].block, (0, 2)):
        # The block between was lost, and z is not sent what is about q.
        robots['z'].logs.add(block)
    radio.run(3.0, lambda a, b: {a, b} == {'p', 'q'})
    assert robots['q'].logs.logs[name].blocks == [b'A', b'_', b'm']

    sent = bytes_of_blocks(robots, radio, 10.0)

    assert robots['z'].logs.logs[name].knowledge().ahead == {2}
    assert sent == dict.fromkeys(robots, 0)
