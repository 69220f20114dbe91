# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimator that is taken apart and put together goes on as if nothing had happened."""

from itertools import pairwise

import numpy as np
import pytest

from fej_slam_ros.core.checkpoint import restore, snapshot
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ordering.robot_queue import REMEMBERED
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import bits, circles
from helpers.records import MS, odometry, robot_scan, scan, team, true_pose

#: Sees a part of the landmarks only, so that r3 has to wait until it can join.
SHORT_SIGHTED = SensorSettings((0.02, 0.02, 0.01), (0.1, 0.1), range=8.0)

OPTIONS = [
    team('r1', 'r2', 'r3'),
    team('r1', 'r2', 'r3', filter='ideal'),
    team('r1', 'r2', 'r3', shared_landmark_ids=False, filter='standard'),
]


def with_faults(records):
    """Delay all scans by half a step, and repeat, contradict and lose some odometry."""
    faulty = []
    for k, record in enumerate(records):
        if isinstance(record, Scan):
            faulty.append(Scan(record.robot, record.stamp + 50 * MS, record.observations))
            continue
        if not isinstance(record, Odometry) or k % 11:
            faulty.append(record)
        if isinstance(record, Odometry) and k % 13 == 0:
            other = Odometry(record.robot, record.stamp, record.pose + 1.0, None)
            faulty += [record, other]
    return faulty


RECORDS = with_faults(circles(3, robots=3, sensors=SHORT_SIGHTED))


def run(estimator, records):
    """Give records to an estimator as they arrive; return the bits of all poses."""
    results = []
    for record in records:
        estimator.add(record)
        results += estimator.take()
    return bits(results)


def continued(estimator):
    return restore(snapshot(estimator), estimator.settings)


def account(estimator):
    """Return all that an estimator says of itself."""
    statistics = estimator.statistics
    return (
        estimator.state_hash(), vars(statistics), estimator.steps, estimator.not_in_map,
        {name: (nis.total, nis.dof, nis.outside_for, nis.ratio(), nis.band())
         for name, nis in estimator.nis.items()},
        estimator.evaluation.scores, [estimator.used(name) for name in ('r1', 'r2', 'r3')])


@pytest.fixture(scope='module', params=OPTIONS, ids=['fej', 'ideal', 'own numbers'])
def undisturbed(request):
    """Return the settings, the poses at each record and the account of a run without a break."""
    estimator = Estimator(request.param)
    poses = [run(estimator, [record]) for record in RECORDS]
    poses.append(bits(estimator.close()))
    return request.param, poses, account(estimator)


def test_the_run_has_everything_that_a_checkpoint_must_keep(undisturbed):
    _, poses, (_, statistics, *_) = undisturbed

    frames = {frame for given in poses for _, _, frame, *_ in given}
    assert {'map', 'r3/map'} <= frames
    assert statistics['rejection_counts']['r1'][RejectionReason.DUPLICATE] > 0
    assert statistics['rejection_counts']['r1'][RejectionReason.CONFLICTING] > 0


def test_a_run_continued_at_every_record_is_the_run_without_a_break(undisturbed):
    options, poses, expected = undisturbed

    estimator = Estimator(options)
    for record, given in zip(RECORDS, poses):
        estimator = continued(estimator)
        assert run(estimator, [record]) == given
    estimator = continued(estimator)

    assert bits(estimator.close()) == poses[-1]
    assert account(estimator) == expected


@pytest.mark.parametrize('cut', range(0, len(RECORDS), 97))
def test_the_whole_input_again_adds_nothing_but_refusals(undisturbed, cut):
    options, poses, (expected, statistics, steps, *_) = undisturbed
    estimator = Estimator(options)
    run(estimator, RECORDS[:cut])
    estimator = continued(estimator)

    again = [run(estimator, [record]) for record in RECORDS]
    again.append(bits(estimator.close()))

    assert again == [[]] * cut + poses[cut:]
    assert estimator.state_hash() == expected
    assert estimator.steps == steps
    assert estimator.statistics.observations_used == statistics['observations_used']
    assert estimator.statistics.total(RejectionReason.LATE) == 0
    assert estimator.statistics.rejection_counts['r2'][RejectionReason.DUPLICATE] >= sum(
        isinstance(record, (Odometry, Scan)) and record.robot == 'r2'
        for record in RECORDS[:cut])


def test_taking_a_snapshot_disturbs_nothing():
    estimator, other = Estimator(team('r1', 'r2', 'r3')), Estimator(team('r1', 'r2', 'r3'))

    for record in RECORDS[:300]:
        snapshot(estimator)
        assert run(estimator, [record]) == run(other, [record])


def long_drive(estimator, until):
    """Drive r1 until a time in ms, with odometry each 10 ms."""
    return run(estimator, (odometry('r1', ms) for ms in range(0, until, 10)))


def test_input_too_old_to_be_remembered_is_told_from_late_input_after_a_checkpoint():
    beyond = 10 * (REMEMBERED + 100)
    estimator = Estimator(team('r1'))
    long_drive(estimator, beyond)
    estimator = continued(estimator)

    assert long_drive(estimator, beyond + 10) != []

    assert estimator.statistics.rejection_counts['r1'] == {
        RejectionReason.BEFORE_CHECKPOINT: 100, RejectionReason.DUPLICATE: REMEMBERED}
    assert not estimator.statistics.depends_on_arrival()


def test_new_data_that_comes_too_late_after_a_checkpoint_is_late():
    estimator = Estimator(team('r1'))
    long_drive(estimator, 2000)
    estimator = continued(estimator)

    estimator.add(scan('r1', 1000, [(1, (2.0, 0.0))]))

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.LATE: 1}
    assert estimator.statistics.depends_on_arrival()


def test_poses_that_wait_for_their_truth_are_scored_after_a_checkpoint():
    estimator = Estimator(team('r1'))
    run(estimator, [true_pose('r1', 0, np.zeros(3)), *(odometry('r1', t) for t in (0, 200, 400))])
    estimator = continued(estimator)

    run(estimator, [true_pose('r1', 500, (0.5, 0.75, 0.0)), odometry('r1', 1000)])

    # At 0.2 s the truth is 0.3 m to the left of where odometry says, at 0 s nothing is wrong.
    score = estimator.evaluation.scores['r1']
    assert score.steps == 3
    np.testing.assert_allclose(
        score.position_rmse(), np.sqrt((0.3**2 + 0.6**2) / 3), rtol=1e-12)


def test_observations_of_robots_that_wait_are_kept():
    records = [
        record for ms in range(0, 1000, 50) for record in (
            odometry('r1', ms), odometry('r2', ms + 20),
            robot_scan('r1', ms + 33, [('r2', (1.0, 0.0))]),
            robot_scan('r2', ms + 61, [('r1', (-1.0, 0.0))]))]
    estimator, whole = Estimator(team()), Estimator(team())

    for record in records:
        estimator = continued(estimator)
        assert run(estimator, [record]) == run(whole, [record])

    assert bits(continued(estimator).close()) == bits(whole.close())
    assert whole.steps['r2'] > 50  # of which 20 are odometry and 20 are scans


def test_an_object_of_another_library_is_refused_when_it_is_saved():
    estimator = Estimator(team('r1'))
    estimator.statistics.rejections.append(pairwise('ab'))

    with pytest.raises(TypeError, match='holds a pairwise, which has no plain form'):
        snapshot(estimator)
