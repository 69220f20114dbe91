# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keyframes: how many poses are kept, what the others lose, and what they do not."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.csam.keyframes import KEYFRAME_TURN, Keyframes
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.records import Motion, Observation, Scan, TruePose
from helpers import csam
from helpers.core import circles, pose_difference
from helpers.records import odometry, robot_scan, scan, team

RECORDS = circles(seed=1)


def smoothed(records, distance, solved=True):
    """Return a smoother after some records, and the poses that it yielded."""
    return csam.smoothed(records, replace(team(), keyframe_distance=distance), solved)


def moved(x, phi=0.0):
    return Motion('r1', 0, np.array([x, 0.0, phi]), np.eye(3))


def seen(*ids):
    return tuple(Observation(id_, np.ones(2), np.eye(2)) for id_ in ids)


def test_a_pose_is_kept_after_a_motion_or_if_a_landmark_was_not_seen_from_there():
    keyframes = Keyframes(1.0)

    def kept(motion, *ids):
        return bool(keyframes.choose([('r1', motion, seen(*ids))]))

    assert kept(None, 7)
    assert not kept(moved(0.6), 7)
    assert kept(moved(0.6))
    # Counted from there; a way back does not count.
    assert not kept(moved(0.9))
    assert not kept(moved(-0.9))
    assert kept(moved(0.1, KEYFRAME_TURN))
    # Landmark 7 was last kept at another place.
    assert kept(moved(0.0), 7)
    assert not kept(moved(0.0), 7)
    assert kept(moved(0.0), 7, 8)
    assert not kept(moved(0.0), 8)


def test_the_distance_of_keyframes_is_that_of_poses():
    keyframes = Keyframes(1.0)

    kept = [
        bool(keyframes.choose([('r1', motion, ())]))
        for motion in (None, moved(0.9, 0.4), moved(0.104), moved(0.004))]

    # After the turn 0.104 m lead to (0.9 + 0.096, 0.04), 0.997 m from the start.
    assert kept == [True, False, False, True]


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_a_turn_across_pi_counts_as_far_as_it_goes(side):
    keyframes = Keyframes(1.0)

    kept = [
        bool(keyframes.choose([('r1', motion, ())]))
        for motion in (None, *(moved(0.0, side * turn) for turn in (3.0, 0.4, 0.2)))]

    assert kept == [True, True, False, True]


def test_an_observation_of_a_robot_is_kept_if_either_has_moved():
    keyframes = Keyframes(1.0)
    observed = robot_scan('r1', 0, [('r2', (3.0, 1.0))])

    def kept(u, v):
        keyframes.choose([('r1', u, ()), ('r2', v, ())])
        return bool(keyframes.choose_robot_scans([observed]))

    assert kept(None, None)
    assert not kept(moved(0.5), moved(0.5))
    assert kept(moved(0.1), moved(0.5))
    assert kept(moved(1.0), moved(0.0))
    assert not kept(moved(0.0), moved(0.9))


def test_of_two_robots_in_a_scan_the_observation_of_the_one_that_has_moved_is_kept():
    keyframes = Keyframes(1.0)
    observed = robot_scan('r1', 0, [('r2', (3.0, 1.0)), ('r3', (1.0, 2.0))])

    def kept(u2, u3):
        keyframes.choose([('r1', u2 and moved(0.0), ()), ('r2', u2, ()), ('r3', u3, ())])
        return [
            o.observed for scan in keyframes.choose_robot_scans([observed])
            for o in scan.observations]

    assert kept(None, None) == ['r2', 'r3']
    assert kept(moved(0.0), moved(1.0)) == ['r3']
    assert kept(moved(1.0), moved(0.0)) == ['r2']


def test_a_robot_that_returns_keeps_its_first_pose_with_all_it_sees():
    keyframes = Keyframes(1.0)

    def kept(*motions):
        return [bool(keyframes.choose([('r1', motion, seen(7))])) for motion in motions]

    assert kept(None, moved(0.5)) == [True, False]
    assert kept(None, moved(0.5)) == [True, False]


def test_of_robots_that_observe_each_other_at_one_stamp_both_observations_are_kept():
    scans = [
        robot_scan('r1', 0, [('r2', (3.0, 1.0))]), robot_scan('r2', 0, [('r1', (2.0, 2.0))])]
    for order in (scans, scans[::-1]):
        keyframes = Keyframes(1.0)
        keyframes.choose([('r1', None, ()), ('r2', None, ())])

        assert [scan.robot for scan in keyframes.choose_robot_scans(order)] == [
            scan.robot for scan in order]
        keyframes.choose([('r1', moved(0.5), ()), ('r2', moved(0.5), ())])
        assert keyframes.choose_robot_scans(order) == []


