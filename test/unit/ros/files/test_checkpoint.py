# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run continues from its checkpoint in any process, or the file is refused in one sentence."""

from dataclasses import make_dataclass
from hashlib import sha256
import json
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from fej_slam_ros.core import snapshot as core
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.ekf.state import Landmark
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags, checkpoint
from fej_slam_ros.ros.files.exchange_file import ExchangeFile
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.peer_session import PeerSession
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.paths import BAGS
from helpers.records import MS
from helpers.ros import (
    drive, feed, meeting, meeting_truth, odometry_message, raw, raw_record, run_settings, save,
    seen, summary_of, write_bag)
from helpers.slow import slow

#: A scan that waits until odometry has named its frame, and messages that are not used.
HELD = raw('r1/landmarks', seen((1, 5.0, 1.0), frame='r1/base_link'), 0)
CAMERA = raw('r2/landmarks', seen((9, 5.0, 1.0), frame='camera'), 0)
MESSAGES = [
    HELD, CAMERA, raw('r1/image', seen()),
    *map(raw_record, sorted([*meeting(8), *meeting_truth(8)], key=lambda r: r.stamp))]


@pytest.fixture
def path(tmp_path):
    """Return the path of the checkpoint."""
    return tmp_path / 'run.checkpoint'


def interrupted(path, messages, **changes):
    """Return a session that was saved after some messages."""
    run = EstimatorSession(run_settings(checkpoint=str(path), **changes), None)
    feed(run, messages)
    save(run)
    return run


def rejected(path, **changes):
    """Return the error message for a checkpoint that is refused."""
    with pytest.raises(UserError) as caught:
        checkpoint.load(path, run_settings(**changes), None)
    return str(caught.value)


def summary_without_files(run):
    """Return the summary of a run without the parameters that name its checkpoint."""
    summary = run.write_files()
    for name in ('checkpoint', 'restore'):
        del summary['config'][name]
    return summary


@pytest.mark.parametrize('cut', range(len(MESSAGES) + 1))
def test_a_restored_run_ends_like_the_uninterrupted_run(path, cut):
    whole = EstimatorSession(run_settings(), None)
    published = drive(whole, MESSAGES)
    interrupted(path, MESSAGES[:cut])

    restored = EstimatorSession(run_settings(restore=str(path)), None)
    rest = drive(restored, MESSAGES[cut:])

    assert summary_without_files(restored) == summary_without_files(whole)
    assert len(rest) <= len(published)


@pytest.mark.parametrize('messages', [
    # After a stamp far ahead, those that follow may be of another pass.
    [('r2', 5000, 1000), ('r2', 1100, 1100)],
    # Odometry of r2 that is three seconds late, and of both robots after it.
    [('r1', 0, 0), ('r2', 0, 0), ('r1', 4000, 4000), ('r2', 4000, 4000), ('r2', 1000, 4100),
     ('r1', 4200, 4200), ('r2', 4200, 4200)]])
def test_messages_that_may_be_of_another_pass_are_used_or_counted_after_a_restart(path, messages):
    sent = [
        raw(f'{robot}/odom', odometry_message(ms, (ms / 1000, 0.0, 0.0)), at)
        for robot, ms, at in messages]
    whole = EstimatorSession(run_settings(), None)
    drive(whole, sent)

    for cut in range(len(sent) + 1):
        interrupted(path, sent[:cut])
        restored = EstimatorSession(run_settings(restore=str(path)), None)
        drive(restored, sent[cut:])

        counts = [
            {robot: (run.estimator.used(robot), run.estimator.statistics.rejected[robot])
             for robot in ('r1', 'r2')} for run in (restored, whole)]
        assert counts[0] == counts[1]
        assert restored.state_hash() == whole.state_hash()


class Sent:
    """The messages of robots of which a listener has missed some at first, as DDS counts them."""

    def __init__(self, number):
        self.number = number

    def missed(self, _topic):
        return self.number

    def forget(self, _topic):
        """Go on."""


