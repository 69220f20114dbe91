# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The smoother of a team: the minimum of all measurements, in the correct frame."""

from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.csam import team_solution
from fej_slam_ros.core.csam.own_slips import own_map
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solution_hash, solve, TeamMap
from fej_slam_ros.core.gauss_newton import ConvergenceError
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.records import Odometry, PosePrior, TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.factors import Values
from helpers.core import circles, pose_difference, turn
from helpers.csam import smoothed
from helpers.records import MS, odometry, robot_scan, scan, team

#: Robots with shared landmark IDs; the stated covariances are the true ones.
RECORDS = circles(seed=1)


def final_poses(smoother, robot):
    return np.array([estimate.pose for estimate in smoother.trajectories[robot].estimates()])


def true_poses(robot):
    return np.array([r.pose for r in RECORDS if isinstance(r, TruePose) and r.robot == robot])


@pytest.mark.parametrize('record', [
    PosePrior('r9', 0, np.zeros(3), np.eye(3)), TruePose('r9', 0, np.zeros(3))])
def test_poses_of_a_robot_that_is_not_in_the_team_are_rejected(record):
    smoother = TeamSmoother(team())

    assert smoother.add(record) is RejectionReason.UNKNOWN_ROBOT

    assert smoother.statistics.rejection_counts['r9'] == {RejectionReason.UNKNOWN_ROBOT: 1}


def test_a_single_robot_ends_at_the_minimum_of_its_measurements():
    smoother, _ = smoothed([r for r in RECORDS if getattr(r, 'robot', 'r1') == 'r1'])
    local = smoother.task().maps[0]
    truth = next(r for r in RECORDS if isinstance(r, TrueLandmarks)).positions
    true = true_poses('r1')
    observed = np.array([truth[id_] for _, id_ in local.landmarks])
    points = (observed - true[0, :2]) @ turn(true[0, 2])

    batch = least_squares.solve(
        local.problem, Values(np.array([between(true[0], x) for x in true]), points)).values

    # The iteration ends at an increment below 1e-9.
    assert_allclose(
        pose_difference(final_poses(smoother, 'r1'), batch.poses), 0.0, atol=1e-8)
    assert smoother.trajectories['r1'].frame == 'r1/map'


def test_robots_with_shared_ids_end_in_map_and_are_consistent():
    smoother, _ = smoothed(RECORDS)

    scores = smoother.scores()

    assert {x.frame for x in smoother.trajectories.values()} == {'map'}
    assert smoother.not_in_map() == {}
    for name in ('r1', 'r2'):
        nees = [
            e @ np.linalg.solve(estimate.P, e) / 3
            for estimate, true in zip(smoother.trajectories[name].estimates(), true_poses(name))
            for e in [pose_difference(estimate.pose, true)] if estimate.P.any()]
        assert scores[name].mean_nees_per_dof() == pytest.approx(np.mean(nees))
        # Poses of one run are correlated: within a factor of 3.
        assert 0.33 < np.mean(nees) < 3.0


def test_the_result_does_not_depend_on_intermediate_solutions():
    seldom, _ = smoothed(RECORDS, solve_every=10_000)
    often, _ = smoothed(RECORDS, solve_every=7)

    for name in ('r1', 'r2'):
        assert_allclose(
            pose_difference(final_poses(seldom, name), final_poses(often, name)), 0.0, atol=1e-9)


def test_the_anchor_pose_transforms_the_joint_map():
    at = (3.0, -2.0, 2.0)
    reference, _ = smoothed(RECORDS)
    displaced, _ = smoothed(RECORDS, team(anchor_pose=at))

    assert_allclose(final_poses(displaced, 'r1')[0], at, atol=1e-12)
    for name in ('r1', 'r2'):
        moved = turn(at[2]) @ final_poses(reference, name)[:, :2].T + np.array([at[:2]]).T
        assert_allclose(final_poses(displaced, name)[:, :2], moved.T, atol=1e-7)
    here_P, there_P = (
        [estimate.P for estimate in smoother.trajectories['r2'].estimates()][-1]
        for smoother in (reference, displaced))
    assert_allclose(
        there_P[:2, :2], turn(at[2]) @ here_P[:2, :2] @ turn(at[2]).T, rtol=1e-6, atol=1e-9)


