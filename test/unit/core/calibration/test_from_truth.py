# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors against ground truth, and the noise scale factors that they give."""

from dataclasses import replace
import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_truth import DOF, normalized_errors
from fej_slam_ros.core.calibration.scales_of_errors import noise_scales
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.records import Odometry, RobotScan, Scan, TrueLandmarks, TruePose
from fej_slam_ros.ros.session import simulation
from helpers.records import claiming, odometry, scan, team, true_pose

#: Stated are half, twice and all of the noise.
TRUE_FACTORS = {'odometry': 2.0, 'landmark': 0.5, 'robot': 1.0}
STATED = {Odometry: 0.5, Scan: 2.0}


def simulated(seed, **changes):
    return [*simulation.parse({
        'loops': 5, 'rate': 1, 'landmarks': 40, 'robot_sigma': [0.2, 0.3], 'seed': seed,
        **changes}).records()]


def errors_in(records, **changes):
    settings = team(**changes)
    return normalized_errors(
        TeamRecords([(record, None) for record in records], settings), settings)


def scales(records, **changes):
    errors = errors_in(records, **changes)
    return {kind: noise_scales(values, DOF[kind]) for kind, values in errors.items()}


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_factors_equal_those_of_the_simulation(seed):
    found = scales(claiming(simulated(seed), STATED))

    for kind, true in TRUE_FACTORS.items():
        team_factor = found[kind]['']
        # Beyond 4 standard errors once in a thousand such tests.
        off = math.log(team_factor.scale / true)
        assert abs(off) < 4.0 * team_factor.relative_error, kind


