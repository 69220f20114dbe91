# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""After an unknown motion a robot is in a new frame, until its landmarks locate it."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.records import (
    NS, Odometry, PosePrior, Scan, TruePose, UNKNOWN_POSE_COVARIANCE)
from fej_slam_ros.core.rejections import RejectionReason
from helpers.core import circles, pose_difference
from helpers.csam import smoothed
from helpers.records import MS, odometry, robot_scan, scan, team

RECORDS = circles(seed=1, landmarks=30, loops=3)
END = max(r.stamp for r in RECORDS if isinstance(r, Odometry))
#: In the second of three loops.
HALF = END * 5 // 12
#: The map of r2, which meets this robot's, is not to help.
ALONE = [r for r in RECORDS if getattr(r, 'robot', '') == 'r1']


def jumping(records, since=HALF, jump=(400.0, -300.0, 2.0)):
    """Return records in which the odometry of r1 begins again elsewhere."""
    return [
        replace(r, pose=compose(np.array(jump), r.pose))
        if isinstance(r, Odometry) and r.robot == 'r1' and r.stamp > since else r for r in records]


def blind(records, begin, end):
    """Return records without the scans of r1 in a time."""
    return [
        r for r in records
        if not (isinstance(r, Scan) and r.robot == 'r1' and begin < r.stamp <= end)]