def test_an_uncertain_anchor_pose_adds_its_effect_on_all_estimates():
    at, sigma, h = np.array([3.0, -2.0, 1.2]), (0.1, 0.2, 0.05), 1e-3

    def solution(*pose, **options):
        smoother, _ = smoothed(RECORDS, team(anchor_pose=pose, **options))
        (solved,) = smoother.solution.maps
        of_robots = solved.trajectories['r1'], solved.trajectories['r2']
        (node,) = solved.base_nodes.values()
        return (
            [*(x.poses for x in of_robots), node.pose[None], solved.points],
            [*(x.P for x in of_robots), node.P[None], solved.P])

    certain, uncertain = solution(*at)[1], solution(*at, anchor_sigma=sigma)[1]

    moved = [
        [solution(*at + sign * h * axis)[0] for sign in (1.0, -1.0)] for axis in np.eye(3)]
    for k, (before, after) in enumerate(zip(certain, uncertain)):
        G = np.stack([(plus[k] - minus[k]) / (2.0 * h) for plus, minus in moved], axis=2)
        # Central differences of rotations by 1e-3 rad are off by 2e-7, solutions by 1e-9 m.
        assert_allclose(
            after - before, G @ np.diag(np.square(sigma)) @ G.transpose(0, 2, 1), atol=1e-5)


def test_a_joint_map_without_the_anchor_is_in_the_frame_of_its_first_robot():
    smoother, _ = smoothed(RECORDS, team('r0', 'r2', 'r1', anchor='r0'))

    assert {name: x.frame for name, x in smoother.trajectories.items()} == {
        'r1': 'r2/map', 'r2': 'r2/map'}
    assert smoother.not_in_map() == {
        'r0': 'it sent no odometry',
        **dict.fromkeys(['r1', 'r2'], 'r2 and r1 have no rendezvous with a robot in map')}


def test_ids_of_each_robot_do_not_join_maps():
    smoother, _ = smoothed(RECORDS, team(shared_landmark_ids=False))

    assert {name: x.frame for name, x in smoother.trajectories.items()} == {
        'r1': 'r1/map', 'r2': 'r2/map'}
    assert set(smoother.not_in_map().values()) == {'it has no rendezvous with another robot'}


def test_a_robot_that_observed_nothing_has_not_missed_a_rendezvous():
    smoother, _ = smoothed([r for r in RECORDS if isinstance(r, Odometry)])

    assert set(smoother.not_in_map().values()) == {'it has observed no landmark or robot'}


def test_a_robot_whose_odometry_is_rejected_is_told_so():
    smoother = TeamSmoother(team())
    # The first message has no increment, and so no covariance.
    for k in range(5):
        Q = np.diag([0.1, 0.0, 0.1]) if k else None
        smoother.add(odometry('r1', 100 * k, (0.1 * k, 0.0, 0.0), Q))
    list(smoother.close())

    assert smoother.not_in_map()['r1'] == 'it sent no usable odometry: 4 bad_covariance'


def met(smoother, steps, jump=0.0):
    """Add odometry of two robots at 10 Hz, the last of r1 after a jump [m], and what r1 sees."""
    for k in range(steps):
        x = 0.1 * k + jump * (k == steps - 1)
        smoother.add(odometry('r1', 100 * k, (x, 0.0, 0.0)))
        smoother.add(odometry('r2', 100 * k, (0.1 * k, 0.0, 0.0)))
        smoother.add(robot_scan('r1', 100 * k, [('r2', (0.0, 1.0))]))


def test_observations_of_robots_count_as_used():
    smoother = TeamSmoother(team())
    met(smoother, 10)
    list(smoother.close())

    assert smoother.statistics.observations_used == {'r1': 10, 'r2': 0}


def test_a_robot_may_leave_between_the_poses_of_a_step_in_which_it_was_observed():
    smoother = TeamSmoother(team(max_delay=0.0))
    met(smoother, 10, jump=500.0)
    poses = smoother.release()
    # All but the last pose of the last step.
    list(islice(poses, 19))
    smoother.change_team(team('r1').robots)

    list(smoother.release())

    # The jump, and the observation after it.
    assert smoother.statistics.rejection_counts['r1'] == {
        RejectionReason.IMPOSSIBLE_MOTION: 1, RejectionReason.LOST_ROBOT: 1}


def exact(ms, twist_covariance):
    return odometry('r1', ms, twist_covariance=np.diag(twist_covariance).astype(float))


@pytest.mark.parametrize('variances', [
    (0.1, 0.0, 0.1), (1e-300, 1e-300, 1e-300), (1e-12, 1e12, 0.1)])
def test_exact_odometry_is_rejected_and_bridged(variances):
    before = [odometry('r1', 0), scan('r1', 0, [(1, (2.0, 1.0))])]
    after = [odometry('r1', 200), scan('r1', 200, [(1, (1.81, 1.0))]), odometry('r2', 0)]
    with_exact, _ = smoothed([*before, exact(100, variances), *after])
    without, _ = smoothed([*before, *after])

    assert with_exact.statistics.rejection_counts['r1'] == {RejectionReason.BAD_COVARIANCE: 1}
    assert with_exact.state_hash() == without.state_hash()
    assert with_exact.used('r1') == without.used('r1')


