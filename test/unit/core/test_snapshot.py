# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimator or smoother restored from a snapshot continues bit for bit like the original."""

from dataclasses import is_dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import get_args, get_type_hints

import numpy as np
import pytest

from fej_slam_ros.core.csam.map_merging import ScaledJoin
from fej_slam_ros.core.csam.slips import ReleasedOdometry
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve, TeamMap
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ordering.record_memory import FORGOTTEN_TOGETHER, MAX_REMEMBERED
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.core.snapshot import (
    attributes_of, CORE, restore, schema_digest, snapshot, SNAPSHOT_CLASSES)
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import bits, circles
from helpers.records import MS, odometry, robot_scan, scan, team, true_pose

#: A short range, so that r3 joins only after a while.
SHORT_SIGHTED = SensorSettings((0.02, 0.02, 0.01), (0.1, 0.1), range=8.0)

OPTIONS = [
    team('r1', 'r2', 'r3'),
    team('r1', 'r2', 'r3', filter='ideal'),
    team('r1', 'r2', 'r3', shared_landmark_ids=False, filter='standard'),
]


def with_faults(records):
    """Delay all scans by half a step; duplicate, contradict and drop some odometry."""
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
    """Add records to an estimator in order; return the bits of all poses."""
    results = []
    for record in records:
        estimator.add(record)
        results += estimator.take()
    return bits(results)


def continued(estimator):
    return restore(snapshot(estimator), estimator.settings, Estimator)


def figures(estimator):
    """Return all reported figures of an estimator."""
    statistics = estimator.statistics
    return (
        estimator.state_hash(), vars(statistics), estimator.steps, estimator.groups.not_in_map,
        {name: (nis.total, nis.dof, nis.outside_for, nis.nis_per_dof(), nis.band())
         for name, nis in estimator.innovations.nis.items()},
        estimator.evaluation.scores, [estimator.used(name) for name in ('r1', 'r2', 'r3')])


@pytest.fixture(scope='module', params=OPTIONS, ids=['fej', 'ideal', 'own numbers'])
def undisturbed(request):
    """Return the settings, the poses at each record and the figures of an uninterrupted run."""
    estimator = Estimator(request.param)
    poses = [run(estimator, [record]) for record in RECORDS]
    poses.append(bits(estimator.close()))
    return request.param, poses, figures(estimator)


def test_the_run_covers_all_state_that_a_checkpoint_must_keep(undisturbed):
    _, poses, (_, statistics, *_) = undisturbed

    frames = {frame for given in poses for _, _, frame, *_ in given}
    assert {'map', 'r3/map'} <= frames
    assert statistics['rejection_counts']['r1'][RejectionReason.DUPLICATE] > 0
    assert statistics['rejection_counts']['r1'][RejectionReason.CONFLICTING] > 0


def test_a_run_restored_before_every_record_equals_the_uninterrupted_run(undisturbed):
    options, poses, expected = undisturbed

    estimator = Estimator(options)
    for record, given in zip(RECORDS, poses):
        estimator = continued(estimator)
        assert run(estimator, [record]) == given
    estimator = continued(estimator)

    assert bits(estimator.close()) == poses[-1]
    assert figures(estimator) == expected


@pytest.mark.parametrize('cut', range(0, len(RECORDS), 97))
def test_input_repeated_after_a_restore_adds_only_rejections(undisturbed, cut):
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


def own_classes(hint):
    """Yield the classes of this package in a type hint."""
    if isinstance(hint, type) and hint.__module__.startswith(CORE):
        yield hint
    for part in get_args(hint):
        yield from own_classes(part)


@pytest.mark.parametrize('cls', [
    cls for cls in SNAPSHOT_CLASSES if is_dataclass(cls) or issubclass(cls, tuple)])
def test_whatever_an_attribute_may_be_is_of_a_snapshot_class(cls):
    for hint in get_type_hints(cls).values():
        for needed in own_classes(hint):
            assert any(issubclass(listed, needed) for listed in SNAPSHOT_CLASSES)


