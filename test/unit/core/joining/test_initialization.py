# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step 0 in small scenes: robots that landmarks or known starts relate to the anchor."""

from dataclasses import replace
from math import pi

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.linalg import block_diag

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import FirstEstimates, Invariant
from fej_slam_ros.core.ekf.state import state_of_prior_map
from fej_slam_ros.core.joining.initial_alignment import align, InitialAlignment
from fej_slam_ros.core.joining.initialization import initialize
from fej_slam_ros.core.records import Observation, Odometry, PriorMap, Scan
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, estimate, pose_difference, random_covariance, turn
from helpers.records import scan

SECOND = 1_000_000_000
R = np.diag([0.01, 0.01])

#: True poses and landmarks of the scenes of this module.
POSES = {
    'r1': np.array([0.0, 0.0, 0.0]), 'r2': np.array([5.0, 1.0, 2.0]),
    'r3': np.array([-4.0, 3.0, -3.0])}
LANDMARKS = {i: np.array([2.0 + i, 3.0 - i * i]) for i in range(6)}

#: Sensors so good that all estimates are the truth to 1 mm.
NEARLY_PERFECT = SensorSettings((1e-5, 1e-5, 1e-6), (1e-5, 1e-5))


def still(robots, stamps=(0, SECOND)):
    """Return odometry of robots that do not move."""
    return [
        Odometry(name, stamp, np.zeros(3), np.diag([0.01, 0.01, 0.01]))
        for stamp in stamps for name in robots]


def look(stamp=0, **numbers):
    """Return exact scans of some landmarks by each robot."""
    return [
        Scan(name, stamp, tuple(
            Observation(n, turn(POSES[name][2]).T @ (LANDMARKS[n] - POSES[name][:2]), R)
            for n in some))
        for name, some in numbers.items()]


def with_gross_error(scan):
    """Return a scan whose first landmark is 8 m off."""
    wrong, *rest = scan.observations
    return replace(
        scan, observations=(replace(wrong, z=np.add(wrong.z, [8.0, 0.0])), *rest))


def assert_in_place(estimator, *robots):
    """Check that these robots and no others are in ``map``, at their true poses."""
    state = estimator.groups.team.state
    assert sorted(state.robots) == sorted(robots)
    for name in robots:
        x = state.estimate(state.robots[name])
        assert np.abs(pose_difference(x, POSES[name])).max() < 1e-11


@pytest.mark.parametrize('seen', [
    {'r1': [0, 1], 'r2': [0, 1, 2, 3], 'r3': [2, 3]},
    {'r1': [0, 1], 'r3': [0, 1, 2, 3], 'r2': [2, 3]},
    {'r1': [0, 1], 'r2': [0, 2, 3], 'r3': [1, 2, 3]}])
def test_a_robot_may_be_located_through_another(seen):
    estimator, _ = estimate([*still(POSES), *look(**seen)], POSES)

    assert_in_place(estimator, 'r1', 'r2', 'r3')


def test_a_robot_with_known_start_needs_no_observation():
    known = RobotSettings('r2', 2, tuple(POSES['r2']), (0.1, 0.2, 0.05))
    records = [*still(['r1', 'r2']), *look(r1=[0, 1], r2=[])]

    estimator, _ = estimate(records, ('r1', known))

    assert_in_place(estimator, 'r1', 'r2')
    state = estimator.groups.team.state
    P = np.diag([0.01, 0.04, 0.0025]) + np.diag([0.01] * 3)  # its start and one motion
    assert_allclose(state.marginal([state.robots['r2']]), P, atol=1e-15)


@pytest.mark.parametrize('kind', ['fej', 'standard', 'invariant'])
def test_a_robot_with_known_start_may_observe_nothing_while_others_are_located(kind):
    known = RobotSettings('r3', 3, tuple(POSES['r3']), (0.1, 0.2, 0.05))
    records = [*still(POSES), *look(r1=[0, 1], r2=[0, 1])]

    estimator, _ = estimate(records, ('r1', 'r2', known), filter=kind)

    assert_in_place(estimator, *POSES)
    state = estimator.groups.team.state
    noise = turn(POSES['r3'][2]) @ np.diag([0.01, 0.01]) @ turn(POSES['r3'][2]).T
    P = np.diag([0.01, 0.04, 0.0025]) + block_diag(noise, 0.01)  # its start and one motion
    assert_allclose(state.marginal([state.robots['r3']]), P, atol=1e-15)


@pytest.mark.parametrize(('baseline', 'join_heading_sigma', 'frame'), [
    (0.8, 0.1, 'map'), (0.5, 0.1, 'r2/map'), (0.5, 0.5, 'map')])
def test_a_robot_whose_heading_landmarks_hardly_determine_is_not_placed_by_step_0(
        baseline, join_heading_sigma, frame):
    """Each of two robots measures a baseline to 0.14 m across: 0.2 m / baseline is the sigma."""
    pair = [(0, (4.0, 0.0)), (1, (4.0, baseline))]
    records = [*still(['r1', 'r2']), *(scan(name, 0, pair) for name in ('r1', 'r2'))]

    estimator, _ = estimate(records, ('r1', 'r2'), join_heading_sigma=join_heading_sigma)

    assert estimator.groups.of('r2').frame == frame
    # Only robots of one frame share a landmark.
    assert [f.owner for f in estimator.groups.team.state.landmarks.values()] == ['r1', 'r1']