def test_poses_after_a_solution_follow_from_it_by_all_measurements():
    smoother, _ = smoothed(RECORDS, solved=False)
    half = len(RECORDS) // 2
    live = TeamSmoother(team(), solve_every=10_000)
    for record in RECORDS[:half]:
        live.add(record)
    list(live.take())
    task = live.task()
    for record in RECORDS[half:]:
        live.add(record)
    list(live.close())
    trajectory = live.trajectories['r2']

    live.adopt(solve(task))

    assert trajectory.frame == 'map'
    *_, newest = trajectory.estimates()
    assert np.array_equal(newest.P, trajectory.newest().P)
    live.adopt(solve(live.task()))
    *_, final = trajectory.estimates()
    # Only what the other robot has measured since then is missing.
    assert nees_per_dof(newest.pose - final.pose, newest.P) < 1.0
    assert np.linalg.det(final.P) < np.linalg.det(newest.P) < 4.0 * np.linalg.det(final.P)
    smoother.adopt(solve(smoother.task()))
    assert_allclose(
        pose_difference(final_poses(live, 'r2'), final_poses(smoother, 'r2')), 0.0, atol=1e-9)


@pytest.mark.parametrize('sigma', [(0.0, 0.0, 0.0), (0.1, 0.2, 0.05)])
def test_the_filter_continues_with_the_covariances_of_the_solution(sigma):
    """Those of single variables are computed in another way, by Takahashi's recursion."""
    smoother, _ = smoothed(RECORDS, team(anchor_pose=(3.0, -2.0, 1.2), anchor_sigma=sigma))

    for solved in smoother.solution.maps:
        assert {*solved.trajectories} == {'r1', 'r2'}
        for name, trajectory in solved.trajectories.items():
            near, newest = trajectory.near, smoother.trajectories[name].newest()
            assert_allclose(newest.P, trajectory.P[-1], rtol=1e-9, atol=1e-15)
            for k, landmark in enumerate(trajectory.landmarks[near.landmarks]):
                rows = slice(3 + 2 * k, 5 + 2 * k)
                assert_allclose(near.P[rows, rows], solved.P[landmark], rtol=1e-9, atol=1e-15)


def test_a_local_map_is_in_the_own_frame_of_its_robot_also_after_a_solution():
    smoother, _ = smoothed(RECORDS, team(anchor_pose=(3.0, -2.0, 1.2)))

    maps = smoother.task().maps

    assert len(maps) == 2
    for local in maps:
        poses = smoother.trajectories[local.robot].poses()
        assert_allclose(local.values.poses[0], 0.0, atol=1e-12)
        assert_allclose(
            pose_difference(local.values.poses[-1], between(poses[0], poses[-1])), 0.0,
            atol=1e-12)


def test_every_step_yields_the_newest_pose_of_its_robots():
    smoother, poses = smoothed([odometry('r1', 0), odometry('r1', 100), odometry('r2', 100)])

    assert [(pose.robot, pose.stamp) for pose in poses] == [
        ('r1', 0), ('r1', 100 * MS), ('r2', 100 * MS)]
    assert poses[1].frame == 'r1/map'
    # By default 0.05 m per sqrt(s), over 0.1 s.
    assert poses[1].P[0, 0] == pytest.approx(0.05**2 * 0.1)
    assert smoother.steps == {'r1': 2, 'r2': 1}


def test_poses_taken_one_by_one_equal_those_taken_at_once():
    one_by_one = TeamSmoother(team())
    for record in RECORDS:
        one_by_one.add(record)
    poses = list(islice(one_by_one.release(), 1))
    while poses[-1] is not None:
        poses.append(next(one_by_one.release(), None))

    smoother, at_once = smoothed(RECORDS)

    assert [(pose.robot, pose.stamp) for pose in poses[:-1]] == [
        (pose.robot, pose.stamp) for pose in at_once]
    one_by_one.adopt(solve(one_by_one.task()))
    assert one_by_one.state_hash() == smoother.state_hash()


def test_an_unsolved_map_is_kept_and_the_others_are_solved(monkeypatch):
    settings = team(shared_landmark_ids=False)
    smoother, _ = smoothed(RECORDS, settings)
    before = final_poses(smoother, 'r2')
    task = smoother.task()
    broken = task.maps[1].problem

    def minimum_or_fail(own, *rules):
        if own.problem is broken:
            raise ConvergenceError('no minimum')
        return own_map(own, *rules)

    monkeypatch.setattr(team_solution, 'own_map', minimum_or_fail)
    smoother.adopt(solve(task))

    assert smoother.solution.unsolved == {'r2': 'no minimum'}
    assert smoother.not_in_map()['r2'] == 'no minimum'
    assert {*smoother.solution.maps[0].trajectories} == {'r1'}
    assert {*smoother.solution.maps[1].trajectories} == {'r2'}
    assert np.array_equal(final_poses(smoother, 'r2'), before)