@pytest.mark.parametrize('cut', range(6))
def test_odometry_that_waits_for_the_check_of_a_late_start_is_used_after_a_restart(path, cut):
    known = {'known': [('r2', (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))]}
    sent = [
        raw(f'{robot}/odom', odometry_message(ms, (2.0 + ms / 1000, 0.0, 0.0)), ms)
        for ms in range(0, 300, 100) for robot in ('r1', 'r2')]
    whole = EstimatorSession(run_settings(**known), None)
    whole.check_starts(Sent(20))
    drive(whole, sent)

    saved = EstimatorSession(run_settings(checkpoint=str(path), **known), None)
    saved.check_starts(Sent(20))
    feed(saved, sent[:cut])
    save(saved)
    restored = EstimatorSession(run_settings(restore=str(path), **known), None)
    restored.check_starts(Sent(20 + cut // 2))
    drive(restored, sent[cut:])

    assert restored.estimator.used('r1') == restored.estimator.used('r2') == 3
    for robot in ('r1', 'r2'):
        estimate, expected = (run.estimator.pose(robot) for run in (restored, whole))
        assert estimate.frame == 'map'
        np.testing.assert_allclose(estimate.pose, expected.pose, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(estimate.P, expected.P, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize('session', [EstimatorSession, SmootherSession])
def test_a_robot_is_relocalized_at_its_newest_odometry_also_by_the_first_request_after_a_restore(
    path, session
):
    run = session(run_settings(checkpoint=str(path)), None)
    feed(run, map(raw_record, meeting(8)))
    save(run)

    restored = session(run_settings(restore=str(path)), None)

    # Its odometry waits for max_delay.
    assert run.relocalization('r1').stamp == 700 * MS
    assert restored.relocalization('r1').stamp == 700 * MS


@pytest.mark.parametrize('seed', ['1', '2'])
def test_another_process_continues_and_counts_repeated_input_as_duplicates(path, tmp_path, seed):
    whole = EstimatorSession(run_settings(), None)
    drive(whole, MESSAGES)
    interrupted(path, MESSAGES[:20])
    bag = write_bag(tmp_path / 'bag', MESSAGES[3:])
    file = tmp_path / 'team.yaml'
    file.write_text(parameters.dump(run_settings(restore=str(path))))

    words = 'replay', bag, '--params', file, '--output', tmp_path / 'out'
    subprocess.run(
        [sys.executable, '-m', 'fej_slam_ros', *map(str, words)], check=True,
        env={**os.environ, 'PYTHONHASHSEED': seed})

    summary = summary_of(tmp_path / 'out')
    assert summary['state_hash'] == whole.write_files()['state_hash']
    again = [m for m in MESSAGES[3:20] if m.topic.endswith(('odom', 'landmarks'))]
    again = [m for m in again if m.topic != 'ground_truth/landmarks']
    assert summary['counts']['duplicate'] == len(again)
    assert not summary['depends_on_arrival']


def test_a_run_that_restores_its_own_checkpoint_starts_new_once_and_continues_after_that(path):
    whole = EstimatorSession(run_settings(), None)
    drive(whole, MESSAGES)
    own = run_settings(checkpoint=str(path), restore=str(path))

    restored = []
    for part in MESSAGES[:9], MESSAGES[9:21], MESSAGES[21:]:
        run = EstimatorSession(own, None)
        restored.append(run.is_restored)
        feed(run, part)
        save(run)
    list(run.close())

    assert restored == [False, True, True]
    assert summary_without_files(run) == summary_without_files(whole)


def test_a_checkpoint_of_another_run_must_exist(path):
    with pytest.raises(UserError, match='No such file'):
        EstimatorSession(run_settings(checkpoint=f'{path}_2', restore=str(path)), None)


def test_a_file_damaged_at_any_byte_is_refused(path):
    interrupted(path, MESSAGES[:12])
    good = path.read_bytes()

    # All of the head, then a sample: every byte of the rest is under the same checksum.
    for place in [*range(150), *range(150, len(good), 17)]:
        bad = bytearray(good)
        bad[place] ^= 1 << place % 8
        path.write_bytes(bad)
        assert rejected(path).startswith(f'{path} is ')


def test_a_file_cut_short_anywhere_is_refused(path):
    interrupted(path, MESSAGES[:12])
    good = path.read_bytes()

    for size in range(0, len(good), 37):
        path.write_bytes(good[:size])
        assert rejected(path).startswith(f'{path} is ')


def test_a_damaged_file_is_named_as_damaged(path):
    interrupted(path, MESSAGES[:12])
    path.write_bytes(path.read_bytes()[:-1])

    assert rejected(path) == (
        f'{path} is damaged: its checksum does not match; restore another checkpoint')


def test_a_file_of_another_version_is_refused_with_both(path):
    interrupted(path, [])
    path.write_bytes(path.read_bytes().replace(b', version ', b', version 9', 1))

    sentence = rejected(path)
    assert ', version 9' in sentence
    assert f'; this is format {checkpoint.FILE_FORMAT}, schema ' in sentence
    assert sentence.endswith(': restore it with the version that wrote it')


def test_a_file_from_before_a_class_gained_a_field_is_refused_by_its_schema(path, monkeypatch):
    interrupted(path, MESSAGES[:12])
    longer = make_dataclass(
        'Landmark', [('quality', float)], bases=(Landmark,), slots=True, kw_only=True)
    longer.__module__ = Landmark.__module__
    monkeypatch.setattr(core, 'SNAPSHOT_CLASSES', tuple(
        longer if cls is Landmark else cls for cls in core.SNAPSHOT_CLASSES))

    assert 'made by another version of the data in it' in rejected(path)


def with_classes_named(path, old, new):
    """Write a checkpoint with another class name, under a checksum that matches."""
    title, _, content = path.read_bytes().split(b'\n', 2)
    content = content.replace(json.dumps(old).encode(), json.dumps(new).encode())
    path.write_bytes(b'\n'.join([title, sha256(content).hexdigest().encode(), content]))


@pytest.mark.parametrize('name', [
    'os.system', 'antigravity.fly', '...os.system', 'settings.Settings', 'calibration.x.Y'])
def test_a_crafted_file_that_names_another_class_is_refused_and_imports_nothing(path, name):
    interrupted(path, MESSAGES[:12])
    with_classes_named(path, 'ekf.state.JointState', name)
    before = set(sys.modules)

    assert rejected(path) == (
        f"{path} is damaged: unknown class '{name}'; restore another checkpoint")
    assert set(sys.modules) == before


def test_a_crafted_file_with_another_attribute_is_refused(path):
    interrupted(path, MESSAGES[:12])
    with_classes_named(path, 'log_likelihood', '__class__')

    assert 'innovation_monitor.InnovationMonitor has no attribute __class__' in rejected(path)


def test_a_crafted_file_calls_no_class_that_computes(path):
    interrupted(path, MESSAGES[:12])
    title, _, content = path.read_bytes().split(b'\n', 2)
    text, _, arrays = content.partition(b'\n')
    stored = json.loads(text)
    stored['estimator'] = {'call': ['ekf.covariance.Covariance', [10**9]]}

    write_sealed(path, title, json.dumps(stored).encode(), arrays)

    assert 'ekf.covariance.Covariance is not a class of values' in rejected(path)


#: What a hostile file may have anywhere: other kinds, classes, types of arrays and sizes.
HOSTILE = [
    None, True, -1, 10**30, float('nan'), '', 'os', [], {}, {'same': 10**9}, {'same': -1},
    {'call': ['os.system', ['true']]}, {'call': ['rejections.RejectionReason', ['x']]},
    {'call': ['ekf.filter.Filter', []]}, {'object': ['builtins.type', {}]},
    {'object': ['ekf.state.Landmark', {'__class__': 1, '__reduce__': 2}]},
    {'object': ['estimator.Estimator', {}]}, {'symmetric_matrix': [-1, []]},
    {'symmetric_matrix': [10**7, [0.0]]}, {'deque': [-5, []]}, {'defaultdict': ['eval', []]},
    {'dict': [[1]]}, {'set': [[]]}, {'Counter': 'abc'}, {'a': 1, 'b': 2}, {'array': []},
    {'array': ['|O', [1], 'C', 0]}, {'array': ['O', [8], 'C', 0]},
    {'array': ['<f8', [-1], 'C', 0]}, {'array': ['<f8', [10**12], 'C', 0]},
    {'array': ['<f8', [2], 'C', -8]},
    {'array': ['<f8', [10**10, 0, 10**10], 'C', 0]}, {'array': ['|V0', [1], 'C', 0]},
    {'array': ['|S1000000000', [1], 'C', 0]}, {'array': [[['x', 'O']], [1], 'C', 0]},
    {'array': ['<M8[ns]', [2], 'X', 0]}]


def write_sealed(path, title, text, arrays):
    """Write a checkpoint under a checksum that matches."""
    content = text + b'\n' + arrays
    path.write_bytes(b'\n'.join([title, sha256(content).hexdigest().encode(), content]))


def places(value, path=()):
    """Yield the path of each part of JSON content."""
    yield path
    pairs = enumerate(value) if isinstance(value, list) else (
        value.items() if isinstance(value, dict) else ())
    for key, part in pairs:
        yield from places(part, (*path, key))


def replaced(value, path, new):
    """Return JSON content with another part at a path."""
    if not path:
        return new
    changed = value.copy()
    changed[path[0]] = replaced(value[path[0]], path[1:], new)
    return changed


@pytest.mark.parametrize('number', [40, slow(1500)])
def test_a_crafted_file_is_refused_or_loaded_and_runs_no_code(path, number):
    interrupted(path, MESSAGES[:12])
    title, _, content = path.read_bytes().split(b'\n', 2)
    text, _, arrays = content.partition(b'\n')
    stored, rng, events = json.loads(text), np.random.default_rng(number), []
    spots = [spot for spot in places(stored['estimator']) if spot]
    settings = run_settings()
    checkpoint.load(path, settings, None)
    watching = [False]

    def watch(event, arguments):
        if watching[0] and event.split('.')[0] in {
                'import', 'exec', 'compile', 'os', 'subprocess', 'pickle', 'socket', 'ctypes'}:
            events.append((event, arguments))

    sys.addaudithook(watch)
    for spot, k in zip(rng.choice(len(spots), number), rng.permutation(number), strict=True):
        hostile = replaced(stored['estimator'], spots[spot], HOSTILE[k % len(HOSTILE)])
        write_sealed(path, title, json.dumps({**stored, 'estimator': hostile}).encode(), arrays)
        watching[0] = True
        try:
            checkpoint.load(path, settings, None)
        except UserError as error:
            assert_one_line(str(error))
        finally:
            watching[0] = False

    assert events == []


def assert_one_line(text):
    assert '\n' not in text


@pytest.mark.parametrize('session', [EstimatorSession, SmootherSession])
@pytest.mark.parametrize('inputs', [None, {}, {'unused': 1}])
def test_crafted_inputs_are_refused(path, session, inputs):
    run = session(run_settings(checkpoint=str(path)), None)
    save(run)
    title, _, content = path.read_bytes().split(b'\n', 2)
    text, _, arrays = content.partition(b'\n')
    write_sealed(path, title, json.dumps({**json.loads(text), 'inputs': inputs}).encode(), arrays)

    with pytest.raises(UserError, match=r'is damaged: .*; restore another checkpoint'):
        session(run_settings(restore=str(path)), None)


@pytest.mark.parametrize('text', [
    b'[' * 200_000, b'{"a":' * 200_000, b'{"estimator":' + b'[' * 100_000 + b']' * 100_000 + b'}',
    b'9' * 100_000, b'', b'\xff\xfe'])
def test_a_crafted_file_of_many_levels_or_digits_is_refused(path, text):
    interrupted(path, MESSAGES[:12])
    title = path.read_bytes().split(b'\n', 1)[0]

    write_sealed(path, title, text, b'')

    assert_one_line(rejected(path))


def test_a_file_that_is_not_a_checkpoint_is_refused(path):
    path.write_text('robots: [r1, r2]\n')

    assert rejected(path) == (
        f'{path} is not a checkpoint: give a file that ~/save has written')


def test_a_missing_file_is_named(path):
    assert rejected(path).startswith(f'cannot read the checkpoint {path}: No such file')


@pytest.mark.parametrize(
    ('name', 'saved', 'given', 'changes'),
    [
        ('max_delay', '0.1', '0.3', {'max_delay': 0.3}),
        ('filter', "'fej'", "'standard'", {'filter': 'standard'}),
        ('r2.start_pose', 'None', '[1.0, 2.0, 0.0]', {
            'known': [('r2', (1.0, 2.0, 0.0), (0.1, 0.1, 0.1))]}),
    ],
)
def test_a_file_made_with_other_settings_is_refused_by_the_first_of_them(
    path, name, saved, given, changes,
):
    interrupted(path, MESSAGES[:12])

    assert f'{path} was made with {name} = {saved}, not {given}: ' in rejected(path, **changes)


def test_settings_that_do_not_affect_the_result_may_differ(path):
    interrupted(path, MESSAGES[:12])

    settings = run_settings(output='elsewhere', unused_variance=1.0)
    _, estimator, *_ = checkpoint.load(path, settings, None)

    assert estimator.settings == settings.estimation


def test_parameters_that_changed_before_and_after_a_checkpoint_decide_as_in_one_run(path):
    def changed(run, messages):
        for number, message in enumerate(messages):
            if number == 6:
                run.change_parameters({'landmark_noise_scale': 2.0, 'max_delay': 0.3})
                run.change_team(['r2', 'r1', 'r3'])
            feed(run, [message])

    whole = EstimatorSession(run_settings(), None)
    changed(whole, MESSAGES)
    first = EstimatorSession(run_settings(checkpoint=str(path)), None)
    changed(first, MESSAGES[:12])
    save(first)

    second = EstimatorSession(run_settings(restore=str(path)), None)
    feed(second, MESSAGES[12:])

    assert second.present_settings() == whole.present_settings()
    assert second.present_settings().robots[2].landmark_noise_scale == 2.0
    assert list(second.close())
    assert list(whole.close())
    assert second.estimator.state_hash() == whole.estimator.state_hash()
    assert second.changes == whole.changes


def second_run(path, session, **node):
    """Return a run that began by a reset after the parameters of the first one were changed."""
    first = session(run_settings(checkpoint=str(path), **node), None)
    feed(first, MESSAGES)
    first.change_team(['r3', 'r2'])
    list(first.close())
    return session(first.next_settings(''), None)


@pytest.mark.parametrize('session', [EstimatorSession, SmootherSession])
def test_a_killed_process_that_is_started_as_before_continues_its_second_run(path, session):
    undisturbed, saved = second_run(path, session), second_run(path, session)
    assert [*saved.consumer.robots] == ['r3', 'r2']
    for run in undisturbed, saved:
        feed(run, MESSAGES[:12])
    save(saved)

    for _ in range(2):  # a later death is no other case
        restored = session(run_settings(checkpoint=str(path), restore=str(path)), None)
        save(restored)
    for run in undisturbed, restored:
        feed(run, MESSAGES[12:])
        list(run.close())

    assert restored.present_settings() == undisturbed.present_settings()
    assert summary_without_files(restored) == summary_without_files(undisturbed)
    changes = parameters.changes_before(restored.settings)
    assert changes == "robots = ['r3', 'r2'], not ['r1', 'r2'], anchor = 'r3', not 'r1'"


@pytest.mark.parametrize('session', [EstimatorSession, SmootherSession])
def test_a_second_run_without_the_robot_that_rviz_places_is_restored_too(path, session):
    save(second_run(path, session, initialpose_robot='r1'))

    restored = session(run_settings(restore=str(path), initialpose_robot='r1'), None)

    assert [*restored.consumer.robots] == ['r3', 'r2']
    assert restored.present_settings().initialpose_robot == ''


def test_the_changed_parameters_of_a_second_run_restore_it_too_and_others_do_not(path):
    saved = second_run(path, EstimatorSession)
    save(saved)

    settings, *_ = checkpoint.load(path, saved.settings, None)

    assert settings == saved.settings
    assert 'was made with max_delay = 0.1, not 0.3: ' in rejected(path, max_delay=0.3)


def test_a_restored_run_publishes_the_relative_poses_of_its_own_settings(path):
    interrupted(path, MESSAGES[:12], relative_poses=('r1:r2',))
    restored = EstimatorSession(run_settings(restore=str(path), relative_poses=('r2:r1',)), None)

    topics = {topic for topic, _ in drive(restored, MESSAGES[12:]) if 'relative' in topic}

    assert topics == {'r2/relative_pose/r1'}


def test_a_file_that_is_not_a_checkpoint_is_never_overwritten(path):
    path.write_text('precious')

    with pytest.raises(UsageError, match='exists and is not a checkpoint: choose another path'):
        interrupted(path, [])

    assert path.read_text() == 'precious'


def test_a_later_checkpoint_replaces_the_earlier_one(path):
    interrupted(path, MESSAGES[:5])
    later = interrupted(path, MESSAGES[:12])

    _, estimator, *_ = checkpoint.load(path, run_settings(), None)

    assert estimator.state_hash() == later.estimator.state_hash()
    assert [*path.parent.iterdir()] == [path]


def test_saving_without_a_file_names_the_missing_parameter():
    with pytest.raises(UsageError, match="give the parameter 'checkpoint'"):
        EstimatorSession(run_settings(), None).checkpoint_content()


def test_a_path_that_cannot_be_written_is_named():
    with pytest.raises(UserError, match=r'^cannot write to /dev/null/x: Not a directory: choose'):
        interrupted(Path('/dev/null/x/run.checkpoint'), [])


def smoothed(messages, path=None, cuts=()):
    """Return the summary of a smoother that is saved and restored before some messages."""
    own = {} if path is None else {'checkpoint': str(path), 'restore': str(path)}
    settings = run_settings('p', 'q', shared_landmark_ids=False, **own)
    run = SmootherSession(settings, None)
    for number, message in enumerate(messages):
        if number in cuts:
            save(run)
            run = SmootherSession(settings, None)
            assert run.is_restored
        run.receive(message)
        list(run.take())
        if number % 150 == 149:
            list(run.adopt(solve(run.team.task())))
    list(run.close())
    return summary_without_files(run)


def test_a_restored_smoother_ends_like_the_uninterrupted_one(path):
    messages = [*bags.read(BAGS / 'rendezvous')]

    expected = smoothed(messages)

    assert smoothed(messages, path, range(40, len(messages), 97)) == expected
    assert expected['not_in_map'] == {}


def test_a_checkpoint_of_the_other_node_is_refused(path):
    interrupted(path, MESSAGES[:12])
    with pytest.raises(UsageError, match='is a checkpoint of the estimator, not of the smoother'):
        SmootherSession(run_settings(restore=str(path)), None)

    save(SmootherSession(run_settings(checkpoint=str(path)), None))
    assert 'is a checkpoint of the smoother, not of the estimator: give one' in rejected(path)


def test_a_checkpoint_of_a_smoother_does_not_depend_on_parameters_of_the_estimator(path):
    save(SmootherSession(run_settings(checkpoint=str(path)), None))

    SmootherSession(run_settings(restore=str(path), filter='invariant'), None)

    with pytest.raises(UsageError, match=r'was made with max_delay = 0\.1, not 0\.3'):
        SmootherSession(run_settings(restore=str(path), max_delay=0.3), None)


@pytest.mark.parametrize(
    ('name', 'value'), [('checkpoint', 'file'), ('restore', 'file'), ('autosave_period', 1.0)])
def test_a_smoother_with_peers_refuses_checkpoints(name, value):
    settings = parameters.parse({'robots': ['r1'], 'peers': ['r2'], name: value})

    with pytest.raises(UsageError, match="give 'exchange_file' instead"):
        PeerSession(settings, None, open_exchange=ExchangeFile)


def test_a_smoother_with_peers_is_not_saved():
    settings = parameters.parse({'robots': ['r1'], 'peers': ['r2']})
    run = PeerSession(settings, None, open_exchange=ExchangeFile)

    with pytest.raises(UsageError, match="the parameter 'exchange_file'"):
        run.checkpoint_content()