@pytest.mark.parametrize('jumps', [1, 2])
def test_observations_of_poses_that_are_in_no_map_count_as_rejected(jumps):
    records = ALONE
    for k in range(jumps):
        records = jumping(records, HALF + k * END // 6)
    # No landmark is observed again, until the last jump of two is far behind.
    records = [
        replace(r, observations=tuple(replace(o, id=o.id + 1000) for o in r.observations))
        if isinstance(r, Scan) and HALF < r.stamp <= HALF + END // 6 else r for r in records]
    if jumps == 1:
        records = [r for r in records if r.stamp <= HALF + END // 6]

    smoother, _ = smoothed(records, team('r1'))
    smoother.count_outliers()

    local, = smoother.task().maps
    lost = sum(len(r.observations) for r in records if isinstance(r, Scan) and (
        HALF < r.stamp <= HALF + END // 6))
    assert smoother.statistics.rejection_counts['r1'][RejectionReason.LOST_ROBOT] == lost > 50
    assert smoother.statistics.observations_used['r1'] == len(local.problem.landmarks.z)


@pytest.mark.parametrize('records', [ALONE, RECORDS], ids=['alone', 'team'])
@pytest.mark.parametrize('distance', [0.0, 2.0])
def test_after_a_jump_all_poses_are_where_they_are_without_it(records, distance):
    settings = replace(team(), keyframe_distance=distance)
    sound, _ = smoothed(records, settings)

    smoother, poses = smoothed(jumping(records), settings)

    assert smoother.statistics.relocalized == {'r1': 1}
    expected = {estimate.stamp: estimate for estimate in sound.trajectories['r1'].estimates()}
    own = [
        estimate for estimate in smoother.trajectories['r1'].estimates()
        if estimate.stamp in expected]
    assert len(own) >= 0.9 * len(expected)
    assert own[-1].stamp > HALF + 0.9 * (END - HALF)
    assert {estimate.frame for estimate in own} == {sound.trajectories['r1'].frame}
    differences = np.array([
        pose_difference(estimate.pose, expected[estimate.stamp].pose) for estimate in own])
    sigmas = np.sqrt([np.diag(expected[estimate.stamp].P) for estimate in own]) + 1e-9
    # One increment of hundreds is missing, and with keyframes others are chosen.
    assert np.sqrt(np.mean(np.square(differences / sigmas))) < (0.5 if distance == 0.0 else 1.0)
    assert np.abs(poses[-1].P).max() < 1.0


def test_until_it_observes_its_landmarks_again_a_lost_robot_is_in_its_own_frame():
    until = HALF + (END - HALF) // 4
    at = next(r.stamp for r in RECORDS if isinstance(r, Odometry) and r.stamp > HALF + NS)
    sightings = [replace(robot_scan('r2', 0, [('r1', (1.0, 1.0))]), stamp=at)]
    records = sorted(
        [*blind(jumping(RECORDS), HALF, until), *sightings], key=lambda r: getattr(r, 'stamp', 0))
    smoother = TeamSmoother(team())
    frames = set()
    for record in records:
        smoother.add(record)
        frames |= {
            pose.frame for pose in smoother.take() if pose.robot == 'r1' and pose.stamp > HALF}
        if getattr(record, 'stamp', 0) > until - NS:
            break
    smoother.adopt(solve(smoother.task()))

    trajectory = smoother.trajectories['r1']
    assert trajectory.is_lost
    assert trajectory.frame == 'map'
    assert trajectory.newest().frame == 'r1/map'
    assert trajectory.stamps[-1] <= HALF
    assert smoother.not_in_map() == {
        'r1': 'it is lost: 0 of the landmarks of its map are observed again, needs 3 that fit'}
    assert smoother.statistics.total(RejectionReason.LOST_ROBOT) == 1
    assert smoother.task().measurements == ()


def test_a_robot_that_returns_to_the_team_is_found_by_its_landmarks():
    settings = team()
    smoother = TeamSmoother(settings)
    leaves, returns = HALF, HALF + (END - HALF) // 2
    for record in jumping(RECORDS, returns):
        stamp = getattr(record, 'stamp', 0)
        names = ['r2'] if leaves < stamp <= returns else ['r1', 'r2']
        if [*smoother.robots] != names:
            smoother.change_team([robot for robot in settings.robots if robot.name in names])
        if getattr(record, 'robot', 'r2') in names:
            smoother.add(record)
            list(smoother.take())
    list(smoother.close())
    smoother.adopt(solve(smoother.task()))

    true = {r.stamp: r.pose for r in RECORDS if isinstance(r, TruePose) and r.robot == 'r1'}
    later = [
        estimate for estimate in smoother.trajectories['r1'].estimates()
        if estimate.stamp > returns]
    errors = np.array([pose_difference(estimate.pose, true[estimate.stamp]) for estimate in later])
    nees = [e @ np.linalg.solve(estimate.P, e) / 3.0 for e, estimate in zip(errors, later)]
    assert len(later) > 10
    # Poses of one run are correlated: within a factor of 3.
    assert 0.33 < np.mean(nees) < 3.0
    assert smoother.statistics.restart_reasons == {'r1': 'it has returned to the team'}


def test_a_robot_that_is_lost_again_loses_the_poses_in_between():
    until = HALF + (END - HALF) // 2
    twice = blind(jumping(jumping(ALONE), until - NS, (-90.0, 20.0, 1.0)), HALF, until)

    smoother, _ = smoothed(twice)

    stamps = smoother.trajectories['r1'].stamps
    assert not smoother.trajectories['r1'].is_lost
    assert not [t for t in stamps if HALF + NS < t < until - NS]
    assert stamps[-1] == END


def test_a_robot_as_fast_as_its_limit_is_not_lost():
    step = jumping(ALONE, jump=(1.0, 0.0, 0.0))
    robots = [replace(team().robots[0], max_speed=limit) for limit in (1e-3, 1e3)]

    slow, fast = (smoothed(step, replace(team(), robots=(robot,)))[0] for robot in robots)

    assert slow.statistics.relocalized['r1'] > 0
    assert fast.statistics.relocalized['r1'] == 0


def given(stamp, pose, sigma=0.1):
    return PosePrior('r1', stamp, np.array(pose), sigma ** 2 * np.eye(3))


def true_pose(stamp):
    return next(
        r.pose for r in RECORDS
        if isinstance(r, TruePose) and (r.robot, r.stamp) == ('r1', stamp))


def smoothed_with(records, *priors):
    """Return a smoother that adopts a solution before some pose priors, and poses since."""
    smoother, poses, is_given = TeamSmoother(team()), [], False
    for record in records:
        if getattr(record, 'stamp', 0) > HALF and not is_given:
            is_given = True
            list(smoother.release())
            smoother.adopt(solve(smoother.task()))
            for prior in priors:
                smoother.add(prior)
            poses.clear()
        smoother.add(record)
        poses += smoother.take()
    poses += smoother.close()
    smoother.adopt(solve(smoother.task()))
    return smoother, [pose for pose in poses if pose.robot == 'r1']


def test_a_given_pose_places_a_robot_that_observes_nothing():
    at = next(r.stamp for r in RECORDS if isinstance(r, Odometry) and r.stamp > HALF + NS)
    records = blind(jumping(RECORDS), HALF - NS, END)

    smoother, poses = smoothed_with(records, given(at, true_pose(at)))

    (placed,) = [pose for pose in poses if pose.stamp == at]
    assert placed.frame == 'map'
    assert_allclose(placed.pose, true_pose(at), atol=1e-9)
    final = {estimate.stamp: estimate for estimate in smoother.trajectories['r1'].estimates()}
    # Its variance is that of the message and at most twice that of the last pose before.
    before = final[max(t for t in final if t < HALF)].P
    assert np.all(np.diag(final[at].P) >= 0.99 * 0.01)
    assert np.all(np.diag(final[at].P) <= 0.01 + 10.0 * np.trace(before) + 1e-9)
    # It moves with that pose when later measurements correct it.
    error = pose_difference(final[at].pose, true_pose(at))
    assert error @ np.linalg.solve(final[at].P, error) < 16.0
    assert smoother.statistics.pose_priors_used == {'r1': 1}


def test_a_robot_of_which_nothing_is_known_is_found_by_its_landmarks():
    at = HALF + NS
    smoother, poses = smoothed_with(
        RECORDS, PosePrior('r1', at, np.zeros(3), UNKNOWN_POSE_COVARIANCE))

    assert smoother.statistics.restart_reasons == {'r1': 'its pose is not known'}
    # By the scan of that step, which observes three landmarks.
    assert {pose.frame for pose in poses} == {'map'}
    sound, _ = smoothed(RECORDS)
    ends = [[*run.trajectories['r1'].estimates()][-1] for run in (smoother, sound)]
    assert ends[0].stamp == ends[1].stamp
    sigma = np.sqrt(np.diag(ends[1].P))
    assert np.abs(pose_difference(ends[0].pose, ends[1].pose) / sigma).max() < 1.0


def test_a_pose_in_map_of_a_robot_that_has_not_joined_is_rejected():
    smoother, _ = smoothed([*ALONE[:20], given(ALONE[20].stamp, (0.0, 0.0, 0.0)), *ALONE[20:]])

    assert smoother.statistics.total(RejectionReason.NOT_JOINED) == 1
    assert smoother.statistics.relocalized.total() == 0


def blind_until(records, since):
    """Return records in which r1 observes nothing, nor is observed, up to a time."""
    return [
        r for r in records if r.stamp > since or not (isinstance(r, Scan) and r.robot == 'r1')]


def test_a_robot_that_is_lost_before_it_has_mapped_anything_starts_over():
    """Its first message is from before its driver knew the pose."""
    first, *later = (r for r in RECORDS if isinstance(r, Odometry) and r.robot == 'r1')
    records = jumping(blind_until(RECORDS, first.stamp), first.stamp)
    expected, _ = smoothed([r for r in records if r is not first], team())

    smoother, _ = smoothed(records, team())

    assert smoother.statistics.relocalized['r1'] == 1
    assert smoother.not_in_map() == {}
    assert smoother.trajectories['r1'].stamps == [r.stamp for r in later]
    assert_allclose(
        smoother.trajectories['r1'].poses(), expected.trajectories['r1'].poses(), atol=1e-9)


def test_few_landmarks_from_before_a_robot_was_lost_are_left_out_and_counted():
    early = min(r.stamp for r in RECORDS if isinstance(r, Scan) and r.robot == 'r1')
    pair = scan('r1', early // MS, [(901, (3.0, 1.0)), (902, (3.0, -1.0))])
    records = [pair, *jumping(blind_until(ALONE, early + 2 * NS), early + NS)]

    smoother, _ = smoothed(sorted(records, key=lambda r: r.stamp), team('r1'))

    assert smoother.statistics.rejection_counts['r1'][RejectionReason.LOST_ROBOT] == 2
    assert {id_ for _, id_ in smoother.trajectories['r1'].landmark_keys('')}.isdisjoint({901, 902})


def test_a_solution_from_before_a_robot_started_over_changes_nothing_of_it():
    smoother = TeamSmoother(team('r1'))
    for ms in range(0, 500, 100):
        smoother.add(odometry('r1', ms))
    list(smoother.take())
    before = smoother.task()
    for ms in range(500, 1000, 100):
        smoother.add(odometry('r1', ms, (100.0 + ms / 1000.0, 0.0, 0.0)))
    list(smoother.close())

    smoother.adopt(solve(before))

    assert smoother.solution.maps == ()
    assert smoother.trajectories['r1'].stamps == [ms * MS for ms in range(500, 1000, 100)]
    smoother.adopt(solve(smoother.task()))
    assert len(smoother.trajectories['r1'].poses()) == 5


def test_an_anchor_whose_given_pose_no_longer_holds_does_not_start_over():
    smoother = TeamSmoother(team('r1', 'r2', anchor_pose=(3.0, 2.0, 1.0)))
    for ms in range(0, 500, 100):
        for name in ('r1', 'r2'):
            smoother.add(odometry(name, ms, (100.0 * (ms >= 300), 0.0, 0.0)))
    list(smoother.close())

    assert smoother.trajectories['r1'].is_lost
    assert smoother.not_in_map()['r1'].startswith('it is lost: its map has 0 landmarks, needs 3')
    assert not smoother.trajectories['r2'].is_lost