def test_every_part_of_a_solution_changes_the_hash():
    smoother, _ = smoothed(RECORDS)
    stamps = {name: [*smoother.trajectories[name].stamps] for name in ('r1', 'r2')}
    solved, = smoother.solution.maps
    r2 = solved.trajectories['r2']

    def with_last_bit_changed(array):
        changed = array.copy()
        changed.flat[-1] = np.nextafter(changed.flat[-1], np.inf)
        return changed

    changes = [
        {}, {'frame': 'r1/map'}, {'points': with_last_bit_changed(solved.points)},
        {'P': with_last_bit_changed(solved.P)},
        {'landmarks': ((('', 99),), *solved.landmarks[1:])},
        *({'trajectories': {**solved.trajectories, 'r2': changed}} for changed in (
            replace(r2, poses=with_last_bit_changed(r2.poses)),
            replace(r2, P=with_last_bit_changed(r2.P))))]
    hashes = {
        solution_hash(TeamMap((replace(solved, **change),)), stamps, stamps)
        for change in changes}
    stamps['r2'][-1] += 1
    hashes.add(smoother.state_hash())
    hashes.add(solution_hash(smoother.solution, stamps, stamps))

    # Those of the parts, and that of another stamp.
    assert len(hashes) == len(changes) + 1


def test_the_hash_depends_on_the_solution_only():
    first, again = smoothed(RECORDS)[0], smoothed(RECORDS)[0]
    noise = np.random.default_rng(1)
    other = [
        replace(r, pose=r.pose + noise.normal(0.0, 1e-9, 3)) if isinstance(r, Odometry) else r
        for r in RECORDS]

    assert first.state_hash() == again.state_hash() != smoothed(other)[0].state_hash()


VIEW = [(1, (5.0, 1.0)), (2, (4.0, -3.0)), (3, (-2.0, 3.0)), (4, (3.0, 4.0))]


def stand(smoother, first, views, x=0.0):
    """Let r1 and r2 stand and see views, at 10 Hz from a step on; odometry of r2 is at x."""
    for k, view in enumerate(views, start=first):
        for robot, at in (('r1', 0.0), ('r2', x)):
            smoother.add(odometry(robot, 100 * k, (at, 0.0, 0.0)))
            smoother.add(scan(robot, 100 * k, view))
    list(smoother.release())


@pytest.fixture
def in_map():
    """Return a smoother of two robots that stand in ``map`` and have seen it five times."""
    smoother = TeamSmoother(team())
    stand(smoother, 0, [VIEW] * 5)
    smoother.adopt(solve(smoother.task()))
    return smoother


def given_pose(ms):
    return PosePrior('r2', ms * MS, np.zeros(3), 0.01 * np.eye(3))


def test_a_given_pose_is_a_new_measurement(in_map):
    in_map.add(given_pose(500))
    stand(in_map, 5, [VIEW])

    assert in_map.new_measurements == 1


def test_all_poses_that_are_due_at_a_step_count_as_used(in_map):
    for ms in (460, 500):
        in_map.add(given_pose(ms))
    stand(in_map, 5, [VIEW])

    assert in_map.statistics.pose_priors_used == {'r2': 2}
    assert in_map.statistics.rejection_counts['r2'] == {}


def test_a_robot_that_is_found_by_its_landmarks_is_a_new_measurement(in_map):
    # An impossible motion, after which it sees nothing.
    stand(in_map, 5, [[]] * 2, x=400.0)
    assert in_map.trajectories['r2'].is_lost
    assert in_map.new_measurements == 0

    stand(in_map, 7, [VIEW], x=400.0)

    assert not in_map.trajectories['r2'].is_lost
    assert in_map.new_measurements == 1


def test_what_a_lost_robot_has_observed_until_its_pose_is_given_counts_as_rejected(in_map):
    stand(in_map, 5, [[(9, (1.0, 1.0))]] * 2, x=400.0)
    in_map.add(given_pose(700))
    stand(in_map, 7, [VIEW], x=400.0)
    in_map.count_outliers()

    assert in_map.statistics.rejection_counts['r2'] == {
        RejectionReason.IMPOSSIBLE_MOTION: 1, RejectionReason.LOST_ROBOT: 2}