def test_a_turn_before_step_0_counts_until_the_robot_observes_something():
    # sqrt(3 * 0.05) rad are too uncertain, sqrt(0.05) rad since step 0 at 2 s would not be.
    known = RobotSettings('r3', 3, tuple(POSES['r3']), (0.1, 0.2, 0.05))
    stamps = [k * SECOND for k in range(4)]
    records = [
        *still(['r1', 'r2'], stamps), *look(stamps[2], r1=[0, 1], r2=[0, 1]),
        *(Odometry('r3', t, np.zeros(3), np.diag([0.01, 0.01, 0.05])) for t in stamps),
        *look(stamps[0], r3=[2, 3, 4]), *look(stamps[3], r3=[2, 3, 4])]

    estimator, _ = estimate(records, ('r1', 'r2', known))

    assert estimator.statistics.relocalized['r3'] == 1
    assert_in_place(estimator, *POSES)


def test_a_known_start_is_a_prior():
    # Headings are exact. Along x, r1 observes the landmark at 2 and r2 observes it 1 behind, so
    # r2 is at 3 with variance 2; its prior is 4 with variance 1.
    known = RobotSettings('r2', 2, (4.0, 0.0, 0.0), (1.0, 1.0, 0.0))
    scans = [Scan(name, 0, (Observation(7, np.array([x, 0.0]), np.eye(2)),))
             for name, x in (('r1', 2.0), ('r2', -1.0))]

    estimator, _ = estimate([*still(['r1', 'r2'], [0]), *scans], ('r1', known))

    state = estimator.groups.team.state
    robot = state.robots['r2']
    assert_allclose(state.estimate(robot), [11.0 / 3.0, 0.0, 0.0], atol=1e-14)
    expected = np.diag([2.0 / 3.0, 2.0 / 3.0, 0.0])
    assert_allclose(state.marginal([robot]), expected, atol=1e-14)


def test_a_gross_error_at_step_0_moves_no_robot_whose_start_is_known():
    known = RobotSettings('r2', 2, tuple(POSES['r2']), (0.1, 0.1, 0.05))
    first, second = look(r1=[0, 1, 2], r2=[0, 1, 2])
    later = [scan for k in (1, 2) for scan in look(k * SECOND, r1=[0, 1, 2], r2=[0, 1, 2])]

    records = [
        *still(['r1', 'r2'], [0, SECOND, 2 * SECOND]), first, with_gross_error(second), *later]
    estimator, _ = estimate(records, ('r1', known))

    state = estimator.groups.team.state
    # All other observations are exact; a wrong one would move it by meters.
    assert_allclose(state.estimate(state.robots['r2']), POSES['r2'], atol=1e-3)
    for landmark in state.landmarks.values():
        assert_allclose(state.estimate(landmark), LANDMARKS[landmark.key[1]], atol=1e-3)


def test_a_gross_error_at_step_0_places_no_robot_whose_start_is_unknown():
    first, second = look(r1=[0, 1, 2, 3], r2=[0, 1, 2, 3])

    estimator, _ = estimate([*still(['r1', 'r2']), first, with_gross_error(second)])

    assert 'r2' not in estimator.groups.team.robots


def test_an_observation_of_a_known_landmark_at_step_0_is_used():
    known = RobotSettings('r2', 2, tuple(POSES['r2']), (0.5, 0.5, 0.1))
    records = [*still(['r1', 'r2']), *look(r2=[0]), *look(SECOND, r1=[0])]

    estimator, _ = estimate(records, ('r1', known))

    state = estimator.groups.team.state
    landmark = state.marginal([state.landmarks['', 0]])
    # r1 has moved once since it stood exactly at the origin; from there it is (2, 3).
    assert np.trace(landmark) < 2 * (0.01 + 0.01) + 0.01 * 13.0


def test_landmarks_belong_to_robots_of_the_team():
    # r2 observes landmark 2 before r3 and r4 do, but does not join.
    r4 = [replace(record, robot='r4') for record in look(r3=[0, 1, 2])]
    records = [*still([*POSES, 'r4']), *look(r1=[0, 1], r2=[2], r3=[0, 1, 2]), *r4]

    estimator, _ = estimate(records, (*POSES, 'r4'))

    state = estimator.groups.team.state
    assert estimator.groups.not_in_map == {'r2': '1 shared landmark, needs 3'}
    assert {landmark.owner for landmark in state.landmarks.values()} <= set(state.robots)


