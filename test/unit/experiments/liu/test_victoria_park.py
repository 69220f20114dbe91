# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares and the filters on Victoria Park give the published numbers."""

from dataclasses import replace
from io import BytesIO
from itertools import accumulate
import json

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.io import savemat

from fej_slam_ros.core.geometry import between, compose, wrap_all
from fej_slam_ros.core.joining.initial_alignment import InitialAlignmentError
from fej_slam_ros.core.records import Observation
from fej_slam_ros.datasets.victoria_park.associated_log import (
    AssociatedLog, CarTeam, OBSERVATION_R, ODOMETRY_Q)
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.liu.figures import draw_park
from fej_slam_ros.experiments.liu.victoria_park import (
    BatchSolution, causal_least_squares, dead_reckoning, filtered, first_poses, least_squares,
    MaxDifference, PARK_FILTERS, ParkEstimate, reproduce, rmse, SOLUTIONS, VictoriaPark,
    with_observation_noise)
from fej_slam_ros.experiments.liu.victoria_park_report import (
    csv_rows, landmark_rows, markdown, pose_rows, summary)


class Drive:
    """
    Two robots that drive among six landmarks and always observe all of them, without noise.

    Attributes
    ----------
    truth : their poses and the landmarks
    logs, team : what they measure, and where r1 sets out

    """

    def __init__(self, steps=20):
        rng = np.random.default_rng(1)
        points = dict(enumerate(rng.uniform(-8.0, 8.0, (6, 2))))
        u = {robot: rng.normal([1.0, 0.0, 0.3], 0.2, (steps, 3)) for robot in ('r1', 'r2')}
        poses = {
            robot: np.array([*accumulate(u[robot], compose, initial=rng.normal(size=3))])
            for robot in u}
        self.truth = ParkEstimate(poses, points)
        self.logs = {
            robot: AssociatedLog(u[robot], [sighted(points, pose) for pose in poses[robot]])
            for robot in u}
        self.team = CarTeam(dict.fromkeys(u, (0, steps)), tuple(poses['r1'][0].tolist()))


def sighted(points, pose):
    return tuple(
        Observation(id_, between(pose, np.array([*point, 0.0]))[:2], OBSERVATION_R)
        for id_, point in points.items())


def assert_same(estimate, truth, atol):
    assert estimate.poses.keys() == truth.poses.keys()
    for robot, poses in truth.poses.items():
        error = estimate.poses[robot] - poses
        assert_allclose(np.column_stack([error[:, :2], wrap_all(error[:, 2])]), 0.0, atol=atol)
    assert estimate.points.keys() == truth.points.keys()
    for id_, point in truth.points.items():
        assert_allclose(estimate.points[id_], point, atol=atol)


def test_the_start_of_the_second_robot_follows_from_shared_landmarks():
    drive = Drive()

    first = first_poses(drive.logs, drive.team)

    for robot, poses in drive.truth.poses.items():
        assert_allclose(first[robot], poses[0], atol=1e-12)  # rounding


def test_robots_without_shared_landmarks_are_rejected():
    drive = Drive()
    blind = replace(drive.logs['r2'], observations=[(), *drive.logs['r2'].observations[1:]])

    with pytest.raises(InitialAlignmentError, match='share too few landmarks at their fi'):
        first_poses({**drive.logs, 'r2': blind}, drive.team)


def test_every_method_is_exact_without_noise():
    drive = Drive()
    start = dead_reckoning(drive.logs, first_poses(drive.logs, drive.team))

    assert_same(start, drive.truth, atol=1e-12)  # rounding
    for estimate in (
        least_squares(drive.logs, start, ODOMETRY_Q, OBSERVATION_R).estimate,
        *(filtered(drive.logs, drive.team, name, drive.truth) for name in PARK_FILTERS),
    ):
        assert_same(estimate, drive.truth, atol=1e-9)  # rounding, with weights of 1e4


def test_causal_least_squares_uses_the_log_up_to_the_step():
    drive = Drive(steps=50)
    # Inconsistent observations make a difference between solutions with and without them.
    logs = with_observation_noise(drive.logs, 0.1)
    scans = logs['r2'].observations
    scans[10] = tuple(replace(s, z=s.z + 1.0) for s in scans[10])
    whole = least_squares(logs, drive.truth, ODOMETRY_Q, OBSERVATION_R).estimate

    known = causal_least_squares(logs, whole)

    for robot in logs:
        assert_allclose(known.poses[robot][0], drive.truth.poses[robot][0], atol=1e-9)  # rounding
        assert_allclose(known.poses[robot][1], whole.poses[robot][50], atol=1e-9)  # rounding


