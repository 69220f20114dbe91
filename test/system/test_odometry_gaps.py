# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""After a gap of its odometry a robot stays consistent."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.records import NS, TrueLandmarks
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure, SensorSettings
from helpers.core import circles, estimate, pose_difference
from helpers.records import odometry, scan

SILENT = 20 * NS
BACK = 50 * NS
#: Odometry whose heading drifts by some 2 degrees in 30 s.
PRECISE = SensorSettings((0.02, 0.02, 0.002), (0.5, 0.5))


def with_a_gap(seed, sensors=None):
    """Return an estimator whose second robot is silent for 30 s, and NEES / 3 afterwards."""
    environment = ENVIRONMENTS['circles']
    rng = np.random.default_rng(seed)
    true = environment.true_world(rng)
    records = [
        record for record in measure(true, sensors or environment.sensors, rng)
        if isinstance(record, TrueLandmarks) or record.robot == 'r1'
        or not SILENT < record.stamp < BACK]
    estimator, steps = estimate(records)
    poses = [pose for step in steps for pose in step.poses
             if pose.robot == 'r2' and pose.stamp >= BACK]
    errors = [pose_difference(pose.pose, true.true_poses['r2'][round(pose.stamp * 5 / NS)])
              for pose in poses]
    nees = [e @ np.linalg.solve(pose.P, e) / 3.0 for e, pose in zip(errors, poses)]
    return estimator, {pose.frame for pose in poses}, np.mean(nees)


@pytest.mark.slow
def test_after_a_gap_with_unknown_heading_a_robot_relocalizes_and_is_consistent():
    # Odometry covers the gap with 5 rad. A linear update from there gives 15 in the mean.
    runs = [with_a_gap(seed) for seed in range(20)]

    assert all(frames == {'map'} for _, frames, _ in runs)
    assert {estimator.statistics.relocalized['r2'] for estimator, _, _ in runs} == {1}
    # Means of 20 correlated runs scatter by about 0.1.
    assert 0.75 < np.mean([nees for _, _, nees in runs]) < 1.3


def test_after_a_gap_with_known_heading_a_robot_continues():
    estimator, frames, nees = with_a_gap(1, PRECISE)

    assert frames == {'map'}
    assert estimator.statistics.relocalized['r2'] == 0
    assert nees < 3.0


@pytest.mark.parametrize('Q', [
    np.diag([1e8, 1e8, 0.0]), np.diag([0.0, 0.0, 1e9]), 1e12 * np.eye(3)])
@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_uninformative_odometry_is_survived_at_any_time(robot, Q):
    seen = [(1, (5.0, 1.0)), (2, (4.0, -3.0)), (3, (-2.0, 3.0))]
    # r1 is the anchor, which sees nothing at first; r2 sees what r1 does not until the end.
    records = []
    for k, ms in enumerate(range(0, 1200, 100)):
        jump = (1e6, 0.0, 1.0) if k % 3 == 0 else (0.0, 0.0, 0.0)
        for name in ('r1', 'r2'):
            strange = name == robot and k % 3 == 0
            records.append(odometry(name, ms, jump if strange else (0.0, 0.0, 0.0),
                                    Q if strange else np.diag([1e-4, 1e-4, 1e-4])))
            numbers = seen if name == 'r2' or k >= 6 else []
            shift = 10 if name == 'r2' and k < 9 else 0
            records.append(scan(name, ms, [(n + shift, z) for n, z in numbers]))

    estimator, steps = estimate(records)

    assert estimator.statistics.relocalized[robot] > 0
    for step in steps:
        for pose in step.poses:
            assert np.linalg.eigvalsh(pose.P)[0] > -1e-9
            assert np.isfinite(pose.pose).all()
    assert [pose.frame for pose in steps[-1].poses] == ['map', 'map']


@pytest.mark.parametrize(('shared', 'frame'), [(2, 'r2/map'), (3, 'map')])
def test_a_lost_robot_needs_enough_known_landmarks_to_relocalize(shared, frame):
    seen = [(1, (5.0, 1.0)), (2, (4.0, -3.0)), (3, (-2.0, 3.0))]
    records = []
    for ms in (0, 100, 200):
        for name in ('r1', 'r2'):
            records += [odometry(name, ms, (0.0, 0.0, 0.0)), scan(name, ms, seen)]
    records += [odometry('r1', 300, (0.0, 0.0, 0.0)),
                odometry('r2', 300, (0.0, 0.0, 0.0), np.diag([1.0, 1.0, 100.0])),
                scan('r2', 300, seen[:shared])]

    _, steps = estimate(records)

    assert [pose.frame for pose in steps[-1].poses] == ['map', frame]


@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_a_first_odometry_without_a_stamp_only_costs_one_pose(robot):
    today = 10**18
    records = [
        record if isinstance(record, TrueLandmarks)
        else replace(record, stamp=record.stamp + today) for record in circles(3)]
    expected, steps = estimate(records)

    estimator, with_one_more = estimate([odometry(robot, 0, (5.0, 5.0, 1.0)), *records])

    assert estimator.state_hash() == expected.state_hash()
    assert len(with_one_more) == len(steps) + 1