def test_at_distance_0_all_poses_are_kept():
    every, poses = smoothed(RECORDS, 0.0, solved=False)

    assert sum(len(trajectory.stamps) for trajectory in every.trajectories.values()) == len(poses)
    assert every.between_keyframes.total() == 0


def test_a_robot_that_stands_still_keeps_one_pose():
    records = [
        record for ms in range(0, 60_000, 100)
        for record in (odometry('r1', ms, (0.0, 0.0, 0.0)), scan('r1', ms, [(1, (2.0, 1.0))]))]

    smoother, poses = smoothed(records, 0.5, solved=False)

    assert len(poses) == 600
    assert len(smoother.trajectories['r1'].stamps) == 1
    assert smoother.between_keyframes['r1'] == 599


def test_odometry_between_keyframes_is_lossless():
    """Without observations in between, the measurements are the same ones, to first order."""
    own = [r for r in RECORDS if getattr(r, 'robot', '') == 'r1' and not isinstance(r, TruePose)]
    kept, _ = smoothed(own, 2.0)
    stamps = {*kept.trajectories['r1'].stamps}
    every, _ = smoothed([r for r in own if not isinstance(r, Scan) or r.stamp in stamps], 0.0)

    expected = {estimate.stamp: estimate for estimate in every.trajectories['r1'].estimates()}
    for estimate in kept.trajectories['r1'].estimates():
        theirs = expected[estimate.stamp]
        # A hundredth of sigma: the covariance of a motion depends on the headings in it.
        sigma = np.sqrt(np.diag(theirs.P)) + 1e-9
        assert_allclose(pose_difference(estimate.pose, theirs.pose) / sigma, 0.0, atol=0.03)
        assert_allclose((estimate.P - theirs.P) / np.outer(sigma, sigma), 0.0, atol=0.02)


def test_before_a_solution_the_newest_pose_has_all_observations():
    _, every = smoothed(RECORDS, 0.0, solved=False)
    _, poses = smoothed(RECORDS, 3.0, solved=False)

    # Up to the first solution of either.
    for one, other in list(zip(poses, every))[:60]:
        assert (one.robot, one.stamp) == (other.robot, other.stamp)
        assert_array_equal(one.pose, other.pose)
        assert_array_equal(one.P, other.P)


def test_the_newest_pose_stays_where_it_is_when_a_solution_is_adopted():
    smoother, poses = smoothed(RECORDS, 3.0, solved=False)
    newest = {pose.robot: pose for pose in poses}
    passed = [
        name for name, trajectory in smoother.trajectories.items()
        if newest[name].stamp > trajectory.stamps[-1]]
    assert passed

    smoother.adopt(solve(smoother.task()))

    for name in passed:
        trajectory = smoother.trajectories[name]
        *_, last = trajectory.estimates()
        increments = [
            r.pose for r in RECORDS if getattr(r, 'robot', '') == name
            and r.stamp in (last.stamp, newest[name].stamp) and hasattr(r, 'twist_covariance')]
        assert trajectory.newest().stamp == newest[name].stamp
        assert_allclose(
            between(last.pose, trajectory.newest().pose), between(*increments), atol=1e-9)


def test_solutions_with_keyframes_are_consistent():
    values = []
    for seed in range(20):
        records = circles(seed=seed)
        smoother, _ = smoothed([r for r in records if getattr(r, 'robot', '') != 'r2'], 2.0)
        true = {r.stamp: r.pose for r in records if isinstance(r, TruePose) and r.robot == 'r1'}
        first, *_, last = smoother.trajectories['r1'].estimates()
        error = pose_difference(
            between(first.pose, last.pose), between(true[first.stamp], true[last.stamp]))
        values.append(nees_per_dof(error[None], last.P[None])[0])

    # The mean of 20 values of 3 degrees of freedom has a sigma of 0.18.
    assert np.mean(values) == pytest.approx(1.0, abs=0.55)


def test_a_robot_that_is_observed_keeps_that_pose():
    records = [
        record for ms in range(0, 5_000, 100) for record in (
            odometry('r1', ms, (ms / 1000.0, 0.0, 0.0)), odometry('r2', ms, (0.0, 0.0, 0.0)))]
    records += [
        robot_scan('r1', ms, [('r2', (3.0 - ms / 1000.0, 1.0))]) for ms in (1200, 1300, 2500)]

    smoother, _ = smoothed(sorted(records, key=lambda r: r.stamp), 1.0, solved=False)

    assert smoother.trajectories['r2'].stamps == [0, 1_200_000_000, 2_500_000_000]
    assert [m.stamp for m in smoother.task().measurements] == [1_200_000_000, 2_500_000_000]
    assert +smoother.between_keyframes == {'r1': 1}
    # They do not move the keyframes of r1.
    assert {k * 1_000_000_000 for k in range(5)} < {*smoother.trajectories['r1'].stamps}
