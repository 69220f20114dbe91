# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joining of maps: the minimum of eq. (21) of [Andersson], or the reason for a failure."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.csam import map_merging
from fej_slam_ros.core.csam.loop_closing import ClosedLoops
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.odometry_links import ReleasedOdometry
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.csam.shared_landmarks import SharedLandmarks
from fej_slam_ros.core.csam.slips import ExplainedLoops
from fej_slam_ros.core.gauss_newton import ConvergenceError
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS, Observation
from fej_slam_ros.core.smoothing.factors import rows_of, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from helpers.core import central_differences, turn, wrapped
from helpers.csam import in_another_frame, joined_maps, Met, true_base_node

CHAIN = [(a, a + 1, k) for a in (0, 1) for k in range(3, 8)]
LOOP = [*CHAIN, *((2, 0, k) for k in range(7, 11))]
PAIR = [(0, 1, k) for k in range(3, 8)]


def base_nodes(joint):
    return joint.base_nodes(joint.information())


def joined(team):
    """Return the single map of a team after joining."""
    (joint,), failed, *_ = joined_maps(team.maps, team.measurements)
    assert failed == []
    return joint


@pytest.mark.parametrize(('robots', 'met'), [
    (2, PAIR), (2, [(0, 1, 4), (1, 0, 4)]), (3, CHAIN), (3, LOOP)])
def test_the_joint_map_and_all_covariances_are_those_of_gtsam(robots, met):
    gtsam_reference = pytest.importorskip(
        'helpers.gtsam_reference', reason='gtsam is not installed')
    joint = joined(Met(1, met, robots))

    reference = gtsam_reference.Reference(joint.problem, joint.values)

    gtsam_reference.assert_is_minimum(joint, reference)
    for robot, base_node in base_nodes(joint).items():
        # The origin of a robot's own frame is its first pose.
        first = joint.first_poses[robot]
        assert_allclose(base_node.pose, reference.poses[first], atol=1e-8)
        expected = reference.covariance(gtsam_reference.pose_key(first))
        assert_allclose(base_node.P, expected, rtol=1e-8, atol=1e-8 * expected.max())


@pytest.mark.parametrize(('robots', 'met'), [(2, PAIR), (3, CHAIN), (3, LOOP)])
def test_exact_measurements_give_the_true_map(robots, met):
    team = Met(2, met, robots, noise=0.0)

    joint = joined(team)

    assert joint.robots == ('r1', 'r2', 'r3')[:robots]
    for robot, base_node in base_nodes(joint).items():
        assert_allclose(base_node.pose, true_base_node(team, 'r1', robot), atol=1e-7)
    # All robots observed the same six landmarks.
    assert [len(keys) for keys in joint.landmarks] == 6 * [robots]
    assert len({frozenset(id_ for _, id_ in keys) for keys in joint.landmarks}) == 6
    assert joint.chi_square < 1e-6


def test_the_frame_is_that_of_the_first_robot_if_the_other_one_observes():
    team = Met(3, [(1, 0, k) for k in range(3, 8)])

    joint = joined(team)

    assert joint.robots[0] == 'r1'
    assert_allclose(joint.values.poses[0], 0.0)