def test_observation_noise_changes_the_covariance_only():
    logs = Drive(steps=3).logs

    noisier = with_observation_noise(logs, 2.0)

    for before, after in zip(logs['r2'].observations[3], noisier['r2'].observations[3]):
        assert (after.id, *after.z) == (before.id, *before.z)
        assert_allclose(after.R, [[4.0, 0.0], [0.0, 4.0]])


def test_rmse_is_over_all_steps_but_the_given_start_of_r1():
    reference = ParkEstimate(
        {'r1': np.zeros((3, 3)), 'r2': np.full((3, 3), 3.0)}, {4: np.zeros(2), 9: np.ones(2)})
    estimate = ParkEstimate(
        {'r1': np.array([[9.0, 9.0, 1.0], [3.0, 4.0, 0.1], [0.0, 1.0, -0.7]]),
         'r2': np.array([[3.0, 3.0, 3.3], [7.0, 3.0, 3.0], [3.0, 5.0, 3.4 - 2.0 * np.pi]])},
        {9: np.array([1.0, 3.0]), 4: np.array([0.0, 0.0])})

    by_hand = {
        'r1_pos': 13.0**0.5, 'r1_head': 0.5, 'r2_pos': (20.0 / 3.0) ** 0.5,
        'r2_head': (0.25 / 3.0) ** 0.5, 'f_pos': 2.0**0.5}
    assert rmse(estimate, reference) == pytest.approx(by_hand, rel=1e-12)


@pytest.fixture
def made_up():
    """Return a result that was made up: FEJ is better only at R1, the invariant filter at R2."""
    truth = Drive(steps=2).truth
    entries = {'r1_pos': 2.0, 'r1_head': 0.2, 'r2_pos': 1.0, 'r2_head': 0.1, 'f_pos': 1.0}
    both = {
        'standard': entries, 'ideal': entries,
        'fej': {**entries, 'r1_pos': 0.5, 'r1_head': 0.1, 'r2_pos': 3.0},
        'invariant': {**entries, 'r2_head': 0.01, 'f_pos': 0.4}}
    noisier = {**both, 'fej': {**entries, 'r1_pos': 0.2, 'f_pos': 0.3}}
    bounds = {'until_then': {**entries, 'r2_pos': 1.5}, 'two_robot_batch': entries}
    alone = ParkEstimate({'r1': truth.poses['r1']}, truth.points)
    return VictoriaPark(
        BatchSolution(truth, 20.0, 30, 4), BatchSolution(alone, 5.0, 6, 7),
        dict.fromkeys(PARK_FILTERS, truth),
        {0.075: {'two_robot_batch': both, 'one_robot_batch': both},
         0.15: {'two_robot_batch': both, 'one_robot_batch': noisier}},
        bounds, MaxDifference(1e-9, 2e-10))


def test_the_page_compares_fej_with_the_standard_filter(made_up):
    text = markdown(made_up)

    assert 'FEJ is **not** better than the standard filter in all entries' in text
    assert 'better in R1 pos, R1 head; worse in R2 pos, R2 head, map pos' in text
    assert 'better in R2 pos, R2 head, map pos; worse in R1 pos, R1 head' in text
    assert '| two-robot batch | FEJ | 0.075 | 0.500 | 0.1000 | 3.000 | 0.1000 | 1.000 |' in text
    assert '| two robots | as the filters | 20.000 | 30 | 4 |' in text


def test_the_page_compares_with_the_paper_and_with_causal_least_squares(made_up):
    text = markdown(made_up)

    assert '- invariant, observations of 0.075 m: R2 pos\n' in text  # 0.4 m is not below 0.4 m
    assert '- FEJ, observations of 0.075 m: nothing\n' in text
    assert '- FEJ, observations of 0.15 m: R1 pos, R2 pos, map pos\n' in text
    assert 'differs from X_GNI by 2.00 m (R1) and 1.50 m (R2)' in text


def test_the_page_says_whether_the_authors_file_exists(made_up):
    assert 'they differ by 1e-09 m and 2e-10 rad at most' in markdown(made_up)
    assert 'no X_GNI.mat to compare' in markdown(replace(made_up, x_gni=None))


