# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The smoother of a team, driven by records: the minimum over all of them, in the right frame."""

from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam import team_solution
from fej_slam_ros.core.csam.outlier_removal import without_outliers
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.gauss_newton import ConvergenceError
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.records import Odometry, PosePrior, TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import Values
from helpers.core import circles, pose_difference, turn
from helpers.records import MS, odometry, scan, team

#: Robots that know that they see the same landmarks; the covariances told are the true ones.
RECORDS = circles(seed=1)


def given(records=RECORDS, settings=None, solved=True, **options):
    """Return a smoother that was given records, and the poses that it told on the way."""
    smoother = TeamSmoother(settings or team(), **options)
    for record in records:
        smoother.add(record)
    told = list(smoother.close())
    if solved:
        smoother.adopt(solve(smoother.task()))
    return smoother, told


def final_poses(smoother, robot):
    return np.array([estimate.pose for estimate in smoother.trajectories[robot].estimates()])


def true_poses(robot):
    return np.array([r.pose for r in RECORDS if isinstance(r, TruePose) and r.robot == robot])


def test_a_robot_alone_ends_at_the_minimum_of_all_it_measured():
    smoother, _ = given([r for r in RECORDS if getattr(r, 'robot', 'r1') == 'r1'])
    local = smoother.task().maps[0]
    truth = next(r for r in RECORDS if isinstance(r, TrueLandmarks)).positions
    true = true_poses('r1')
    seen = np.array([truth[id_] for _, id_ in local.landmarks])
    points = (seen - true[0, :2]) @ turn(true[0, 2])

    batch = least_squares.solve(
        local.problem, Values(np.array([between(true[0], x) for x in true]), points)).values

    # Iteration ends when no coordinate moves by 1e-9.
    assert_allclose(
        pose_difference(final_poses(smoother, 'r1'), batch.poses), 0.0, atol=1e-8)
    assert smoother.trajectories['r1'].frame == 'r1/map'


def test_robots_that_share_numbers_end_in_map_as_consistent_as_they_say():
    smoother, _ = given()

    scores = smoother.scores()

    assert {way.frame for way in smoother.trajectories.values()} == {'map'}
    assert smoother.not_in_map() == {}
    for name in ('r1', 'r2'):
        # One run of poses that are correlated: within a factor of 3.
        assert 0.33 < scores[name].mean_nees() < 3.0


def test_how_often_a_map_is_solved_for_on_the_way_makes_no_difference():
    seldom, _ = given(solve_every=10_000)
    often, _ = given(solve_every=7)

    for name in ('r1', 'r2'):
        assert_allclose(
            pose_difference(final_poses(seldom, name), final_poses(often, name)), 0.0, atol=1e-9)


def test_the_anchors_pose_places_the_joint_map():
    at = (3.0, -2.0, 2.0)
    here, _ = given()
    there, _ = given(settings=team(anchor_pose=at))

    assert_allclose(final_poses(there, 'r1')[0], at, atol=1e-12)
    for name in ('r1', 'r2'):
        moved = turn(at[2]) @ final_poses(here, name)[:, :2].T + np.array([at[:2]]).T
        assert_allclose(final_poses(there, name)[:, :2], moved.T, atol=1e-7)
    here_P, there_P = (
        [estimate.P for estimate in smoother.trajectories['r2'].estimates()][-1]
        for smoother in (here, there))
    assert_allclose(
        there_P[:2, :2], turn(at[2]) @ here_P[:2, :2] @ turn(at[2]).T, rtol=1e-6, atol=1e-9)


def test_a_joint_map_without_the_anchor_is_in_the_frame_of_its_first_robot():
    smoother, _ = given(settings=team('r0', 'r2', 'r1', anchor='r0'))

    assert {name: way.frame for name, way in smoother.trajectories.items()} == {
        'r1': 'r2/map', 'r2': 'r2/map'}
    assert smoother.not_in_map() == {
        'r0': 'it sent no odometry',
        **dict.fromkeys(['r1', 'r2'], 'r2 and r1 have no rendezvous with a robot in map')}


def test_numbers_of_each_robots_own_join_nobody():
    smoother, _ = given(settings=team(shared_landmark_ids=False))

    assert {name: way.frame for name, way in smoother.trajectories.items()} == {
        'r1': 'r1/map', 'r2': 'r2/map'}
    assert set(smoother.not_in_map().values()) == {'it has no rendezvous with another robot'}


def exact(ms, twist_covariance):
    return odometry('r1', ms, twist_covariance=np.diag(twist_covariance).astype(float))


