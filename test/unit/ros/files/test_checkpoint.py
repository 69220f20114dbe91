# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run goes on from its file, in any process, or the file is refused in one sentence."""

from dataclasses import replace
import os
from pathlib import Path
import subprocess
import sys

import pytest

from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import team
from helpers.ros import drive, meeting, meeting_truth, raw, raw_record, seen, summary_of, write_bag

#: A scan that waits until odometry has named its frame, and topics that are no inputs.
HELD = raw('r1/landmarks', seen((1, 5.0, 1.0), frame='r1/base_link'), 0)
CAMERA = raw('r2/landmarks', seen((9, 5.0, 1.0), frame='camera'), 0)
MESSAGES = [
    HELD, CAMERA, raw('r1/image', seen()),
    *map(raw_record, sorted([*meeting(8), *meeting_truth(8)], key=lambda r: r.stamp))]


@pytest.fixture
def path(tmp_path):
    """Return where the checkpoint is."""
    return tmp_path / 'run.checkpoint'


def interrupted(path, messages, **changes):
    """Return a run that was saved after some messages."""
    run = EstimatorSession(team(checkpoint=str(path), **changes), None)
    for message in messages:
        run.receive(message)
        list(run.take())
    run.save()
    return run


def rejected(path, **changes):
    """Return what is said of a checkpoint that is not taken."""
    with pytest.raises(UserError) as caught:
        checkpoint.load(path, team(**changes))
    return str(caught.value)


def told(run):
    """Return the summary of a run without the name of the file that it was restored from."""
    summary = run.keep()
    for name in ('checkpoint', 'restore'):
        del summary['config'][name]
    return summary


@pytest.mark.parametrize('cut', range(len(MESSAGES) + 1))
def test_a_run_restored_from_its_file_ends_as_the_run_without_a_break(path, cut):
    whole = EstimatorSession(team(), None)
    published = drive(whole, MESSAGES)
    interrupted(path, MESSAGES[:cut])

    restored = EstimatorSession(team(restore=str(path)), None)
    rest = drive(restored, MESSAGES[cut:])

    assert told(restored) == told(whole)
    assert len(rest) <= len(published)


@pytest.mark.parametrize('seed', ['1', '2'])
def test_another_process_goes_on_and_recognises_the_input_played_again(path, tmp_path, seed):
    whole = EstimatorSession(team(), None)
    drive(whole, MESSAGES)
    interrupted(path, MESSAGES[:20])
    bag = write_bag(tmp_path / 'bag', MESSAGES[3:])
    file = tmp_path / 'team.yaml'
    file.write_text(parameters.dump(team(restore=str(path))))

    words = 'replay', bag, '--params', file, '--output', tmp_path / 'out'
    subprocess.run(
        [sys.executable, '-m', 'fej_slam_ros', *map(str, words)], check=True,
        env={**os.environ, 'PYTHONHASHSEED': seed})

    summary = summary_of(tmp_path / 'out')
    assert summary['state_hash'] == whole.keep()['state_hash']
    again = [m for m in MESSAGES[3:20] if m.topic.endswith(('odom', 'landmarks'))]
    again = [m for m in again if m.topic != 'ground_truth/landmarks']
    assert summary['counts']['duplicate'] == len(again)
    assert not summary['depends_on_arrival']


def test_a_run_that_restores_what_it_saves_begins_anew_and_from_then_on_goes_on(path):
    whole = EstimatorSession(team(), None)
    drive(whole, MESSAGES)
    own = team(checkpoint=str(path), restore=str(path))

    restored = []
    for part in MESSAGES[:9], MESSAGES[9:21], MESSAGES[21:]:
        run = EstimatorSession(own, None)
        restored.append(run.is_restored)
        for message in part:
            run.receive(message)
            list(run.take())
        run.save()
    list(run.close())

    assert restored == [False, True, True]
    assert told(run) == told(whole)


def test_a_file_that_another_run_saves_must_be_there(path):
    with pytest.raises(UserError, match='No such file'):
        EstimatorSession(team(checkpoint=f'{path}_2', restore=str(path)), None)


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


def test_a_damaged_file_is_called_that(path):
    interrupted(path, MESSAGES[:12])
    path.write_bytes(path.read_bytes()[:-1])

    assert rejected(path) == (
        f'{path} is damaged: its checksum does not fit, restore another one')


def test_a_file_of_another_version_is_refused_with_both(path):
    interrupted(path, [])
    path.write_bytes(path.read_bytes().replace(b'format 6 of version ', b'format 6 of version 9'))

    sentence = rejected(path)
    assert 'a checkpoint of format 6 of version 9' in sentence
    assert 'not of format 6 of version ' in sentence


def test_another_file_is_refused(path):
    path.write_text('robots: [r1, r2]\n')

    assert rejected(path) == (
        f'{path} is not a checkpoint: give a file that ~/save has written')


def test_a_file_that_is_not_there_is_named(path):
    assert rejected(path).startswith(f'cannot read the checkpoint {path}: No such file')


@pytest.mark.parametrize(
    ('name', 'made', 'given', 'changes'),
    [
        ('max_delay', '0.1', '0.3', {'max_delay': 0.3}),
        ('filter', "'fej'", "'standard'", {'filter': 'standard'}),
        ('r2.start_pose', 'None', '[1.0, 2.0, 0.0]', {
            'known': [('r2', (1.0, 2.0, 0.0), (0.1, 0.1, 0.1))]}),
    ],
)
def test_a_file_made_with_other_settings_is_refused_by_the_first_of_them(
    path, name, made, given, changes,
):
    interrupted(path, MESSAGES[:12])

    assert f'{path} was made with {name} = {made}, not {given}: ' in rejected(path, **changes)


def test_settings_that_decide_nothing_may_differ(path):
    interrupted(path, MESSAGES[:12])

    estimator, _ = checkpoint.load(path, replace(team(), output='elsewhere', unused_variance=1.0))

    assert estimator.settings.output == 'elsewhere'
    assert estimator.settings.unused_variance == 1.0


def test_a_restored_run_tells_the_relative_poses_that_it_is_asked_for(path):
    interrupted(path, MESSAGES[:12], relative_poses=('r1:r2',))
    restored = EstimatorSession(team(restore=str(path), relative_poses=('r2:r1',)), None)

    topics = {topic for topic, _ in drive(restored, MESSAGES[12:]) if 'relative' in topic}

    assert topics == {'r2/relative_pose/r1'}


def test_a_file_that_is_no_checkpoint_is_never_replaced(path):
    path.write_text('precious')

    with pytest.raises(UsageError, match='exists and is no checkpoint: choose another place'):
        interrupted(path, [])

    assert path.read_text() == 'precious'


def test_a_checkpoint_is_replaced_by_the_next(path):
    interrupted(path, MESSAGES[:5])
    later = interrupted(path, MESSAGES[:12])

    estimator, _ = checkpoint.load(path, team())

    assert estimator.state_hash() == later.estimator.state_hash()
    assert [*path.parent.iterdir()] == [path]


def test_a_run_without_a_file_says_which_parameter_is_missing():
    with pytest.raises(UsageError, match="give the parameter 'checkpoint'"):
        EstimatorSession(team(), None).save()


def test_a_place_that_cannot_be_written_is_named():
    with pytest.raises(UserError, match=r'^cannot write to /dev/null/x: Not a directory$'):
        interrupted(Path('/dev/null/x/run.checkpoint'), [])
