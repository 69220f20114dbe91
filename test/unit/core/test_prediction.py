# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A predicted pose is that of the filter at the newest odometry if nothing is observed."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core import prediction
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.prediction import PosePredictor
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.core.settings import RobotSettings
from helpers.core import estimate, pose_difference, random_covariance, turn
from helpers.records import MS, odometry, scan

R1 = RobotSettings('r1', 1, odometry_noise_scale=1.5)


def curve(seed=1, steps=12, known=True):
    """Return odometry of a robot that drives a random curve, far from its origin."""
    rng = np.random.default_rng(seed)
    pose, records = np.array([40.0, -7.0, 2.5]), []
    for k in range(steps):
        records.append(odometry(
            'r1', 100 * k, pose.copy(), 0.01 * random_covariance(rng, 3) if known else None))
        u = rng.normal([0.5, 0.0, 0.3], 0.1)
        heading = pose[2] + u[2]
        pose = np.array([
            *(pose[:2] + turn(pose[2]) @ u[:2]), np.arctan2(np.sin(heading), np.cos(heading))])
    return records


def settled(ms=0, pose=(1.0, 2.0, 0.5), frame='map', P=None):
    covariance = np.diag([0.04, 0.09, 0.01]) if P is None else P
    return PoseEstimate('r1', ms * MS, frame, np.array(pose), covariance)


def predictor_with(records):
    predictor = PosePredictor()
    for record in records:
        assert predictor.add(record)
    return predictor


@pytest.mark.parametrize('robot', [
    R1, replace(R1, odometry_scale=(0.9, 1.2), odometry_turn_bias=0.3)])
@pytest.mark.parametrize('known', [True, False])
@pytest.mark.parametrize('scans', [(), (250,), (250, 300, 320, 370)])
def test_predictions_are_the_poses_of_the_filter_until_the_next_update(robot, known, scans):
    records = curve(known=known)
    seen = [scan('r1', ms, [(1, (3.0, 1.0))]) for ms in scans]
    _, results = estimate(
        [*records, *seen], [robot], filter='standard', anchor_sigma=(0.2, 0.3, 0.1),
        odometry_sigma=(0.3, 0.2, 0.1), gate_probability=1.0)
    last = next(r for r in results if r.stamp == max(scans, default=0) * MS)
    predictor = PosePredictor()

    for record in records:
        predictor.add(record)
        if record.stamp < last.stamp:
            continue
        predictor.settle(last.poses[0], last.odometry['r1'])
        expected = next(r.poses[0] for r in results if r.stamp == record.stamp)
        found = predictor.predict(robot)
        assert (found.stamp, found.frame) == (expected.stamp, expected.frame)
        # Sums in another order: rounding of coordinates of 40 m.
        np.testing.assert_allclose(
            pose_difference(found.pose, expected.pose), np.zeros(3), atol=1e-12)
        np.testing.assert_allclose(found.P, expected.P, rtol=1e-9, atol=1e-13)


def test_without_odometry_after_it_the_prediction_is_the_settled_pose():
    records = curve(steps=3)
    predictor = predictor_with(records)
    predictor.settle(settled(200), records[-1].pose)

    found = predictor.predict(R1)

    np.testing.assert_allclose(found.pose, settled().pose, atol=1e-15)
    np.testing.assert_allclose(found.P, settled().P, atol=1e-15)


def test_a_newer_settled_pose_replaces_the_older_with_its_frame():
    records = curve()
    predictor = predictor_with(records)

    predictor.settle(settled(100, frame='r1/map'), records[1].pose)
    before = predictor.predict(R1)
    predictor.settle(settled(800), records[8].pose)
    after = predictor.predict(R1)

    assert (before.frame, after.frame) == ('r1/map', 'map')
    assert before.stamp == after.stamp == 1100 * MS
    assert np.linalg.det(after.P) < np.linalg.det(before.P)


