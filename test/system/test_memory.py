# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""However long a run, it holds no more; what is dropped is counted."""

import gc
from itertools import islice
from types import BuiltinFunctionType, FunctionType, ModuleType

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ordering.time_jump import MAX_HELD_RECORDS, TimeJumpDetector
from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.snapshot import snapshot
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import MS, odometry, scan, team, true_pose
from helpers.ros import odometry_message, raw, raw_record, run_settings, seen
from helpers.slow import slow

#: Number of messages after which all queues and buffers are full.
FULL = 25_000
#: Tolerance of the number of records that wait when the memory is measured.
LEVEL = 1.001


def held(value):
    """Return of how many numbers, texts and arrays a snapshot consists: all that is held."""
    if isinstance(value, dict):
        value = [*value.values()]
    return sum(map(held, value)) if isinstance(value, (list, tuple)) else 1


def reachable(value):
    """Return how many objects but classes, modules and functions a value holds."""
    found, waiting = {}, [value]
    while waiting:
        held_one = waiting.pop()
        is_code = isinstance(held_one, (type, ModuleType, FunctionType, BuiltinFunctionType))
        if id(held_one) not in found and not is_code:
            found[id(held_one)] = held_one
            waiting += gc.get_referents(held_one)
    return len(found)


def given(ms):
    return PosePrior('r2', ms * MS, np.zeros(3), np.eye(3))


@pytest.mark.parametrize(('make', 'reason'), [
    slow(lambda ms: odometry('r1', ms, (0.0, 0.0, 0.0)), None),
    slow(lambda ms: scan('r1', ms, [(1, (1.0, 0.0))]), RejectionReason.BEFORE_ODOMETRY),
    slow(lambda ms: scan('r1', 100, [(ms, (1.0, 0.0))]), RejectionReason.BEFORE_ODOMETRY),
    (lambda ms: true_pose('r2', ms, (0.0, 0.0, 0.0)), RejectionReason.AFTER_ODOMETRY),
    (given, RejectionReason.AFTER_ODOMETRY),
], ids=['odometry', 'scans', 'scans at one stamp', 'ground truth', 'given poses'])
def test_input_of_a_single_kind_uses_bounded_memory(make, reason):
    estimator = Estimator(team())
    records = iter([make(10 * k) for k in range(2 * FULL)])

    sizes = []
    for _ in range(2):
        for record in islice(records, FULL):
            estimator.add(record)
            list(estimator.take())
        sizes.append(held(snapshot(estimator)))

    assert sizes[1] < LEVEL * sizes[0]
    assert (reason is None) == (estimator.statistics.rejected.total() == 0)
    assert reason is None or estimator.statistics.total(reason) > FULL


@pytest.mark.slow
def test_a_scan_far_ahead_of_odometry_keeps_no_other_record_in_memory():
    estimator = Estimator(team('r1'))
    estimator.add(scan('r1', 3_600_000))

    sizes = []
    for k in range(FULL):
        estimator.add(odometry('r1', 10 * k, (0.0, 0.0, 0.0)))
        list(estimator.take())
        if k in (FULL // 2, FULL - 1):
            sizes.append(held(snapshot(estimator)))

    assert sizes[1] < LEVEL * sizes[0]


@pytest.mark.slow
def test_a_stale_robot_that_returns_leaves_no_record_in_memory():
    estimator = Estimator(team())

    def drive(robot, since, until):
        for ms in range(since, until, 10):
            estimator.add(odometry(robot, ms, (0.0, 0.0, 0.0)))
            list(estimator.take())

    sizes = []
    for outage in range(0, 180_000, 30_000):
        drive('r1', outage, outage + 30_000)
        drive('r2', outage, outage + 30_000)
        sizes.append(held(snapshot(estimator)))

    assert sizes[-1] < LEVEL * sizes[3]
    assert estimator.statistics.rejected.total() == 0


def test_the_number_of_stored_odometry_frames_is_bounded():
    run = EstimatorSession(run_settings('r1'), None)

    for k in range(1000):
        run.receive(raw('r1/odom', odometry_message(k, child=f'frame_{k}')))
        list(run.take())
    run.receive(raw('r1/landmarks', seen((1, 1.0, 0.0), ms=999, frame='frame_999')))

    assert held(run.inputs.snapshot()) < 100
    assert run.estimator.statistics.total(RejectionReason.WRONG_FRAME) == 1


def test_records_held_while_a_time_jump_is_undecided_are_bounded():
    estimator = Estimator(team())
    time_jump_detector = TimeJumpDetector(estimator)
    time_jump_detector.add(odometry('r1', 3_600_000), None)

    for ms in range(FULL):
        time_jump_detector.add(odometry('r1', ms % 3), None)

    # The first stays, and what is too much is late.
    assert estimator.statistics.received['r1'] == 1 + FULL - MAX_HELD_RECORDS


def test_a_log_holds_no_more_however_often_one_landmark_is_moved():
    run = EstimatorSession(run_settings('r1', moved_landmarks='forget'), None)

    sizes, texts = [], []
    for k in range(2000):
        run.log.add_rejections(
            [Rejection('r1', k * MS, RejectionReason.MOVED_LANDMARK, id=7)] * 2)
        texts += [line.text for line in run.log.take()]
        if k in (999, 1999):
            sizes.append(reachable(run.log))

    assert sizes[1] - sizes[0] < 10
    assert len(texts) == 2000


def test_a_robot_without_odometry_that_is_given_poses_uses_bounded_memory():
    run = EstimatorSession(run_settings(), None)

    sizes = []
    for k in range(20_000):
        run.receive(raw_record(given(k)))
        list(run.take())
        if k in (11_999, 19_999):
            sizes.append(reachable(run.inputs.health))

    assert sizes[1] < LEVEL * sizes[0]