def test_a_change_of_frame_changes_the_base_node_only():
    team = Met(4, PAIR)
    frame = np.array([300.0, -200.0, 2.5])
    moved = [team.maps[0], in_another_frame(team.maps[1], frame)]

    (joint,), *_ = joined_maps(moved, team.measurements)

    expected = joined(team)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert joint.landmarks == expected.landmarks
    first = joint.values.poses[joint.first_poses['r2']]
    x, y, phi = base_nodes(joint)['r2'].pose
    # The base node transforms pose 0, which is `frame` there, into the joint map.
    c, s = np.cos(phi), np.sin(phi)
    transformed = [x + c * frame[0] - s * frame[1], y + s * frame[0] + c * frame[1]]
    assert_allclose(transformed, first[:2], atol=1e-8)
    assert wrapped(phi + frame[2] - first[2]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_map_can_be_led_by_any_of_its_robots(seed):
    joint = joined(Met(seed, CHAIN, 3))

    led = joint.led_by('r2')

    first = joint.first_poses['r2']
    assert led.robots == ('r2', 'r1', 'r3')
    assert led.chi_square == joint.chi_square
    assert_array_equal(led.values.poses[first], np.zeros(3))
    for robot, base_node in base_nodes(led).items():
        poses = [first, joint.first_poses[robot]]
        x = joint.values.poses[poses]
        H = central_differences(lambda x: between(x[:3], x[3:]), x.ravel())
        assert_allclose(base_node.pose, between(*x), atol=1e-12)
        # Pose 0 of r1, where it is one of the two, is exact in the frame of r1.
        kept, P = [pose for pose in poses if pose != joint.first_poses['r1']], np.zeros((6, 6))
        P[:3 * len(kept), :3 * len(kept)] = joint.information().joint(poses=kept)
        assert_allclose(base_node.P, H @ P @ H.T, rtol=1e-6, atol=1e-9)


def test_merged_landmarks_keep_one_key_of_each_robot():
    joint = joined(Met(5, PAIR))

    for keys in joint.landmarks:
        assert sorted(owner for owner, _ in keys) == ['r1', 'r2']


def joined_robots(team):
    """Return the robots of each map after joining, and the failures."""
    groups, failed, *_ = joined_maps(team.maps, team.measurements)
    return [group.robots for group in groups], failed


def test_robots_whose_landmarks_cannot_be_merged_are_joined_and_the_others_merge_theirs(
        monkeypatch):
    team = Met(5, [*PAIR, *((2, 3, k) for k in range(3, 9))], robots=4)
    (merged, _), *_ = joined_maps(team.maps, team.measurements)

    def does_not_converge(joint, pairs, start):
        if joint.robots[0] == 'r3':
            raise ConvergenceError('too far')
        return with_merged_landmarks(joint, pairs, start)

    with_merged_landmarks = JointMap.with_merged_landmarks
    monkeypatch.setattr(JointMap, 'with_merged_landmarks', does_not_converge)
    (first, second), failures, *_ = joined_maps(team.maps, team.measurements)

    assert_allclose(first.values.points, merged.values.points)
    assert (second.robots, len(second.landmarks)) == (('r3', 'r4'), 2 * len(first.landmarks))
    assert [(f.robots, f.reason) for f in failures] == [
        (('r3', 'r4'), 'duplicate landmarks are not merged: too far')]


def test_robots_without_rendezvous_keep_their_maps():
    team = Met(6, [])

    groups, failed, *_ = joined_maps(team.maps, [])

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert failed == []
    for group, local in zip(groups, team.maps):
        assert_allclose(group.values.poses, local.values.poses, atol=1e-8)
        assert base_nodes(group) == {}


def test_one_observation_does_not_join_maps():
    groups, failed = joined_robots(Met(7, [(0, 1, 4)]))

    assert groups == [('r1',), ('r2',)]
    assert failed == [JoinFailure(
        'not enough observations: 1 of the 2 that are needed', ('r1', 'r2'))]


def test_an_inconsistent_rendezvous_does_not_join_maps():
    team = Met(8, PAIR)
    first = team.measurements[0]
    team.measurements[0] = replace(first, z=first.z + np.array([0.6, 0.0]))

    groups, failed = joined_robots(team)

    assert groups == [('r1',), ('r2',)]
    assert failed[0].reason.startswith('inconsistent (chi-square')


def test_an_inconsistent_loop_closure_is_left_out():
    team = Met(9, LOOP, robots=3)
    wrong = [
        replace(m, z=m.z + np.array([2.0, 2.0])) if m.observer == 'r3' else m
        for m in team.measurements]

    (joint,), failed, *_ = joined_maps(team.maps, wrong)

    assert [failure.robots for failure in failed] == [('r1', 'r3')]
    assert failed[0].reason == 'inconsistent (2 of 4 observations contradict the map)'
    (without,), *_ = joined_maps(team.maps, team.measurements[:len(CHAIN)])
    assert_allclose(joint.values.poses, without.values.poses, atol=1e-8)


def test_a_single_observation_is_used_after_others_have_joined_the_robots():
    met = [*CHAIN, (2, 0, 9)]
    team = Met(10, met, robots=3)

    joint = joined(team)

    assert len(joint.problem.rendezvous.z) == len(met)


def test_shared_landmarks_join_robots_without_rendezvous():
    team = Met(11, [], shared=True)

    joint = joined(team)

    assert joint.robots == ('r1', 'r2')
    assert list(joint.landmarks) == [(('', number),) for number in range(6)]
    error = base_nodes(joint)['r2'].pose - true_base_node(team, 'r1', 'r2')
    error[2] = wrapped(error[2])
    # chi-square of 3 degrees of freedom is below 16.3 with probability 0.999.
    assert error @ np.linalg.solve(base_nodes(joint)['r2'].P, error) < 16.3


def observing(local, keys, most):
    """Return a map with at most a number of observations of each landmark, by the given keys."""
    factors = local.problem.landmarks
    rows = [
        row for target in range(len(keys)) if keys[target] is not None
        for row in np.flatnonzero(factors.target == target)[:most.get(keys[target])]]
    kept = [target for target, key in enumerate(keys) if key is not None]
    of_kept = rows_of(factors, np.array(rows))
    return replace(
        local, landmarks=tuple(('', keys[target]) for target in kept),
        values=replace(local.values, points=local.values.points[kept]),
        problem=replace(local.problem, landmarks=replace(
            of_kept, target=np.array([kept.index(target) for target in of_kept.target]))))


#: One robot observes 5 and not 6; the other 6, which it reads as 5, twice only.
RIGHT, MISREAD = [0, 1, 2, 3, 4, 5, None], [0, 1, 2, 3, 4, None, 5]


def with_misread_ids(maps, fewer):
    """Return maps of which that of one robot has fewer observations, with a misread ID."""
    return [
        observing(local, MISREAD, {5: 2}) if local.robot == fewer else observing(local, RIGHT, {})
        for local in maps]


@pytest.mark.parametrize('fewer', ['r1', 'r2'])
def test_a_landmark_from_misread_ids_only_is_left_out_of_the_map_with_fewer_observations(fewer):
    team = Met(13, [], landmarks=7, shared=True)
    maps = with_misread_ids(team.maps, fewer)

    (joint,), failed, outliers, *_ = joined_maps(maps, [])

    assert failed == []
    assert [o.landmark for o in outliers[fewer]] == [('', 5)] * 2
    assert [o.pose for o in outliers[fewer]] == [0, 1]
    assert sum(map(len, outliers.values())) == 2
    (expected,), *_ = joined_maps([
        observing(local, [*RIGHT[:5], None, None] if local.robot == fewer else RIGHT, {})
        for local in team.maps], [])
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert joint.landmark_index().keys() == expected.landmark_index().keys()


def test_an_attempt_to_explain_a_rendezvous_by_slip_leaves_no_landmark_observations_out(
        monkeypatch):
    team = Met(13, [(0, 1, k) for k in range(10)], landmarks=7, steps=10, shared=True)
    contradicting, slips = SharedLandmarks.contradicting, []

    def contradicting_later(shared, rules):
        return contradicting(shared, rules) if slips else {}

    def slip_of_another_robot(joint, *_):
        if slips:
            return None
        slips.append(ReleasedOdometry('other', (), 0))
        return ExplainedLoops(ClosedLoops(replace(joint)), *slips)

    # As if a slip of another robot had been found between the first attempt and the second.
    monkeypatch.setattr(SharedLandmarks, 'contradicting', contradicting_later)
    monkeypatch.setattr(map_merging, 'explained_loops', slip_of_another_robot)
    (joint,), failed, outliers, *_ = joined_maps(
        with_misread_ids(team.maps, 'r2'), team.measurements)

    assert (joint.robots, failed) == (('r1', 'r2'), [])
    assert [o.pose for o in outliers['r2']] == [0, 1]


def test_maps_are_joined_by_their_landmarks_once_however_often_the_robots_meet(monkeypatch):
    # Ten robot-to-robot observations in ten rendezvous, more than a minute apart.
    team = Met(13, [(0, 1, k) for k in range(10)], landmarks=7, steps=10, shared=True)
    apart = [replace(m, stamp=100 * NS * k) for k, m in enumerate(team.measurements)]
    compared = []
    monkeypatch.setattr(
        SharedLandmarks, 'contradicting', lambda shared, _: compared.append(shared) or {})

    groups, failed, *_ = joined_maps(with_misread_ids(team.maps, 'r2'), apart)

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert (len(failed), len(compared)) == (1, 1)


def test_a_third_of_the_landmarks_cannot_be_outlying():
    team = Met(13, [], landmarks=7, shared=True)
    maps = [
        observing(team.maps[0], [0, 1, 2, 3, 4, 5, None], {}),
        observing(team.maps[1], [0, 1, 2, 3, 5, None, 4], {4: 2, 5: 2})]

    groups, failed, outliers, *_ = joined_maps(maps, [])

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert 'inconsistent' in failed[0].reason
    assert not outliers


def test_too_few_shared_landmarks_do_not_join_maps():
    team = Met(12, [], landmarks=2, shared=True)

    groups, failed = joined_robots(team)

    assert groups == [('r1',), ('r2',)]
    assert failed[0].reason == '2 shared landmarks, 3 are needed'


def test_a_rendezvous_joins_maps_whose_shared_landmarks_do_not_determine_the_heading():
    heap = np.array([[2.0, 1.0], [2.01, 1.0], [2.0, 1.01]])
    starts, maps, trajectories = {'r1': np.zeros(3), 'r2': np.array([1.0, -1.0, 0.5])}, [], {}
    for name, start in starts.items():
        trajectories[name] = start + np.outer(np.arange(8), [0.3, 0.1, 0.1])
        scans = [
            [Observation(i, turn(x[2]).T @ (point - x[:2]), 0.01 * np.eye(2))
             for i, point in enumerate(heap)] for x in trajectories[name]]
        smoother = IncrementalSmoother(scans[0])
        for a, b, scan in zip(trajectories[name], trajectories[name][1:], scans[1:]):
            u = np.array([*(turn(a[2]).T @ (b - a)[:2]), b[2] - a[2]])
            smoother.add(u, 1e-4 * np.eye(3), scan)
        maps.append(LocalMap(
            name, smoother.problem(), smoother.values(), (('', 0), ('', 1), ('', 2))))
    measurements = [
        RendezvousMeasurement(
            'r1', k, 'r2', k, turn(x[2]).T @ (y - x)[:2], 1e-4 * np.eye(2), k * NS)
        for k, (x, y) in enumerate(zip(*trajectories.values()))]

    (_, by_landmarks), (by_rendezvous,) = (
        joined_maps(maps, some)[0] for some in ([], measurements))

    assert by_landmarks.robots == ('r2',)
    assert_allclose(base_nodes(by_rendezvous)['r2'].pose, starts['r2'], atol=1e-8)
    assert len(by_rendezvous.landmarks) == 3


def test_a_second_rendezvous_closes_a_loop():
    first = [(0, 1, k) for k in range(3, 8)]
    met = [*first, *((0, 1, k) for k in range(40, 45))]
    team = Met(13, met, steps=50)

    joint = joined(team)

    assert len(joint.problem.rendezvous.z) == len(met)
    (once,), *_ = joined_maps(team.maps, team.measurements[:len(first)])
    assert base_nodes(joint)['r2'].P[2, 2] < base_nodes(once)['r2'].P[2, 2]


def test_an_inconsistent_second_rendezvous_is_left_out():
    met = [(0, 1, k) for k in (*range(3, 8), *range(40, 45))]
    team = Met(14, met, steps=50)
    wrong = [
        replace(m, z=m.z + np.array([1.0, 0.0])) if m.pose == 41 else m
        for m in team.measurements]

    (joint,), failed, *_ = joined_maps(team.maps, wrong)

    assert len(joint.problem.rendezvous.z) == 5
    assert [failure.robots for failure in failed] == [('r1', 'r2')]


def test_sessions_with_too_few_observations_are_pooled():
    met = [(0, 1, 3), (0, 1, 28)]

    assert len(joined(Met(15, met, steps=30)).problem.rendezvous.z) == 2


# The first rendezvous joins the maps, a second one closes a loop.
@pytest.mark.parametrize('wrong', [[7], [0, 30], [55], [42, 60]])
def test_a_few_outliers_of_a_long_rendezvous_are_left_out_and_reported(wrong):
    met = [(0, 1, k) for k in (*range(3, 43), *range(80, 120))]
    team = Met(20, met, steps=120)
    measurements = [
        replace(m, z=m.z + np.array([0.0, 1.5])) if k in wrong else m
        for k, m in enumerate(team.measurements)]

    (joint,), notes, *_ = joined_maps(team.maps, measurements)

    assert notes == [JoinFailure(
        f'{len(wrong)} of 40 observations contradict the rest', ('r1', 'r2'))]
    correct = [m for k, m in enumerate(team.measurements) if k not in wrong]
    (expected,), *_ = joined_maps(team.maps, correct)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)


