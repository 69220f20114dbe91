# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of the estimator and the smoother take the same messages in the same way."""

import pytest

from fej_slam_ros.core.pieces import EndedError, pause
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.ros import meeting, meeting_truth, odometry_message, raw, raw_record, run_settings

MEETING = [raw_record(record) for record in meeting()]

pytestmark = pytest.mark.parametrize('session', [EstimatorSession, SmootherSession])


def poses(publications):
    """Return topic and stamp [ns] of published poses."""
    return [
        (topic, message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for topic, message in publications if topic.endswith('/pose')]


def started(session, **settings):
    """Return a session that has received the meeting."""
    run = session(run_settings(**settings), None)
    for message in MEETING:
        run.receive(message)
    return run


def test_steps_in_portions_are_the_steps_of_one_call(session):
    expected = poses(started(session).release())
    run = started(session)

    portions = [poses(run.release(most=1)) for _ in range(len(expected))]

    assert [pose for portion in portions for pose in portion] == expected
    assert len({tuple(portion) for portion in portions if portion}) >= 5
    assert poses(run.release()) == []


def test_no_step_is_taken_twice_and_none_is_lost(session):
    expected = poses(started(session).release())
    run = started(session)

    assert poses([*run.take(), *run.release(), *run.close()]) == expected


def test_only_a_run_that_resets_must_restart_after_time_jumps_back(session):
    for on_time_jump, must_restart in ('reset', True), ('refuse', False):
        run = session(run_settings('r1', on_time_jump=on_time_jump, stale_after=1.0), None)
        for ms in [*range(5000, 7000, 100), *range(0, 2000, 100)]:
            run.receive(raw('r1/odom', odometry_message(ms), ms))

        assert run.inputs.time_jump_detector.has_ended_run() is must_restart


def test_a_run_that_follows_has_the_true_map_and_the_input_since_the_jump(session):
    settings = run_settings('r1', on_time_jump='reset', stale_after=1.0)
    earlier, following = session(settings, None), session(settings, None)
    true_map = meeting_truth()[0]
    earlier.receive(raw_record(true_map))
    for ms in [*range(5000, 7000, 100), *range(0, 500, 100)]:
        earlier.receive(raw('r1/odom', odometry_message(ms, child='base'), ms))
    assert earlier.inputs.time_jump_detector.has_ended_run()

    following.continue_from(earlier)

    assert following.consumer.truth.landmarks.keys() == true_map.positions.keys()
    assert following.inputs.frames.base('r1') == 'base'
    assert [stamp // 10**6 for _, stamp in poses(following.release())] == [0, 100, 200, 300, 400]


def test_an_interrupted_run_has_no_state_hash(session):
    run = started(session)
    list(run.close())
    assert len(run.state_hash()) == 64

    run.consumer.statistics.reject(Rejection('r1', 0, RejectionReason.INTERRUPTED))

    assert run.state_hash() is None


def test_a_state_hash_that_takes_too_long_is_given_up(session, monkeypatch):
    run = started(session)
    list(run.close())

    def late():
        raise EndedError

    run.check_time = late
    monkeypatch.setattr(run.consumer, 'state_hash', lambda: pause() or 'hash')

    assert run.state_hash() is None


def test_rejections_are_published_while_no_step_is_due(session):
    run = started(session)
    list(run.release())
    assert list(run.take()) == []

    run.receive(raw('r1/odom', odometry_message(500, (1e12, 0.0, 0.0)), 500))

    assert [topic for topic, _ in run.take()] == ['~/rejections']
