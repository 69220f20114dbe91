# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks without IDs are created, confirmed by repeated observations, or deleted."""

import numpy as np
import pytest

from fej_slam_ros.core.data_association.landmark_manager import FieldOfView
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NO_ID, Observation, PosePrior, PriorMap, TrueLandmarks
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.snapshot import restore, snapshot
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, estimate
from helpers.records import odometry, robot_scan, scan, team

THREE = {1: (4.0, 3.0), 2: (6.0, -5.0), 3: (9.0, 2.0)}
SMALL = 1e-4 * np.eye(3)


def drive(*seen, robot='r1', at=(0.0, 0.0)):
    """Return the records of a robot that goes 0.1 m between scans of points, given in map."""
    for k, points in enumerate(seen):
        x = at[0] + 0.1 * k
        yield odometry(robot, 100 * k, (0.1 * k, 0.0, 0.0), SMALL)
        yield scan(robot, 100 * k, [(i, (p[0] - x, p[1] - at[1])) for i, p in points])


def unnamed(*points):
    """Return points without IDs."""
    return [(NO_ID, point) for point in points]


def run(records, prior=None, settings=None):
    estimator = Estimator(settings or team('r1', 'r2'), prior)
    for record in sorted(records, key=lambda record: record.stamp):
        estimator.add(record)
    list(estimator.close())
    return estimator


def numbers(estimator):
    """Return the numbers of the landmarks that count, and of those that do not yet."""
    state = estimator.groups.team.state
    settled = {f.key[1] for f in state.confirmed_landmarks()}
    return settled, {number for _, number in state.landmarks} - settled


def test_assigned_ids_go_down_from_minus_2_in_the_order_of_the_message():
    estimator = run(drive(unnamed(*THREE.values())))

    points = {key[1]: estimator.groups.team.state.estimate(f)
              for key, f in estimator.groups.team.state.landmarks.items()}
    np.testing.assert_allclose([points[n] for n in (-2, -3, -4)], [*THREE.values()], atol=1e-9)


@pytest.mark.parametrize(('scans', 'settled'), [(1, 0), (3, 0), (4, 3)])
def test_a_landmark_is_confirmed_after_three_more_observations(scans, settled):
    estimator = run(drive(*[unnamed(*THREE.values())] * scans))

    assert [len(found) for found in numbers(estimator)] == [settled, 3 - settled]


def test_a_landmark_that_is_not_observed_again_is_deleted():
    first = unnamed(*THREE.values(), (3.0, -2.0))

    estimator = run(drive(first, *[unnamed(*THREE.values())] * 4))

    assert numbers(estimator) == ({-2, -3, -4}, set())
    assert estimator.landmark_manager.counts['r1']['forgotten'] == 1


def test_an_empty_scan_counts_as_a_missed_observation():
    assert numbers(run(drive(unnamed((4.0, 3.0), (1.0, 0.1)), []))) == (set(), {-2})


def test_a_landmark_at_the_edge_of_the_view_may_be_missed_often():
    estimator = run(drive(unnamed((20.0, 0.0), (1.0, 2.0)), *[unnamed((1.0, 2.0))] * 10))

    assert numbers(estimator) == ({-3}, {-2})


def test_doubtful_observations_are_rejected_and_counts_add_up():
    close = unnamed((4.0, 3.0), (4.0, 3.3))

    estimator = run(drive(*[close] * 5, unnamed((4.0, 3.15))))

    statistics, counts = estimator.statistics, estimator.landmark_manager.counts['r1']
    rejected = statistics.rejection_counts['r1']
    assert rejected[RejectionReason.DOUBTFUL_MATCH] == counts['doubtful'] > 0
    assert statistics.observations_used['r1'] + sum(rejected.values()) == 11
    assert counts['matched'] + counts['new'] + counts['doubtful'] == 11
    assert statistics.rejected['r1'] == 0


def test_a_scan_may_mix_observations_with_and_without_ids():
    mixed = [(1, THREE[1]), *unnamed(THREE[2], THREE[3])]

    estimator = run(drive(*[mixed] * 5))

    assert numbers(estimator) == ({1, -2, -3}, set())


def test_a_landmark_observed_by_id_is_not_matched_again_in_the_scan():
    estimator = run(drive(*[[(1, (4.0, 3.0))]] * 3, [(1, (4.0, 3.0)), *unnamed((4.05, 3.0))]))

    assert numbers(estimator) == ({1}, {-2})


def test_a_landmark_with_id_is_matched_without_id():
    estimator = run(drive(*[[*THREE.items()]] * 3, unnamed(*THREE.values())))

    assert numbers(estimator) == ({1, 2, 3}, set())
    assert estimator.landmark_manager.counts['r1']['matched'] == 3


def test_a_robot_matches_landmarks_of_another_robot():
    estimator = run(
        [*drive(*[unnamed(*THREE.values())] * 5),
         *drive(*[unnamed(*THREE.values())] * 5, robot='r2', at=(0.0, 1.0))],
        settings=team('r1', 'r2', known=[('r2', (0.0, 1.0, 0.0), (0.01, 0.01, 0.001))]))

    assert numbers(estimator) == ({-2, -3, -4}, set())


def test_step_0_leaves_observations_without_id_to_the_update():
    everything = [*THREE.items(), *unnamed((2.0, 7.0), (-3.0, 1.0))]

    estimator = run(
        [*drive(*[everything] * 5), *drive(*[everything] * 5, robot='r2', at=(0.0, 1.0))])

    assert estimator.groups.not_in_map == {}
    assert numbers(estimator) == ({1, 2, 3, -2, -3}, set())