def test_outliers_among_few_observations_cannot_be_identified():
    team = Met(21, PAIR)
    first, *others = team.measurements
    measurements = [replace(first, z=first.z + 1.0), *others]

    groups, failed, *_ = joined_maps(team.maps, measurements)

    assert len(groups) == 2
    assert len(failed) == 1


def scaled(local, scale):
    """Return the map of a robot that measures all lengths too long or too short."""
    problem, values, factor = local.problem, local.values, np.array([scale, scale, 1.0])
    return replace(
        local, values=Values(values.poses * factor, values.points * scale), problem=replace(
            problem, odometry=replace(problem.odometry, z=problem.odometry.z * factor),
            landmarks=replace(problem.landmarks, z=problem.landmarks.z * scale)))


@pytest.mark.parametrize('scale', [0.94, 1.06])
def test_maps_that_differ_in_nothing_but_a_small_scale_are_joined(scale):
    team = Met(22, [], landmarks=12, shared=True)
    p, q = team.maps

    result = joined_maps([p, scaled(q, scale)], [])
    (joint,), (join,) = result.maps, result.scaled

    assert result.failures == []
    assert (join.robots, join.others) == (('r1',), ('r2',))
    # The noise of 12 landmarks.
    assert join.scale == pytest.approx(1.0 / scale, abs=0.01)
    # The heading that a map of another scale has.
    expected = true_base_node(team, 'r1', 'r2')
    assert wrapped(base_nodes(joint)['r2'].pose[2] - expected[2]) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize('scale', [0.8, 1.2])