def test_rows_and_summary_hold_the_results(made_up):
    rows, poses, points = csv_rows(made_up), [*pose_rows(made_up)], [*landmark_rows(made_up)]
    x, y, phi = made_up.filters['ideal'].poses['r2'][2].tolist()

    assert ['two_robot_batch', 'fej', '0.075', '0.5', '0.1', '3.0', '0.1', '1.0'] in rows
    assert len(poses) == 1 + (2 + 1 + 2 * len(PARK_FILTERS)) * 3
    assert poses[-1] == ['ideal', 'r2', '2', repr(x), repr(y), repr(phi)]
    assert [row[:2] for row in points[-2:]] == [['ideal', '4'], ['ideal', '5']]
    content = json.loads(json.dumps(summary(made_up)))
    assert content['rmse']['0.075']['one_robot_batch']['fej']['r2_pos'] == 3.0
    assert content['bounds']['until_then']['r2_pos'] == 1.5
    assert content['batch']['two_robot_batch'] == {'cost': 20.0, 'unknowns': 30, 'iterations': 4}
    assert content['x_gni_difference'] == {'position': 1e-9, 'heading': 2e-10}


def test_the_figure_is_a_png(made_up):
    picture = BytesIO()

    draw_park(picture, made_up)

    assert picture.getvalue().startswith(b'\x89PNG')


@pytest.fixture
def foreign(tmp_path):
    """Return a folder with the log of a car that drives straight on and sees landmarks 1 and 2."""
    steps = [(value, 1, k + 1, k) for k in range(5900) for value in (1.0, 0.0, 0.0)]
    observations = [
        (value, 2, id_, pose) for id_, pose in ((1, 719), (2, 3265)) for value in (3, 4)]
    savemat(tmp_path / 'Zstate.mat', {'Zstate': np.array(steps + observations)})
    return tmp_path


def test_the_log_of_another_car_is_rejected(foreign):
    with pytest.raises(UserError, match=r'Zstate.mat: .*; take the log of Victoria Park$'):
        reproduce(foreign)


@pytest.mark.parametrize(('poses', 'ids'), [(1, (1, 3)), (5901, (1, 2))])
def test_the_solution_of_another_log_is_rejected(foreign, poses, ids):
    X = [(1, k, 0.0) for k in range(1, poses + 1) for _ in range(3)]
    X += [(2, id_, 0.0) for id_ in ids for _ in range(2)]
    savemat(foreign / 'X_GNI.mat', {'X': np.array(X)})

    with pytest.raises(UserError, match=r'X_GNI.mat is the solution of another log'):
        reproduce(foreign)


# What follows needs the published data.

@pytest.fixture
def result(victoria_park):
    return victoria_park[0]


def test_least_squares_over_both_robots_meets_the_published_chi_square(result):
    assert result.two_robots.cost == pytest.approx(156914.948, abs=1e-3)
    assert result.two_robots.unknowns == 15847


def test_unweighted_least_squares_over_the_log_is_x_gni(result):
    assert result.one_robot.cost == pytest.approx(1283.1503214786, abs=1e-6)
    assert result.x_gni.position < 1e-6
    assert result.x_gni.heading < 1e-8


@pytest.mark.parametrize(('reference', 'name', 'expected'), [
    # By the authors' stored results.
    ('two_robot_batch', 'standard', '0.222 0.0032 1.355 0.0154 0.739'),
    ('two_robot_batch', 'fej', '0.153 0.0027 1.601 0.0172 0.162'),
    ('one_robot_batch', 'standard', '0.277 0.0041 1.251 0.0140 0.402'),
    ('one_robot_batch', 'fej', '0.217 0.0036 1.530 0.0161 0.633'),
])
def test_the_rmse_of_both_filters_are_the_published_ones(result, reference, name, expected):
    assert rounded(result.rmse[0.075][reference][name]) == expected


def rounded(entries):
    digits = zip(entries.values(), (3, 4, 3, 4, 3))
    return ' '.join(f'{value:.{count}f}' for value, count in digits)


def test_the_invariant_filter_with_twice_the_noise_is_better_than_the_paper(result):
    entries = result.rmse[0.15]['one_robot_batch']['invariant']

    assert entries['r1_pos'] < 0.217
    assert entries['r2_pos'] < 1.25
    assert entries['f_pos'] < 0.40


def test_fej_and_the_ideal_filter_are_near_causal_least_squares(result):
    known = result.rmse[0.075]['until_then']

    for name in ('fej', 'ideal'):
        assert known[name]['r1_pos'] < 0.05
        assert known[name]['r2_pos'] < 0.1


def test_fej_is_reported_as_better_at_r1_and_worse_at_r2(result):
    text = markdown(result)

    assert 'two-robot batch better in R1 pos, R1 head, map pos; worse in R2 pos, R2 head\n' in text
    assert '(X_GNI) better in R1 pos, R1 head; worse in R2 pos, R2 head, map pos\n' in text
    assert 'differs from X_GNI by 0.24 m (R1) and 1.46 m (R2)' in text


def test_each_part_reports_its_progress_first(victoria_park):
    _, messages = victoria_park

    assert len(messages) == len(set(messages)) == SOLUTIONS