def test_a_snapshot_does_not_change_the_estimator():
    estimator, other = Estimator(team('r1', 'r2', 'r3')), Estimator(team('r1', 'r2', 'r3'))

    for record in RECORDS[:300]:
        snapshot(estimator)
        assert run(estimator, [record]) == run(other, [record])


def long_drive(estimator, until):
    """Drive r1 until a time in ms, with odometry each 10 ms."""
    return run(estimator, (odometry('r1', ms) for ms in range(0, until, 10)))


def test_input_older_than_the_checkpoint_remembers_is_counted_apart_from_late_input():
    beyond = 10 * (MAX_REMEMBERED + FORGOTTEN_TOGETHER)
    estimator = Estimator(team('r1'))
    long_drive(estimator, beyond)
    estimator = continued(estimator)

    assert long_drive(estimator, beyond + 10) != []

    assert estimator.statistics.rejection_counts['r1'] == {
        RejectionReason.BEFORE_CHECKPOINT: FORGOTTEN_TOGETHER,
        RejectionReason.DUPLICATE: MAX_REMEMBERED}
    assert not estimator.statistics.depends_on_arrival()


def test_new_input_that_is_too_late_after_a_checkpoint_is_late():
    estimator = Estimator(team('r1'))
    long_drive(estimator, 2000)
    estimator = continued(estimator)

    estimator.add(scan('r1', 1000, [(1, (2.0, 0.0))]))

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.LATE: 1}
    assert estimator.statistics.depends_on_arrival()


def test_poses_that_wait_for_ground_truth_are_evaluated_after_a_checkpoint():
    estimator = Estimator(team('r1'))
    run(estimator, [true_pose('r1', 0, np.zeros(3)), *(odometry('r1', t) for t in (0, 200, 400))])
    estimator = continued(estimator)

    run(estimator, [true_pose('r1', 500, (0.5, 0.75, 0.0)), odometry('r1', 1000)])

    # At 0.2 s the truth is 0.3 m to the left of where odometry says, at 0 s nothing is wrong.
    score = estimator.evaluation.scores['r1']
    assert score.steps == 3
    np.testing.assert_allclose(
        score.position_rmse(), np.sqrt((0.3**2 + 0.6**2) / 3), rtol=1e-12)


@pytest.mark.parametrize('filter_', ['fej', 'ideal'])
def test_true_poses_in_another_order_are_used_after_a_checkpoint(filter_):
    """That of the first odometry arrives after that of the second."""
    estimator = Estimator(team('r1', filter=filter_))
    run(estimator, [true_pose('r1', 200, np.zeros(3))])
    estimator = continued(estimator)

    run(estimator, [true_pose('r1', 0, np.zeros(3)), *(odometry('r1', t) for t in (0, 200))])
    for _ in estimator.close():
        pass

    assert estimator.evaluation.scores['r1'].steps == 2


def test_waiting_robot_observations_are_kept():
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


def test_settings_of_numpy_numbers_of_a_robot_that_has_left_are_kept():
    """The settings of robots are not stored, but those of one that has left are."""
    robots = RobotSettings('r1', 1), RobotSettings('r2', 2, start_pose=tuple(np.ones(3)))
    settings = Settings(robots, 'r1')
    estimator = Estimator(settings)
    estimator.add(odometry('r2', 1))
    remaining = replace(settings, robots=robots[:1])
    estimator.change_team(remaining.robots, remaining)

    restored = restore(snapshot(estimator), remaining, Estimator)

    assert restored.state_hash() == estimator.state_hash()


def test_a_snapshot_of_an_estimator_is_none_of_a_smoother():
    plain = snapshot(Estimator(team('r1')))

    with pytest.raises(TypeError, match=r'^not a snapshot of TeamSmoother$'):
        restore(plain, team('r1'), TeamSmoother)


def test_a_class_that_is_not_listed_is_refused_when_a_snapshot_is_taken():
    estimator = Estimator(team('r1'))
    estimator.statistics.rejections.append(pairwise('ab'))

    with pytest.raises(TypeError, match=r'^pairwise is not one of SNAPSHOT_CLASSES$'):
        snapshot(estimator)