def test_maps_of_very_different_scales_are_not_joined(scale):
    team = Met(22, [], landmarks=12, shared=True)
    p, q = team.maps

    groups, failed, *_, joins = joined_maps([p, scaled(q, scale)], [])

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert 'inconsistent' in failed[0].reason
    assert joins == []


@pytest.mark.parametrize('seed', range(5))
def test_maps_whose_ids_are_all_wrong_are_not_joined_in_any_scale(seed):
    team = Met(seed, [], landmarks=5, shared=True)
    p, q = team.maps

    groups, *_ = joined_maps([p, replace(q, landmarks=(*q.landmarks[1:], q.landmarks[0]))], [])

    assert len(groups) == 2


def displaced(local, rows, by):
    """Return a map in which some landmarks were elsewhere all the time, (l, 2) further."""
    problem, values = local.problem, local.values
    points, z = values.points.copy(), problem.landmarks.z.copy()
    points[rows] += by
    for k, (pose, target) in enumerate(zip(problem.landmarks.pose, problem.landmarks.target)):
        moved = points[target] - values.points[target]
        z[k] += turn(values.poses[pose, 2]).T @ moved
    return replace(
        local, values=replace(values, points=points),
        problem=replace(problem, landmarks=replace(problem.landmarks, z=z)))