def test_odometry_that_claims_to_be_exact_is_refused_and_bridged():
    before = [odometry('r1', 0), scan('r1', 0, [(1, (2.0, 1.0))])]
    after = [odometry('r1', 200), scan('r1', 200, [(1, (1.81, 1.0))]), odometry('r2', 0)]
    spoilt, _ = given([*before, exact(100, [0.1, 0.0, 0.1]), *after])
    without, _ = given([*before, *after])

    assert spoilt.statistics.rejection_counts['r1'] == {RejectionReason.BAD_COVARIANCE: 1}
    assert spoilt.state_hash() == without.state_hash()
    assert spoilt.used('r1') == without.used('r1')


def test_what_came_since_a_solution_moves_with_it_and_is_less_certain():
    smoother, _ = given(solved=False)
    half = len(RECORDS) // 2
    live = TeamSmoother(team(), solve_every=10_000)
    for record in RECORDS[:half]:
        live.add(record)
    list(live.take())
    task = live.task()
    for record in RECORDS[half:]:
        live.add(record)
    list(live.close())
    way, n = live.trajectories['r2'], len(task.maps[1].values.poses)
    relative = between(way.poses()[n - 1], way.poses()[-1])

    live.adopt(solve(task))

    assert way.frame == 'map'
    assert_allclose(between(way.poses()[n - 1], way.poses()[-1]), relative, atol=1e-12)
    *_, told = way.estimates()
    assert np.array_equal(told.P, way.newest().P)
    live.adopt(solve(live.task()))
    *_, final = way.estimates()
    # An upper bound: to be better than by odometry alone an observation is enough.
    assert np.linalg.eigvalsh(told.P - final.P)[0] > 0.0
    smoother.adopt(solve(smoother.task()))
    assert_allclose(
        pose_difference(final_poses(live, 'r2'), final_poses(smoother, 'r2')), 0.0, atol=1e-9)


def test_every_step_tells_the_newest_pose_of_who_had_one():
    smoother, told = given([odometry('r1', 0), odometry('r1', 100), odometry('r2', 100)])

    assert [(pose.robot, pose.stamp) for pose in told] == [
        ('r1', 0), ('r1', 100 * MS), ('r2', 100 * MS)]
    assert told[1].frame == 'r1/map'
    # By default 0.05 m per sqrt(s), over 0.1 s.
    assert told[1].P[0, 0] == pytest.approx(0.05**2 * 0.1)
    assert smoother.steps == {'r1': 2, 'r2': 1}


def test_who_takes_pose_by_pose_gets_what_one_gets_who_takes_all():
    bit_by_bit = TeamSmoother(team())
    for record in RECORDS:
        bit_by_bit.add(record)
    told = list(islice(bit_by_bit.release(), 1))
    while told[-1] is not None:
        told.append(next(bit_by_bit.release(), None))

    smoother, at_once = given()

    assert [(pose.robot, pose.stamp) for pose in told[:-1]] == [
        (pose.robot, pose.stamp) for pose in at_once]
    bit_by_bit.adopt(solve(bit_by_bit.task()))
    assert bit_by_bit.state_hash() == smoother.state_hash()


def test_a_map_that_cannot_be_solved_stays_as_it_was_and_the_others_go_on(monkeypatch):
    settings = team(shared_landmark_ids=False)
    smoother, _ = given(settings=settings)
    before = final_poses(smoother, 'r2')
    task = smoother.task()
    broken = task.maps[1].problem

    def minimum_or_fail(alone, probability):
        if alone.problem is broken:
            raise ConvergenceError('no minimum')
        return without_outliers(alone, probability)

    monkeypatch.setattr(team_solution, 'without_outliers', minimum_or_fail)
    smoother.adopt(solve(task))

    assert smoother.solution.unsolved == {'r2': 'no minimum'}
    assert smoother.not_in_map()['r2'] == 'no minimum'
    assert {*smoother.solution.maps[0].trajectories} == {'r1'}
    assert {*smoother.solution.maps[1].trajectories} == {'r2'}
    assert np.array_equal(final_poses(smoother, 'r2'), before)


def test_the_hash_is_that_of_what_was_smoothed():
    first, again = given()[0], given()[0]
    noise = np.random.default_rng(1)
    other = [
        replace(r, pose=r.pose + noise.normal(0.0, 1e-9, 3)) if isinstance(r, Odometry) else r
        for r in RECORDS]

    assert first.state_hash() == again.state_hash() != given(other)[0].state_hash()


def test_nobody_can_tell_a_smoother_where_a_robot_is():
    with pytest.raises(TypeError, match='no pose priors'):
        TeamSmoother(team()).add(PosePrior('r1', 0, np.zeros(3), np.eye(3)))
