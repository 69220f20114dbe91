# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions that exchange their measurements: the central result, also after restarts."""

from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.ordering.record_memory import identity
from fej_slam_ros.core.peers.messages import Hello, read, write
from fej_slam_ros.core.peers.union import smoothed_union
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.exchange_file import ExchangeFile
from fej_slam_ros.ros.messages import deserialize, RawMessage, serialize
from fej_slam_ros.ros.session import peer_reports, peer_session
from fej_slam_ros.ros.session.peer_session import PeerSession
from fej_slam_ros.ros.session.smoother_session import BagSmootherSession
from fej_slam_ros.ros.topic_types import EXCHANGE_TOPIC, EXCHANGE_TYPE
from helpers.paths import BAGS
from helpers.records import odometry, scan
from helpers.ros import raw_record

BAG = BAGS / 'rendezvous'


class Clock:
    """The monotonic clock of all sessions."""

    def __init__(self, monkeypatch):
        self.now = 0
        for module in (peer_session, peer_reports):
            monkeypatch.setattr(module, 'monotonic_ns', lambda: self.now)


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that the test moves on."""
    return Clock(monkeypatch)


@cache
def messages():
    return [*bags.read(BAG)]


def settings(robots, peers=(), **values):
    return parameters.parse({
        'robots': robots, 'shared_landmark_ids': False, **({'peers': peers} if peers else {}),
        **values})


#: Files of the exchange by path.
OPEN = {}


@pytest.fixture(autouse=True)
def _closed_files():
    yield
    for path in [*OPEN]:
        OPEN.pop(path).close()


def opened(path, robot):
    """Open a file of the exchange, after the process that had it before has ended."""
    if path in OPEN:
        OPEN.pop(path).close()
    OPEN[path] = ExchangeFile(path, robot)
    return OPEN[path]


def session(name, other, folder=None, open_exchange=opened, **values):
    return PeerSession(
        settings([name], [other], **values), folder, solve_every=10**9,
        open_exchange=open_exchange)


def exchanged(
    sessions, clock, seconds, lost=lambda message: False, is_over=lambda published: False
):
    """Let time pass while the sessions hear each other; return what they have published."""
    published = []
    for _ in range(round(10 * seconds)):
        clock.now += NS // 10
        for sender in sessions.values():
            for topic, message in sender.exchange():
                published.append((topic, message))
                if not lost(message):
                    for other in sessions.values():
                        other.receive(RawMessage(topic, EXCHANGE_TYPE, None, serialize(message)))
            if sender.is_solution_due(10**9):
                function, task = sender.solving()
                published += sender.adopt(function(task))
        if is_over(published):
            break
    return published


def feed(sessions, message):
    """Give a message to the session of its robot."""
    name = message.topic.lstrip('/').partition('/')[0]
    if name in sessions:
        list(sessions[name].receive(message))
        list(sessions[name].take())


def fed(sessions, messages, clock):
    """Give each session the messages of its robot, and time to exchange."""
    for k, message in enumerate(messages):
        feed(sessions, message)
        if k % 50 == 0:
            exchanged(sessions, clock, 0.2)


@cache
def central():
    """Return the closed run of the central smoother."""
    run = BagSmootherSession(settings(['p', 'q']), None)
    for message in messages():
        list(run.receive(message))
        list(run.take())
    list(run.close())
    return run


def closed(run):
    list(run.close())
    return run


def known_of_p(run):
    """Return the identities of the measurements of p that a robot knows."""
    return [identity(m) for m in run.team.logs.contents('p').measurements()]


def poses(run, name):
    return run.team.trajectories[name].poses()


def test_both_robots_end_with_the_central_result(clock, tmp_path):
    sessions = {
        'p': session('p', 'q', tmp_path / 'p'), 'q': session('q', 'p', tmp_path / 'q')}
    fed(sessions, messages(), clock)
    numbers = count()
    exchanged(sessions, clock, 10.0, lost=lambda _: next(numbers) % 5 == 0)

    expected = central()
    for name, run in sessions.items():
        assert closed(run).team.not_in_map() == {}, name
        run.write_files()
    # With p as the anchor, p has the very bits; rounding, where q is the anchor of its own map.
    for name in 'pq':
        assert_allclose(poses(sessions['p'], name), poses(expected, name), rtol=0.0, atol=1e-9)
    assert sessions['p'].state_hash() == expected.state_hash()
    for file in ('trajectory_p.csv', 'trajectory_q.csv', 'landmarks.csv', 'alignment.json'):
        assert (tmp_path / 'p' / file).exists()
        assert (tmp_path / 'q' / file).exists()


def test_robots_that_become_peers_during_a_run_end_with_the_central_result(clock, tmp_path):
    # z comes last, so that the IDs of p and q stay.
    sessions = {'p': session('p', 'z', tmp_path / 'p'), 'q': session('q', 'p')}
    given = messages()
    fed(sessions, given[:200], clock)
    assert 'q' not in sessions['p'].team.logs.robots

    with pytest.raises(UsageError, match="would change the ID of 'z' from 2 to 3"):
        sessions['p'].change_team(['p', 'z', 'q'])
    sessions['p'].change_team(['p', 'q'])
    fed(sessions, given[200:], clock)
    exchanged(sessions, clock, 10.0)

    assert [(robot.name, robot.id) for robot in sessions['p'].present_settings().robots] == [
        ('p', 1), ('q', 2)]
    assert {'q/pose', 'q/base_node'} <= sessions['p'].outputs.topics.keys()
    for name, run in sessions.items():
        assert closed(run).team.not_in_map() == {}, name
    assert sessions['p'].state_hash() == central().state_hash()
    sessions['p'].write_files()
    assert (tmp_path / 'p' / 'trajectory_q.csv').exists()


def test_a_peer_that_returns_has_the_id_of_its_parameter():
    run = PeerSession(
        settings(['p'], ['q', 'r'], **{'p.id': 10, 'q.id': 3, 'r.id': 30}), None,
        open_exchange=opened)

    def ids_after(*peers):
        run.change_team(['p', *peers])
        return {robot.name: robot.id for robot in run.present_settings().robots}

    assert ids_after('r') == {'p': 10, 'r': 30}
    assert ids_after('q', 'r') == {'p': 10, 'q': 3, 'r': 30}
    ids_after('r')
    # As the third of the sorted names, 'pb' would have the ID of q.
    ids = ids_after('r', 'pa', 'pb', 'q')
    assert (ids['q'], ids['pa']) == (3, 2)
    assert len({*ids.values()}) == 5


def test_nothing_is_exchanged_with_a_former_peer_whose_measurements_stay(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    given = messages()
    fed(sessions, given[:400], clock)
    exchanged(sessions, clock, 5.0)
    known = len(sessions['p'].team.logs.contents('q').measurements())

    sessions['p'].change_team(['p', 'z'])
    fed(sessions, given[400:], clock)
    exchanged(sessions, clock, 5.0)

    assert 0 < known == len(sessions['p'].team.logs.contents('q').measurements())
    (joint,) = closed(sessions['p']).team.solution.maps
    assert {*joint.trajectories} == {'p', 'q'}
    assert not any('q/' in topic for topic in sessions['p'].outputs.topics)
    with pytest.raises(UsageError, match='only this robot'):
        sessions['p'].change_team(['p'])


def test_the_pose_of_the_map_of_the_other_is_published_before_any_of_its_map(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    for message in messages():
        feed(sessions, message)

    published = exchanged(sessions, clock, 6.0, is_over=lambda published: any(
        topic == 'q/base_node' for topic, _ in published))

    pose, = (message for topic, message in published if topic == 'q/base_node')
    assert pose.header.frame_id == 'p/map'
    # The start of q in the frame of the start of p, as all measurements give it.
    base = central().team.solution.maps[0].base_nodes['q']
    position = pose.pose.pose.position
    assert np.hypot(*(np.array([position.x, position.y]) - base.pose[:2])) < 0.5
    assert sessions['p'].team.logs.contents('q').measurements() == []
    assert sum(len(m.data) for topic, m in published if topic == EXCHANGE_TOPIC) < 10_000


def test_a_robot_that_left_the_team_while_its_rendezvous_was_computed_is_not_aligned(
    clock, monkeypatch
):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    run, computed = sessions['p'], []
    adopt = run.adopt

    def adopt_after_a_change(solution):
        if isinstance(solution, tuple) and not isinstance(solution[1].alignment, JoinFailure):
            computed.append(solution)
            run.change_team(['p', 'z'])
        return adopt(solution)

    monkeypatch.setattr(run, 'adopt', adopt_after_a_change)
    for message in messages():
        feed(sessions, message)

    published = exchanged(sessions, clock, 6.0)

    assert [peer for peer, _ in computed] == ['q']
    assert 'q/base_node' not in {topic for topic, _ in published}
    assert isinstance(run.team.rendezvous_results['q'].alignment, JoinFailure)


def test_maps_are_aligned_after_a_packet_with_rendezvous_information_was_lost(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    # All own observations are known before the robots are in reach.
    for message in messages():
        feed(sessions, message)
    for run in sessions.values():
        list(run.release())
    lost = set()

    def is_lost(message):
        block = getattr(read(bytes(message.data)), 'block', None)
        if block is None:
            return False
        # Measurements would align the maps, too.
        is_second = block.number == 1 and block.log not in lost
        lost.update([block.log] if block.log.about and is_second else [])
        return not block.log.about or is_second

    exchanged(sessions, clock, 6.0, lost=is_lost)

    assert {log.author for log in lost} == {'p', 'q'}
    for name, other in (('p', 'q'), ('q', 'p')):
        alignment = sessions[name].team.rendezvous_results[other].alignment
        assert not isinstance(alignment, JoinFailure), alignment


def test_an_observation_of_the_future_does_not_replace_a_rendezvous(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    spoilt = set()
    for message in messages():
        feed(sessions, message)
        name, _, kind = message.topic.lstrip('/').partition('/')
        if kind == 'robots' and name not in spoilt:
            cloud = deserialize(message.raw, message.type_name)
            if cloud.width:
                cloud.header.stamp.sec += 1000
                spoilt.add(name)
                feed(sessions, replace(message, raw=serialize(cloud)))

    exchanged(sessions, clock, 3.0)

    for name, other in (('p', 'q'), ('q', 'p')):
        team = sessions[name].team
        assert team.statistics.rejection_counts[name] == {RejectionReason.FUTURE: 1}
        assert not isinstance(team.rendezvous_results[other].alignment, JoinFailure)


@pytest.mark.parametrize('at', [0.2, 0.8])
def test_a_robot_that_is_killed_continues_from_its_file(clock, tmp_path, at):
    given, path = messages(), str(tmp_path / 'p.exchange')
    sessions = {'p': session('p', 'q', exchange_file=path), 'q': session('q', 'p')}
    split = int(at * len(given))
    fed(sessions, given[:split], clock)
    stored = (tmp_path / 'p.exchange').read_bytes()
    sessions['p'].discard_files()
    # What a process that was killed had not completed.
    (tmp_path / 'p.exchange').write_bytes(stored + b'\x40\0\0\0FEJ')

    sessions['p'] = session('p', 'q', exchange_file=path)
    # The messages since its last block are sent again, as by a robot that noticed nothing.
    again = [m for m in given[max(split - 200, 0):split] if m.topic.lstrip('/')[0] == 'p']
    fed(sessions, again + given[split:], clock)
    exchanged(sessions, clock, 10.0)

    expected = central()
    for name, run in sessions.items():
        closed(run)
        assert run.team.trajectories.keys() == {'p', 'q'}, name
        assert run.team.not_in_map() == {}
    for name in 'pq':
        assert len(poses(sessions['p'], name)) == len(poses(expected, name))
        assert_allclose(poses(sessions['p'], name), poses(expected, name), rtol=0.0, atol=1e-9)


def test_a_file_of_another_robot_is_rejected(tmp_path):
    path = tmp_path / 'p.exchange'
    session('p', 'q', exchange_file=str(path)).discard_files()

    with pytest.raises(UserError, match='is not an exchange_file of q: give another path'):
        session('q', 'p', exchange_file=str(path))


def test_another_file_is_rejected_and_kept(tmp_path):
    path = tmp_path / 'notes.txt'
    path.write_text('not to be lost')

    with pytest.raises(UserError, match='is damaged or no exchange_file'):
        session('p', 'q', exchange_file=str(path))
    assert path.read_text() == 'not to be lost'


def test_what_is_exchanged_and_rejected_is_reported(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    exchanged(sessions, clock, 2.0)
    run = sessions['p']
    run.check(1)
    assert 'q is in reach' in [line.text for line in run.log.take()]
    message = peer_session.outgoing.byte_array(b'FEJ?')

    for raw in serialize(message), b'no message':
        run.receive(RawMessage(EXCHANGE_TOPIC, EXCHANGE_TYPE, None, raw))
    run.check(2)

    assert 'a message of an unknown sender is rejected: it is incomplete' in [
        line.text for line in run.log.take()]
    _, report = run.diagnostics.report(3, at_rest=False)
    of_q = next(status for status in report.status if status.name == 'smoother: q')
    assert of_q.message.endswith('; in reach')
    values = {value.key: value.value for value in report.status[-1].values}
    assert int(values['exchange_bytes_hello']) > 100
    assert values['exchange_truncated'] == '2'


def test_messages_of_a_robot_that_are_rejected_are_a_warning_once(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    exchanged(sessions, clock, 2.0)
    run, reports = sessions['p'], []
    # Of a run before the present one.
    message = peer_session.outgoing.byte_array(write(Hello('q', 0, 1, 0, ())))

    run.receive(RawMessage(EXCHANGE_TOPIC, EXCHANGE_TYPE, None, serialize(message)))
    for now in (1, 2):
        _, report = run.diagnostics.report(now, at_rest=False)
        reports += [status for status in report.status if status.name == 'smoother: q']

    first, second = reports
    assert first.message.endswith('; in reach; rejected: 1 old_run')
    assert first.level >= 1
    assert second.message.endswith('; in reach')


def test_only_inputs_of_the_own_robot_are_subscribed_to():
    run = session('p', 'q')

    assert not [topic for topic in run.inputs.topics if topic.startswith('q/')]
    assert not {'p/set_pose', 'initialpose'} & run.inputs.topics.keys()
    assert run.inputs.topics[EXCHANGE_TOPIC] == EXCHANGE_TYPE
    assert {'p/pose', 'q/pose', 'q/base_node', EXCHANGE_TOPIC} <= run.outputs.topics.keys()


def test_a_damaged_file_is_rejected_and_kept(clock, tmp_path):
    path = tmp_path / 'p.exchange'
    run = session('p', 'q', exchange_file=str(path))
    fed({'p': run}, messages()[:300], clock)
    run.discard_files()
    stored = bytearray(path.read_bytes())
    stored[len(stored) // 2] ^= 1
    path.write_bytes(stored)

    with pytest.raises(UserError, match='is damaged or no exchange_file'):
        session('p', 'q', exchange_file=str(path))
    assert path.read_bytes() == stored


def test_a_file_of_which_only_a_part_of_the_first_block_was_written_is_empty(tmp_path):
    path = tmp_path / 'p.exchange'
    session('p', 'q', exchange_file=str(path)).discard_files()
    path.write_bytes(path.read_bytes()[:20])

    run = session('p', 'q', exchange_file=str(path))

    assert run.team.logs.contents('p').measurements() == []
    run.discard_files()


@pytest.mark.parametrize(('values', 'named'), [
    ({'odometry_noise_scale': 3.0}, 'noise of p'),
    ({'shared_landmark_ids': True}, 'shared_landmark_ids'),
    ({'keyframe_distance': 0.5}, 'keyframe_distance')])
def test_a_file_that_was_written_with_other_parameters_is_rejected(tmp_path, values, named):
    path = str(tmp_path / 'p.exchange')
    session('p', 'q', exchange_file=path).discard_files()

    with pytest.raises(UserError, match=f'written with another {named}'):
        session('p', 'q', exchange_file=path, **values)


@pytest.mark.parametrize(
    'values', [{'shared_landmark_ids': True}, {'keyframe_distance': 0.5}], ids=str)
def test_robots_with_other_team_parameters_name_the_parameter_and_use_no_log(clock, values):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p', **values)}

    exchanged(sessions, clock, 10.0)

    parameter, = values
    for run, other in ((sessions['p'], 'q'), (sessions['q'], 'p')):
        assert parameter in run.team.not_in_map()[other]
        assert run.team.logs.contents(other).measurements() == []
        run.log.check(0)
        assert any(f'another {parameter}' in line.text for line in run.log.take())
        run.discard_files()


class SlowFile(ExchangeFile):
    """A file whose blocks wait until the test lets the disk take them, as in a live run."""

    def append(self, blocks):
        self.blocks.extend(blocks)


def test_own_measurements_are_sent_when_the_disk_has_taken_them(clock, tmp_path):
    file = SlowFile(tmp_path / 'p.exchange', 'p')
    sessions = {
        'p': session(
            'p', 'q', exchange_file=str(file.path), open_exchange=lambda *_: file),
        'q': session('q', 'p')}
    given = messages()
    fed(sessions, given[:200], clock)
    exchanged(sessions, clock, 6.0)
    assert file.path.stat().st_size == 0
    assert known_of_p(sessions['q']) == []

    file.flush()
    on_disk = len(sessions['p'].team.logs.contents('p').blocks)
    fed(sessions, given[200:400], clock)
    exchanged(sessions, clock, 6.0)

    assert len(sessions['q'].team.logs.contents('p').blocks) == on_disk > 10
    file.close()


def test_a_run_after_a_reset_goes_on_with_what_the_disk_has_not_taken(clock, tmp_path):
    file = SlowFile(tmp_path / 'p.exchange', 'p')
    values = {'exchange_file': str(file.path), 'open_exchange': lambda *_: file}
    sessions = {'p': session('p', 'q', **values), 'q': session('q', 'p')}
    fed(sessions, messages()[:200], clock)
    before = known_of_p(closed(sessions['p']))

    sessions['p'] = session('p', 'q', **values)

    exchanged(sessions, clock, 6.0)
    assert [known_of_p(run) for run in sessions.values()] == [before, []]
    file.flush()
    exchanged(sessions, clock, 6.0)
    assert [known_of_p(run) for run in sessions.values()] == [before, before]
    assert len(before) > 50
    file.close()


def test_a_robot_that_is_killed_while_its_disk_is_full_goes_on_with_the_others(clock, tmp_path):
    """Blocks that others had, and that its file lacks, would be followed by other ones."""
    given, file = messages(), SlowFile(tmp_path / 'p.exchange', 'p')
    path = str(file.path)
    sessions = {
        'p': session('p', 'q', exchange_file=path, open_exchange=lambda *_: file),
        'q': session('q', 'p')}
    fed(sessions, given[:200], clock)
    file.flush()
    exchanged(sessions, clock, 6.0)
    fed(sessions, given[200:400], clock)
    exchanged(sessions, clock, 2.0)
    assert file.waiting
    file.close()

    sessions['p'] = session('p', 'q', exchange_file=path)
    fed(sessions, given[400:], clock)
    exchanged(sessions, clock, 10.0)

    assert known_of_p(sessions['q']) == known_of_p(sessions['p'])
    last = max(m.stamp for m in sessions['p'].team.logs.contents('p').measurements())
    assert last == max(m.stamp for m in sessions['q'].team.logs.contents('q').measurements())
    sessions['p'].discard_files()


def test_a_rendezvous_that_goes_on_does_not_keep_maps_from_being_solved(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    fed(sessions, messages()[:900], clock)
    kinds = []
    run = sessions['p']
    for _ in range(6):
        run.team.observed['q'] += 1
        run.team.new_poses += 100
        clock.now += 2 * NS
        for topic, message in sessions['q'].exchange():
            run.receive(RawMessage(topic, EXCHANGE_TYPE, None, serialize(message)))
        if run.is_solution_due(50):
            function, _ = run.solving()
            kinds.append(function.__name__)

    assert {'_solved_rendezvous', 'smoothed_union'} == {*kinds[:2]} == {*kinds[2:4]}


def test_a_rendezvous_that_fails_is_reported_and_does_not_keep_maps_from_being_solved(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    run, error = sessions['p'], 'its computation fails with ZeroDivisionError: by zero'
    for message in messages()[:900]:
        feed(sessions, message)
    kinds = []
    for _ in range(60):
        clock.now += NS // 2
        for topic, message in sessions['q'].exchange():
            run.receive(RawMessage(topic, EXCHANGE_TYPE, None, serialize(message)))
        run.team.observed['q'] += 1
        if run.is_solution_due(50):
            function, task = run.solving()
            kinds.append(function.__name__)
            if function is smoothed_union:
                list(run.adopt(function(task)))
            else:
                run.give_up(task, error)

    assert kinds == ['_solved_rendezvous', 'smoothed_union']
    lines = [line.text for line in run.log.take()]
    assert lines.count(f'q is not aligned by the rendezvous: {error}') == 1
    _, report = run.diagnostics.report(1, at_rest=False)
    of_q = next(status for status in report.status if status.name == 'smoother: q')
    assert error in {value.value for value in of_q.values}


def test_a_union_that_fails_is_reported_for_all_robots_of_which_there_are_measurements(clock):
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    for message in messages()[:900]:
        feed(sessions, message)
    exchanged(sessions, clock, 10.0, is_over=lambda _: 'q' in sessions['p'].team.logs.robots)
    run = sessions['p']

    run.give_up(run.team.union_task(), 'its computation fails')

    _, report = run.diagnostics.report(1, at_rest=False)
    assert [
        (status.name, status.level) for status in report.status[:2]
        if status.message.startswith('not smoothed: its computation fails')] == [
            ('smoother: p', 2), ('smoother: q', 2)]


def sessions_with_q_carried_away(clock):
    """Return the sessions of p and q; q was set down 100 m away, where it knows nothing."""
    sessions = {'p': session('p', 'q'), 'q': session('q', 'p')}
    for k in range(20):
        x = k / 10.0 + (100.0 if k >= 10 else 0.0)
        others = [(2, (5.0 - x, 3.0)), (3, (9.0 - x, 0.0))] if k < 10 else []
        fed(sessions, [
            raw_record(odometry('p', 100 * k)), raw_record(odometry('q', 100 * k, (x, 0.0, 0.0))),
            raw_record(scan('q', 100 * k, [(1, (5.0 - x, 1.0)), *others]))], clock)
    exchanged(sessions, clock, 10.0)
    return sessions


def test_another_robot_that_is_lost_is_logged_with_the_reason_and_the_own_one_goes_on(clock):
    sessions = sessions_with_q_carried_away(clock)
    run = sessions['p']
    function, task = run.final_solving()
    list(run.adopt(function(task)))
    assert run.team.trajectories['q'].is_lost

    feed(sessions, raw_record(odometry('p', 2000)))

    assert run.team.trajectories['p'].newest().stamp > 1_500_000_000
    (line,) = [line.text for line in run.log.take() if line.text.startswith('q goes on')]
    assert line == 'q goes on in its own frame: its odometry moved 100.1 m in 0.10 s'


def test_a_lost_robot_that_begins_a_new_run_is_not_logged_as_found(clock):
    sessions = sessions_with_q_carried_away(clock)
    run = sessions['p']

    def solved():
        function, task = run.final_solving()
        list(run.adopt(function(task)))
        feed(sessions, raw_record(odometry('p', stamps.pop(0))))
        return [line.text for line in run.log.take() if line.text.startswith('q ')]

    stamps = [2000, 2100]
    solved()
    sessions['q'] = session('q', 'p')
    for k in range(20):
        fed(sessions, [
            raw_record(odometry('q', 100 * k)),
            raw_record(scan('q', 100 * k, [(1, (5.0, 1.0))]))], clock)
    exchanged(sessions, clock, 10.0)

    assert 'q has begun a new run' in solved()


def test_a_parameter_file_may_list_the_own_robot_among_its_peers():
    given = settings(['p'], ['p', 'q'])

    assert [robot.name for robot in given.estimation.robots] == ['p', 'q']
    assert parameters.as_parameters(given)['robots'] == ['p']
    assert PeerSession(given, None, open_exchange=opened).team.robot == 'p'


@pytest.mark.parametrize(('robots', 'peers', 'sentence'), [
    (['p', 'r'], ['q'], "parameter 'robots' lists 2 robots beside 'peers'"),
    (['p'], ['p'], "parameter 'peers' has only this robot: list the others"),
    (['p'], ['q', 'q'], "parameter 'peers' contains 'q' twice"),
])
def test_a_wrong_team_is_rejected_with_one_sentence(robots, peers, sentence):
    with pytest.raises(UserError, match=sentence):
        settings(robots, peers)


def test_robots_that_list_each_other_have_the_same_ids():
    ids = {
        name: {robot.name: robot.id for robot in settings([name], peers).estimation.robots}
        for name, peers in {'a': ['c', 'b'], 'b': ['a', 'c'], 'c': ['a', 'b']}.items()}

    assert ids['a'] == ids['b'] == ids['c'] == {'a': 1, 'b': 2, 'c': 3}


@pytest.mark.slow
def test_the_summary_of_each_robot_counts_the_observations_of_all_as_the_central_one(
    clock, tmp_path
):
    sessions = {
        'p': session('p', 'q', tmp_path / 'p'), 'q': session('q', 'p', tmp_path / 'q')}
    fed(sessions, messages(), clock)
    exchanged(sessions, clock, 10.0)

    expected = central().write_files()['robots']
    for run in sessions.values():
        found = closed(run).write_files()['robots']
        for name in 'pq':
            assert found[name]['sightings_used'] == expected[name]['sightings_used'] > 0


def test_what_a_robot_rejects_of_the_log_of_another_is_counted(clock, tmp_path):
    """It has another limit of speed than the author."""
    slow = {'q.max_speed': 0.05}
    sessions = {'p': session('p', 'q', tmp_path / 'p', **slow), 'q': session('q', 'p')}
    fed(sessions, messages(), clock)
    exchanged(sessions, clock, 10.0)

    strict = BagSmootherSession(settings(['p', 'q'], **slow), None)
    for message in messages():
        list(strict.receive(message))
        list(strict.take())
    expected, found = (closed(run).write_files()['robots'] for run in (strict, sessions['p']))
    assert found['q']['refusals'] == expected['q']['refusals']
    assert found['q']['refusals']['lost_robot'] > 5
