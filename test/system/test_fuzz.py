# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ten thousand malformed messages in a valid stream change no bit and are all counted."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.ros import cloud, drive, odometry_message, raw, raw_record, seen
from helpers.slow import slow

SETTINGS = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1')
#: Two robots among 12 landmarks for 5 s.
GOOD = [raw_record(record) for record in simulation.parse(
    {'loops': 1, 'steps_per_loop': 25, 'landmarks': 12, 'rate': 5}).records()]
STRANGE = (np.nan, np.inf, -np.inf, 1e300, -1e300)
YEAR = 365 * 86400e3
FAR_BACK = ('conflicting late', 'before_odometry')


def bad_odometry(rng, ms):
    """Yield odometry with one thing wrong, and under what name it must be counted."""
    for value in STRANGE:
        reason = 'out_of_range' if np.isfinite(value) else 'not_finite'
        xyz = [0.0, 0.0, 0.0]
        xyz[rng.integers(3)] = value
        yield odometry_message(ms, xyz), reason
        covariance = np.eye(6)
        covariance[5, 5] = value
        yield odometry_message(ms, twist_covariance=covariance), reason
    yield odometry_message(ms, quaternion=(0.0, 0.0, 0.0, np.nan)), 'not_finite'
    yield odometry_message(ms, quaternion=(0.0, 0.0, 0.0, 0.0)), 'bad_quaternion'
    yield odometry_message(ms, quaternion=rng.uniform(1.0, 9.0, 4)), 'bad_quaternion'
    for axis in ((1.0, 0.0), (0.0, 1.0)):
        half = rng.uniform(0.15, 1.5)
        x, y = np.sin(half) * np.array(axis)
        yield odometry_message(ms, quaternion=(x, y, 0.0, np.cos(half))), 'tilted'
    indefinite = np.diag([1.0, -1.0, 0.0, 0.0, 0.0, 1.0])
    yield odometry_message(ms, twist_covariance=indefinite), 'bad_covariance'
    yield odometry_message(ms + rng.uniform(6e3, YEAR)), 'future'
    # Stamps of zero and such as have been.
    yield odometry_message(0, (rng.normal(), 0.0, 0.0)), 'conflicting late'


def bad_scans(rng, ms):
    """Yield scans of which nothing is left, and how often each name must be counted."""
    number = int(rng.integers(1, 12))
    for value in STRANGE:
        reason = 'out_of_range' if np.isfinite(value) else 'not_finite'
        yield seen((number, value, 1.0), ms=ms), reason
        yield cloud({
            'x': ('f8', [1.0]), 'y': ('f4', [1.0]), 'id': ('i4', [number]),
            'var_x': ('f8', [value]), 'cov_xy': ('f8', [0.0]), 'var_y': ('f8', [1.0])}, ms), reason
    yield seen((number, 1.0, 1.0), (number, 2.0, 1.0), ms=ms), 'duplicate_id duplicate_id'
    yield seen((int(rng.integers(-1000, -1)), 1.0, 1.0), ms=ms), 'bad_id'
    yield seen((number, 1.0, 1.0), ms=ms, frame='elsewhere'), 'wrong_frame'
    yield cloud({'x': ('f8', [1.0]), 'id': ('i4', [number])}, ms), 'bad_cloud'
    yield cloud({'x': ('i4', [1]), 'y': ('f8', [1.0]), 'id': ('i4', [number])}, ms), 'bad_cloud'
    whole = seen((number, 1.0, 1.0), ms=ms)
    yield replace(whole, row_step=int(rng.integers(1, 19))), 'bad_cloud'
    yield replace(whole, data=whole.data[:-1]), 'bad_cloud'
    yield replace(whole, point_step=1), 'bad_cloud'
    swapped = seen((number, float(np.float64(1e300).byteswap()), 1.0), ms=ms)
    yield replace(swapped, is_bigendian=True), 'out_of_range'
    yield cloud({
        'x': ('f8', [1.0]), 'y': ('f8', [1.0]), 'id': ('i4', [number]), 'var_x': ('f8', [1.0]),
        'cov_xy': ('f8', [2.0]), 'var_y': ('f8', [1.0])}, ms), 'bad_covariance'
    yield seen((number, 1.0, 1.0), ms=ms + rng.uniform(6e3, YEAR)), 'future'
    yield seen((number, 1.0, 1.0), ms=-rng.uniform(1.0, 1e6)), 'before_odometry'


def bad_messages(seed, count, ms):
    """Yield messages received at a time, with the reasons for which they may be rejected."""
    rng = np.random.default_rng(seed)
    while True:
        for kind, messages in (('odom', bad_odometry(rng, ms)), ('landmarks', bad_scans(rng, ms))):
            for message, reasons in messages:
                robot = f'r{rng.integers(1, 3)}'
                arrived = raw(f'{robot}/{kind}', message, ms)
                cut = replace(arrived, raw=arrived.raw[:rng.integers(len(arrived.raw) - 4)])
                for pair in ((arrived, reasons), (cut, 'bad_message')):
                    if count == 0:
                        return
                    count -= 1
                    yield pair


@pytest.mark.parametrize('count', [1000, slow(10_000)])
def test_malformed_messages_change_no_bit_and_are_counted_by_reason(count):
    expected = EstimatorSession(RunSettings(SETTINGS), None)
    in_peace = drive(expected, GOOD)
    run, published, allowed, held = EstimatorSession(RunSettings(SETTINGS), None), [], Counter(), 0
    # By then steps have been done; before, a broken first stamp would be as good as any.
    places = np.linspace(30, len(GOOD) - 1, 20).astype(int)
    for k, good in enumerate(GOOD):
        run.receive(good)
        published += run.take()
        if k in places:
            for message, reasons in bad_messages(k, count // 20, good.received / 1e6):
                before = {r: run.estimator.statistics.total(r) for r in RejectionReason}
                run.receive(message)
                published += run.take()
                counted = [r.value for r in RejectionReason
                           for _ in range(run.estimator.statistics.total(r) - before[r])]
                # Messages far back are counted when odometry shows that time has not jumped.
                assert counted or reasons in FAR_BACK, (message.topic, reasons)
                held += not counted
                assert set(counted) <= set(reasons.split()), (counted, reasons)
                allowed.update(counted)
    published += run.close()

    assert run.estimator.state_hash() == expected.estimator.state_hash()
    poses = [
        [(topic, bytes(m.pose.covariance), m.pose.pose.position.x)
         for topic, m in publications if topic.endswith('/pose')]
        for publications in (in_peace, published)]
    assert poses[0] == poses[1]
    assert allowed.total() + held >= count
    before, after = (
        sum(r.estimator.statistics.total(reason) for reason in RejectionReason)
        for r in (expected, run))
    assert after == before + allowed.total() + held