def test_frames_joined_by_a_pose_prior_have_each_landmark_once():
    seen = [unnamed(*THREE.values())] * 6
    given = PosePrior('r2', 500_000_000, np.array([0.5, 1.0, 0.0]), SMALL)

    estimator = run([*drive(*seen), *drive(*seen, robot='r2', at=(0.0, 1.0)), given])

    assert estimator.groups.not_in_map == {}
    assert numbers(estimator) == ({-2, -3, -4}, set())
    assert estimator.landmark_manager.counts['r2']['merged'] == 3


def test_frames_joined_by_robot_observations_have_each_landmark_once():
    sensors = SensorSettings(
        (0.05, 0.05, 0.01), (0.1, 0.1), robot_sigma=(0.1, 0.1), identities=False)
    estimator, _ = estimate(circles(2, landmarks=30, loops=2, sensors=sensors))

    truth = next(
        r for r in circles(2, landmarks=30, sensors=sensors) if isinstance(r, TrueLandmarks))
    assert estimator.groups.not_in_map == {}
    assert len(numbers(estimator)[0]) <= len(truth.positions)


def test_a_prior_map_may_have_assigned_ids():
    prior = PriorMap((-2, -7), np.array([THREE[1], THREE[2]]), 1e-4 * np.eye(4))

    estimator = run(drive(*[unnamed(*THREE.values())] * 5), prior)

    assert numbers(estimator) == ({-2, -7, -8}, set())


def test_the_order_of_arrival_of_scans_at_one_stamp_changes_no_bit():
    hashes = set()
    for order in ((1, 2), (2, 1)):
        records = [*drive(*[unnamed(*THREE.values())] * 3)]
        parts = {1: unnamed(THREE[1], (2.0, 2.0)), 2: unnamed(THREE[2], THREE[3])}
        records.append(odometry('r1', 300, (0.3, 0.0, 0.0), SMALL))
        records += [
            scan('r1', 300, [(i, (x - 0.3, y)) for i, (x, y) in parts[k]]) for k in order]
        hashes.add(run(records).state_hash())

    assert len(hashes) == 1


def test_a_run_without_ids_may_be_continued_at_any_record():
    sensors = SensorSettings(
        (0.05, 0.05, 0.01), (0.1, 0.1), identities=False, clutter=0.3, missed=0.1)
    records = circles(3, landmarks=20, sensors=sensors)[:150]
    whole, broken = Estimator(team('r1', 'r2')), Estimator(team('r1', 'r2'))

    for k, record in enumerate(records):
        for estimator in (whole, broken):
            estimator.add(record)
            list(estimator.take())
        if k % 7 == 0:
            broken = restore(snapshot(broken), broken.settings, Estimator)

    assert whole.landmark_manager.last < -10
    assert broken.state_hash() == whole.state_hash()
    assert broken.landmark_manager == whole.landmark_manager


def test_with_all_ids_observed_nothing_is_matched():
    records = circles(1)

    estimator, _ = estimate(records, match_probability=0.5)
    other, _ = estimate(records)

    assert estimator.state_hash() == other.state_hash()
    assert all(not counts for counts in map(dict, estimator.landmark_manager.counts.values()))


def test_ids_per_robot_and_observations_without_id_may_be_mixed():
    mixed = [(1, THREE[1]), *unnamed(THREE[2], THREE[3])]

    estimator = run(
        [*drive(*[mixed] * 5), *drive(*[mixed] * 5, robot='r2', at=(0.0, 1.0))],
        settings=team('r1', 'r2', known=[('r2', (0.0, 1.0, 0.0), (0.01, 0.01, 0.001))],
                      shared_landmark_ids=False))

    assert {*estimator.groups.team.state.landmarks} == {('r1', 1), ('r2', 1), ('', -2), ('', -3)}


def test_a_filter_that_needs_truth_needs_ids():
    assert Estimator(team('r1', filter='ideal')).needs_ids
    assert not Estimator(team('r1')).needs_ids


def test_robot_observations_are_not_matched():
    seen = [unnamed(*THREE.values())] * 5
    meeting = robot_scan('r1', 200, [('r2', (-0.2, 1.0))])
    records = [*drive(*seen), *drive(*seen, robot='r2', at=(0.0, 1.0))]
    known = team('r1', 'r2', known=[('r2', (0.0, 1.0, 0.0), (0.01, 0.01, 0.001))])

    estimator = run([*records, meeting], settings=known)

    assert numbers(estimator) == ({-2, -3, -4}, set())


def points_of_a_sector(rng, count):
    """Return observations of points that are uniform in a sector of 10 m and 1 rad."""
    r, beta = 10.0 * np.sqrt(rng.random(count)), rng.uniform(-1.0, 1.0, count)
    return [
        Observation(NO_ID, z, np.eye(2))
        for z in np.column_stack([r * np.cos(beta), r * np.sin(beta)])]


def test_the_field_of_view_contains_nearly_all_objects_of_a_sector():
    view = FieldOfView()
    view.widen(points_of_a_sector(np.random.default_rng(1), 1000))

    # The third largest of 1,000: 10 m less 10 m / 2 * 3 / 1000, twice that by chance.
    assert 9.95 < view.range < 10.0
    assert 0.99 < view.bearing < 1.0


@pytest.mark.parametrize('far', [100.0, 65_535.0])
def test_single_far_points_do_not_extend_the_field_of_view(far):
    rng, view = np.random.default_rng(2), FieldOfView()
    for k in range(1000):
        view.widen(points_of_a_sector(rng, 5))
        if k % 250 == 0:
            view.widen([Observation(NO_ID, np.array([-far, 0.0]), np.eye(2))])

    assert view.range < 10.0
    assert view.bearing < 1.0