def test_two_in_five_landmarks_that_contradict_all_others_are_left_out():
    team = Met(23, [], landmarks=18, shared=True)
    p, q = team.maps
    people = np.random.default_rng(1).uniform(-5.0, 5.0, (7, 2))

    (joint,), failed, outliers, *_ = joined_maps([p, displaced(q, range(11, 18), people)], [])

    assert failed == []
    left_out = {o.landmark for of_robot in outliers.values() for o in of_robot}
    assert left_out == set(q.landmarks[11:18])
    error = base_nodes(joint)['r2'].pose - true_base_node(team, 'r1', 'r2')
    error[2] = wrapped(error[2])
    # chi-square of 3 degrees of freedom is below 16.3 with probability 0.999.
    assert error @ np.linalg.solve(base_nodes(joint)['r2'].P, error) < 16.3


def test_maps_are_not_joined_if_two_in_five_landmarks_agree_on_another_place():
    team = Met(23, [], landmarks=18, shared=True)
    p, q = team.maps

    groups, failed, outliers, *_ = joined_maps(
        [p, displaced(q, range(11, 18), np.array([2.0, 1.0]))], [])

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert 'inconsistent' in failed[0].reason
    assert not outliers


@pytest.mark.parametrize(('squeeze', 'cure'), [
    (0.06, True), (0.5, False)])
def test_a_small_contradiction_all_over_the_map_names_the_parameter_that_joins(squeeze, cure):
    team = Met(24, [], landmarks=12, shared=True)
    p, q = team.maps
    by = q.values.points * [squeeze, -squeeze]

    groups, (failure,), *_ = joined_maps([p, displaced(q, range(12), by)], [])

    assert len(groups) == 2
    assert ('join_probability 1.0' in failure.reason) == cure