def test_odometry_that_is_not_the_newest_is_not_used():
    records = curve()
    predictor = predictor_with(records)
    predictor.settle(settled(), records[0].pose)
    before = predictor.predict(R1)

    assert not predictor.add(records[-1])
    assert not predictor.add(records[5])

    assert predictor.predict(R1).P.tobytes() == before.P.tobytes()


def test_a_settled_pose_at_odometry_that_came_too_late_is_moved_on_from_there():
    records = curve()
    predictor = predictor_with([*records[:2], *records[3:5]])
    assert not predictor.add(records[2])
    predictor.settle(settled(200), records[2].pose)

    found = predictor.predict(R1)

    u = between(records[2].pose, records[4].pose)
    np.testing.assert_allclose(found.pose, compose(settled(200).pose, u), atol=1e-12)


def test_there_is_no_prediction_before_a_settled_pose_and_its_odometry():
    assert PosePredictor().predict(R1) is None
    assert predictor_with(curve()).predict(R1) is None
    early = predictor_with(curve()[3:])
    early.settle(settled(), np.zeros(3))
    assert early.predict(R1) is None


def test_after_a_gap_too_long_to_linearise_there_is_no_prediction_until_a_later_settled_pose():
    records = curve(steps=4)
    gap = replace(records[-1], stamp=3_600_000 * MS)
    predictor = predictor_with(records[:-1])
    predictor.settle(settled(), records[0].pose)
    assert predictor.predict(R1) is not None

    assert predictor.add(gap)
    predictor.settle(settled(200), records[2].pose)
    assert predictor.predict(R1) is None

    predictor.settle(settled(3_600_000, frame='r1/map'), gap.pose)
    assert predictor.predict(R1).frame == 'r1/map'


def test_the_number_of_stored_increments_is_bounded(monkeypatch):
    monkeypatch.setattr(prediction, 'MAX_PENDING', 5)
    predictor = predictor_with(curve(steps=6))
    predictor.settle(settled(), np.zeros(3))
    assert predictor.predict(R1) is not None

    predictor.add(odometry('r1', 700))

    assert predictor.predict(R1) is None


def test_predictions_from_delayed_poses_are_consistent():
    rng = np.random.default_rng(8)
    P0, Q, runs = np.diag([0.01, 0.02, 0.001]), np.diag([0.002, 0.001, 0.0005]), 1000
    nees = []
    for _ in range(runs):
        truth, measured = np.array([3.0, -2.0, 1.0]), np.zeros(3)
        start = truth + rng.multivariate_normal(np.zeros(3), P0)
        predictor = PosePredictor()
        for k in range(8):
            record = Odometry('r1', k * 100 * MS, measured, 100.0 * Q)
            predictor.add(record)
            if k == 0:
                predictor.settle(settled(0, start, P=P0), measured)
            if k < 7:
                u = np.array([0.2, 0.0, 0.1])
                noisy = u + rng.multivariate_normal(np.zeros(3), Q)
                truth, measured = (
                    np.array([*(x[:2] + turn(x[2]) @ v[:2]), x[2] + v[2]])
                    for x, v in ((truth, u), (measured, noisy)))
        found = predictor.predict(RobotSettings('r1', 1))
        error = pose_difference(found.pose, truth)
        nees.append(error @ np.linalg.solve(found.P, error) / 3)

    # 3000 degrees of freedom: the standard deviation of the mean is sqrt(2 / 3000) = 0.026.
    assert np.mean(nees) == pytest.approx(1.0, abs=4 * 0.026)


def test_nothing_is_predicted_over_the_return_from_one_wrong_message():
    records = [odometry('r1', 100 * k, (0.1 * k, 0.0, 0.0)) for k in range(6)]
    records[3] = odometry('r1', 300, (5.0, 0.0, 0.0))
    predictor = predictor_with(records[:4])
    assert predictor.predict(R1) is None

    predictor.add(records[4])
    predictor.settle(settled(300), records[3].pose)

    assert predictor.predict(R1) is None
    predictor.settle(settled(400), records[4].pose)
    predictor.add(records[5])
    assert predictor.predict(R1).stamp == 500 * MS