def known_map(rng):
    """Return a state with the anchor in a map of all landmarks, with correlated errors."""
    points = np.array([*LANDMARKS.values()])
    state = state_of_prior_map(PriorMap(
        tuple(LANDMARKS), points + rng.normal(0.0, 0.1, points.shape), np.eye(points.size)))
    state.insert_robot('r1', 0, POSES['r1'], np.eye(3))
    state.covariance = Covariance()
    state.covariance.insert(0.01 * random_covariance(rng, points.size + 3))
    return state


@pytest.mark.parametrize('policy', [FirstEstimates, Invariant])
def test_known_landmarks_without_observations_are_corrected_with_the_others(policy):
    seen = {'r1': [0, 1, 2], 'r2': [0, 1, 4]}
    scans = {scan.robot: [(('', o.id), o) for o in scan.observations] for scan in look(**seen)}

    state = initialize(
        known_map(np.random.default_rng(1)), 'r1', scans, 0, policy(), align)

    # The same with all landmarks as unknowns of the least squares.
    before = known_map(np.random.default_rng(1))
    anchor, landmarks = before.robots['r1'], [*before.landmarks.values()]
    expected = align(
        InitialAlignment(
            {'r1': POSES['r1']}, {f.key: before.estimate(f) for f in landmarks},
            before.marginal([anchor, *landmarks])), {'r2': POSES['r2']}, {}, scans)
    for key, point in expected.points.items():
        assert_allclose(state.estimate(state.landmarks[key]), point, atol=1e-9)
    if policy is FirstEstimates:
        variables = [
            *(state.robots[name] for name in expected.poses),
            *(state.landmarks[key] for key in expected.points)]
        # First estimates are those of the map, and of r2 the solution.
        linear = align(
            InitialAlignment(
                {'r1': POSES['r1']}, {f.key: before.estimate(f) for f in landmarks},
                before.marginal([anchor, *landmarks])), {'r2': POSES['r2']}, {}, scans,
            lambda poses, points: (
                {**poses, 'r1': POSES['r1']},
                {key: before.estimate(before.landmarks[key]) for key in points}))
        assert_allclose(state.marginal(variables), linear.P, atol=1e-9)
    assert [*state.landmarks] == [('', n) for n in (0, 1, 2, 4, 3, 5)]


@pytest.mark.parametrize('common', [10.0, 100.0])
def test_a_large_error_that_all_known_landmarks_share_leaves_the_covariance_definite(common):
    state, rng = known_map(np.random.default_rng(1)), np.random.default_rng(2)
    landmarks = [*state.landmarks.values()]
    # Relative errors of 1 cm, and an offset of all.
    offset = np.tile(np.eye(2), (len(landmarks), len(landmarks)))
    points = np.array([state.estimate(landmark) for landmark in landmarks])
    prior = state_of_prior_map(PriorMap(
        tuple(LANDMARKS), points, 1e-4 * random_covariance(rng, points.size)
        + common ** 2 * offset))
    prior.insert_robot('r1', 0, POSES['r1'], np.diag([common, common, 0.1]) ** 2)
    seen = {'r1': [0, 1, 2], 'r2': [0, 1, 4]}
    scans = {scan.robot: [(('', o.id), o) for o in scan.observations] for scan in look(**seen)}

    found = initialize(prior, 'r1', scans, 0, FirstEstimates(), align)

    P = found.marginal([*found.landmarks.values()])
    # Elements of 1e4 m^2 are rounded to 1e-12 m^2.
    assert np.linalg.eigvalsh(P)[0] > -1e-10 * (common / 100.0) ** 2


def test_a_step_with_empty_scans_only_moves_the_robots():
    records = [*still(['r1', 'r2'], [0, SECOND, 2 * SECOND]), *look(r1=[0, 1], r2=[0, 1])]
    blind = [*records, *look(SECOND, r1=[], r2=[])]

    estimator, results = estimate(blind)

    assert_in_place(estimator, 'r1', 'r2')
    anchor = [np.diag(step.poses[0].P) for step in results]
    assert_allclose(anchor, np.outer([0.0, 1.0, 2.0], [0.01, 0.01, 0.01]), atol=1e-15)


@pytest.mark.parametrize('robots', [1, 3, 5])
def test_teams_of_any_size_are_located(robots):
    records = circles(seed=7, robots=robots, landmarks=30, sensors=NEARLY_PERFECT)

    estimator, results = estimate(records, [f'r{i + 1}' for i in range(robots)])

    assert estimator.groups.not_in_map == {}
    assert len(results) == 64
    assert len(estimator.evaluation.scores) == robots
    for score in estimator.evaluation.scores.values():
        assert score.steps == 64
        assert score.position_rmse() < 1e-3
        assert score.heading_rmse() < 1e-3


def test_a_single_robot_starts_landmarks_where_it_observes_them():
    known = {'anchor_pose': (1.0, 2.0, pi / 2)}
    estimator, _ = estimate([*still(['r1'], [0]), *look(r1=[0])], ['r1'], **known)

    state = estimator.groups.team.state
    # Landmark 0 is 2 ahead and 3 to the left of a robot that faces left at (1, 2).
    assert_allclose(state.estimate(state.landmarks['', 0]), [1.0 - 3.0, 2.0 + 2.0], atol=1e-15)