def smooth(smoother, restored_every=None):
    """
    Add all records to a smoother, which is restored and solved for now and then.

    Return the bits of all poses, the state hash and the counts of the input.

    """
    poses = []
    for number, record in enumerate(circles(seed=1)):
        if restored_every and number % restored_every == 0:
            smoother = restore(snapshot(smoother), smoother.settings, TeamSmoother)
        smoother.add(record)
        poses += [(estimate.robot, estimate.stamp, estimate.pose.tobytes(), estimate.P.tobytes())
                  for estimate in smoother.take()]
        if number % 400 == 399:
            smoother.adopt(solve(smoother.task()))
    list(smoother.close())
    smoother.adopt(solve(smoother.task()))
    return poses, smoother.state_hash(), vars(smoother.statistics), smoother.not_in_map()


def test_a_smoother_that_is_restored_often_equals_the_uninterrupted_one():
    settings = team()

    expected = smooth(TeamSmoother(settings, solve_every=20))

    assert smooth(TeamSmoother(settings, solve_every=20), restored_every=37) == expected
    assert expected[-1] == {}


def test_a_smoother_keeps_what_its_solution_says_of_slips_and_scales():
    smoother = TeamSmoother(team('r1', 'r2'))
    solution = TeamMap(
        released=(ReleasedOdometry('r2', ((3, 5),), 7),),
        scaled=(ScaledJoin(('r1',), ('r2',), 1.03),))
    smoother.adopt(solution)

    again = restore(snapshot(smoother), smoother.settings, TeamSmoother).solution

    assert (again.released, again.scaled) == (solution.released, solution.scaled)


def test_a_restored_smoother_asks_for_the_solution_that_was_being_computed():
    smoother = TeamSmoother(team('r1', 'r2', 'r3'))
    for record in RECORDS:
        smoother.add(record)
    list(smoother.release())
    smoother.task()

    assert smoother.new_poses == 0
    assert restore(snapshot(smoother), smoother.settings, TeamSmoother).new_poses > 0


def named_attributes(plain):
    """Yield the class name and the attribute names of each object in a snapshot."""
    if isinstance(plain, dict):
        if 'object' in plain:
            name, attributes = plain['object']
            yield name, set(attributes)
        plain = [*plain.values()]
    if isinstance(plain, list):
        for part in plain:
            yield from named_attributes(part)


@pytest.mark.parametrize(
    'consumer', [*map(Estimator, OPTIONS), TeamSmoother(OPTIONS[0])],
    ids=['fej', 'ideal', 'own numbers', 'smoother'])
def test_the_schema_has_every_class_and_attribute_of_a_snapshot(consumer):
    for record in RECORDS:
        consumer.add(record)
        list(consumer.take())
    if isinstance(consumer, TeamSmoother):
        consumer.adopt(solve(consumer.task()))
        assert consumer.solution.not_joined
    schema = {
        f'{cls.__module__.removeprefix(CORE)}.{cls.__qualname__}': attributes_of(cls)
        for cls in SNAPSHOT_CLASSES}

    for name, attributes in named_attributes(snapshot(consumer)):
        assert attributes <= schema[name]


def test_the_schema_digest_covers_enum_members(monkeypatch):
    before = schema_digest()
    longer = Enum('RejectionReason', {m.name: m.value for m in RejectionReason} | {'NEW': 'new'})
    longer.__module__ = RejectionReason.__module__
    monkeypatch.setattr('fej_slam_ros.core.snapshot.SNAPSHOT_CLASSES', tuple(
        longer if cls is RejectionReason else cls for cls in SNAPSHOT_CLASSES))

    assert schema_digest() != before


def test_classes_of_one_name_are_listed_once():
    names = [f'{cls.__module__}.{cls.__qualname__}' for cls in SNAPSHOT_CLASSES]

    assert len(set(names)) == len(names)