@pytest.mark.parametrize('seconds', [10, 50])
def test_sparse_true_poses_give_the_factors(seconds):
    records = claiming(simulated(4, loops=40), STATED)
    sparse = [
        record for record in records
        if not isinstance(record, TruePose) or record.stamp // 10**9 % seconds == 0]

    found = scales(sparse)

    # Drift over 50 s turns the robot by so much that the error is not quite normal: 10 % more.
    for kind in ('odometry', 'landmark'):
        off = abs(math.log(found[kind][''].scale / TRUE_FACTORS[kind]))
        assert off < 4.0 * found[kind][''].relative_error + 0.1, kind
        assert found[kind][''].samples > 20


@pytest.mark.parametrize('late', [0.17, -0.17])
def test_odometry_leads_from_a_sparse_true_pose_to_an_observation(late):
    start, ms = np.array([5.0, 0.0, math.pi / 2.0]), round(10_000 + 1000 * late)
    # At 1 m/s ahead; the true pose is known at 10 s only, the landmark was observed 0.17 s later
    # or earlier, between two odometry messages.
    records = [
        *(odometry('r1', 100 * k, (0.1 * k, 0.0, 0.0)) for k in range(200)),
        true_pose('r1', 10_000, start), TrueLandmarks({1: np.array([5.0, 3.0 + late])}, 0),
        scan('r1', ms, [(1, (3.1, 0.0))]), scan('r1', 10_400, [(1, (9.0, 0.0))])]

    (squared,) = errors_in(records)['landmark']['r1']

    # The robot is at (5.0, late), 3 m from the landmark.
    R = records[-2].observations[0].R
    assert squared == pytest.approx(0.1 ** 2 / R[0, 0])


@pytest.mark.parametrize('ms', [9_800, 10_200])
def test_beyond_odometry_nothing_leads_from_a_sparse_true_pose(ms):
    records = [
        *(odometry('r1', ms) for ms in range(9_900, 10_101, 100)),
        true_pose('r1', 10_000, (5.0, 0.0, 0.0)), TrueLandmarks({1: np.array([8.0, 0.0])}, 0),
        scan('r1', ms, [(1, (3.0, 0.0))])]

    assert 'landmark' not in errors_in(records)


def test_odometry_that_claims_to_be_exact_has_no_normalized_error():
    exact = [odometry('r1', ms, twist_covariance=np.zeros((3, 3))) for ms in range(0, 20_001, 100)]
    truth = [true_pose('r1', ms, (0.0, 0.0, 0.0)) for ms in range(0, 20_001, 100)]

    assert errors_in([*exact, *truth]) == {}


@pytest.mark.parametrize('known', [True, False])
def test_errors_much_larger_than_stated_are_no_outliers(known):
    records = [
        r for r in claiming(simulated(1), {Scan: 0.01})
        if known or not isinstance(r, TrueLandmarks)]

    found = scales(records)['landmark']['']

    assert abs(math.log(found.scale / 100.0)) < 4.0 * found.relative_error


def test_a_robot_with_other_noise_has_a_factor_of_its_own():
    of_r2 = {Odometry: 0.25, Scan: 1.0}
    records = [
        claiming([r], of_r2 if getattr(r, 'robot', '') == 'r2' else STATED)[0]
        for r in simulated(1, loops=10)]

    found = scales(records)

    for robot, kind, true in [
            ('r1', 'odometry', 2.0), ('r2', 'odometry', 4.0), ('r1', 'landmark', 0.5),
            ('r2', 'landmark', 1.0)]:
        own = found[kind][robot]
        assert abs(math.log(own.scale / true)) < 4.0 * own.relative_error, (robot, kind)


def test_a_robot_with_little_data_has_the_factor_of_the_team():
    assert scales(simulated(1, loops=1))['odometry'].keys() == {''}


def test_standing_still_changes_no_factor():
    records = [r for r in simulated(1) if isinstance(r, (Odometry, TruePose)) and r.robot == 'r1']
    last = {type(record): record for record in records}
    still = [
        replace(record, stamp=record.stamp + seconds * 10**9)
        for seconds in range(1, 601) for record in last.values()]

    factors = [scales(some)['odometry'][''] for some in (records, records + still)]

    assert factors[0] == factors[1]


def test_outliers_do_not_change_the_factor():
    right = scales(simulated(1))['landmark']['']
    moved = [
        replace(record, observations=(
            replace(record.observations[0], z=record.observations[0].z + 20.0),
            *record.observations[1:]))
        if isinstance(record, Scan) and record.observations and record.stamp % 20 == 0 else record
        for record in simulated(1)]

    robust = scales(moved)['landmark']['']

    assert abs(math.log(robust.scale / right.scale)) < right.relative_error


def test_systematic_errors_count_in_full():
    # Constant velocity error of 10 % at 1 m/s, stated as independent errors of 0.1 m/s.
    times = range(0, 60_001, 100)
    truth = [true_pose('r1', ms, (ms / 1000.0, 0.0, 0.0)) for ms in times]
    slow = [odometry('r1', ms, (0.9 * ms / 1000.0, 0.0, 0.0), 0.01 * np.eye(3)) for ms in times]

    errors = errors_in([*slow, *truth])['odometry']['r1']

    # 0.5 m in 5 s, against sqrt(50) times 0.1 m/s for 0.1 s.
    assert errors == pytest.approx([50.0] * 12)


def test_odometry_over_more_than_a_minute_is_no_error():
    # It stands still in truth; odometry has a pause in which it jumps, and then moves.
    times = [*range(0, 4001, 100), *range(104_000, 300_001, 100)]
    jumping = [
        odometry('r1', ms, (9.0 if ms > 4000 else 0.0, ms * 1e-3, 0.0), np.eye(3)) for ms in times]

    def errors(*seconds):
        truth = [true_pose('r1', 1000 * s, (0.0, 0.0, 0.0)) for s in seconds]
        return errors_in([*jumping, *truth]).get('odometry', {'r1': []})['r1']

    assert len(errors(*range(300))) == 196 // 5
    assert max(errors(*range(300))) == pytest.approx(5.0 ** 2 / (50 * 0.1 ** 2))
    assert errors(110, 180, 250) == []
    assert len(errors(110, 165, 250)) == 1


def test_errors_of_observations_that_persist_count_in_full():
    # Error of 0.1 m in x for 5 s, then in y, and so on, stated as independent errors of 0.1 m.
    times = range(0, 60_000, 100)
    truth = [true_pose('r1', ms, (0.0, 0.0, 0.0)) for ms in times]
    shift = 0.1 * np.eye(2)
    scans = [scan('r1', ms, [(1, [3.0, 4.0] + shift[ms // 5000 % 2])]) for ms in times]
    landmarks = TrueLandmarks({1: np.array([3.0, 4.0])}, 0)

    errors = errors_in([*truth, landmarks, *scans])

    # 50 times 0.1 m in a window, against sqrt(50) times 0.1 m.
    assert errors['landmark']['r1'] == pytest.approx([50.0] * 12)


@pytest.mark.parametrize('shared', [True, False])
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_positions_of_landmarks_need_not_be_known(seed, shared):
    records = claiming(simulated(seed), STATED)
    if shared:
        records = [r for r in records if not isinstance(r, TrueLandmarks)]
    else:
        # True landmarks have the IDs of another robot.
        records = [
            replace(r, positions={k: x + 1.0 for k, x in r.positions.items()})
            if isinstance(r, TrueLandmarks) else r for r in records]

    found = scales(records, shared_landmark_ids=shared)['landmark']['']

    assert abs(math.log(found.scale / 0.5)) < 4.0 * found.relative_error
    assert found.samples > 500


def test_a_gross_error_does_not_move_a_landmark_whose_position_is_not_known():
    truth = [true_pose('r1', ms, (0.0, 0.0, 0.0)) for ms in range(0, 60_001, 100)]
    rng = np.random.default_rng(1)
    # Independent errors of 0.1 m, as stated, and one of 50 m.
    points = np.array([3.0, 4.0]) + rng.normal(0.0, 0.1, (600, 2))
    points[300] += 50.0
    scans = [scan('r1', 100 * k, [(1, point)]) for k, point in enumerate(points)]

    errors = errors_in([*truth, *scans])['landmark']['r1']

    # Of chi-square with 2 degrees of freedom: 12 windows have a mean of 2 within 0.6 (one sigma).
    assert len(errors) == 12
    assert abs(np.mean(errors) - 2.0) < 4.0 * 0.6


def test_a_mean_position_from_few_windows_is_nearer_to_them_than_the_truth():
    # One observation of each landmark in each of five windows, with the stated errors of 0.1 m.
    rng = np.random.default_rng(1)
    truth = [true_pose('r1', ms, (0.0, 0.0, 0.0)) for ms in range(0, 25_001, 100)]
    scans = [
        scan('r1', ms, [*enumerate(3.0 + rng.normal(0.0, 0.1, (300, 2)))])
        for ms in range(0, 25_000, 5000)]

    found = scales([*truth, *scans])['landmark']['']

    assert abs(math.log(found.scale)) < 4.0 * found.relative_error


def test_a_mean_position_is_exact_in_the_directions_in_which_observations_are():
    # One metre across the line of sight, 0.01 m along it, from two sides in turn.
    rng, R = np.random.default_rng(1), np.diag([0.01, 1.0]) ** 2
    sides = [(0.0, 0.0, 0.0), (3.0, -3.0, math.pi / 2.0)]
    truth = [true_pose('r1', ms, sides[ms // 5000 % 2]) for ms in range(0, 60_000, 100)]
    scans = [
        replace(record, observations=tuple(replace(o, R=R) for o in record.observations))
        for record in (
            scan('r1', ms, [(1, rng.normal([3.0, 0.0], [0.01, 1.0]))])
            for ms in range(1000, 60_000, 5000))]

    errors = errors_in([*truth, *scans])['landmark']['r1']

    # Of chi-square with 2 degrees of freedom: 12 windows have a mean of 2 within 0.6 (one sigma).
    assert len(errors) == 12
    assert abs(np.mean(errors) - 2.0) < 4.0 * 0.6


def test_windows_of_several_robots_give_the_position_of_a_landmark():
    records = [
        record for ms in range(0, 15_001, 100) for robot in ('r1', 'r2') for record in (
            true_pose(robot, ms, (0.0, 0.0, 0.0)), scan(robot, ms, [(1, (3.0, 4.0))]))]

    found = errors_in(records)

    assert found['landmark']['r1'] == found['landmark']['r2'] == pytest.approx([0.0] * 4)


def test_a_landmark_that_is_observed_in_few_windows_has_no_position():
    truth = [true_pose('r1', ms, (0.0, 0.0, 0.0)) for ms in range(0, 20_001, 100)]
    scans = [scan('r1', ms, [(1, (3.0, 4.0))]) for ms in range(0, 20_000, 100)]

    assert not errors_in([*truth, *scans])


def test_without_ground_truth_there_are_no_errors():
    measured = [r for r in simulated(1) if isinstance(r, (Odometry, Scan, RobotScan))]

    assert not errors_in(measured)
