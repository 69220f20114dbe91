# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two robots that join their maps: evaluation of the joint map, and the scenes."""

from dataclasses import replace
import math

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.geometry import between, wrap
from fej_slam_ros.core.records import fingerprint, Odometry, RobotScan, Scan
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import information
from fej_slam_ros.core.smoothing.problem import Problem
from fej_slam_ros.experiments.andersson import experiment
from fej_slam_ros.experiments.andersson.experiment import Scene, scene
from fej_slam_ros.ros.session import simulation
from helpers.slow import slow

A = experiment.CsamTask('map_joining', 3)
B = experiment.CsamTask('sensor_extension', 2)


@pytest.fixture(scope='module')
def solved():
    return {task: experiment.solve(task) for task in (A, B)}


@pytest.fixture(scope='module')
def gains(solved):
    return {
        task: experiment.gain(solution.truth, solution.maps, solution.joint)
        for task, solution in solved.items()}


def seen_by(robot, scenario):
    """Return the true landmarks that a robot has seen."""
    return {
        scenario.truth.landmark_of[robot][observation.id] for scan in scenario.records
        if isinstance(scan, Scan) and scan.robot == robot for observation in scan.observations}


def matrix(pose):
    """Return a pose as the matrix that takes homogeneous coordinates from it."""
    x, y, phi = pose
    return np.array([
        [math.cos(phi), -math.sin(phi), x], [math.sin(phi), math.cos(phi), y], [0.0, 0.0, 1.0]])


def rated(e, P):
    return e @ np.linalg.inv(P) @ e / len(e)


def test_true_associations_are_the_landmarks_that_both_robots_observed():
    scenario = scene(*B)

    assert experiment.run(B).shared == len(seen_by('p', scenario) & seen_by('q', scenario))


def test_found_associations_are_landmarks_with_ids_of_both_robots(solved, gains):
    numbers = solved[B].joint.landmark_index()
    p, q = (
        {true: numbers[robot, id_] for id_, true in own.items() if (robot, id_) in numbers}
        for robot, own in solved[B].truth.landmark_of.items())

    assert gains[B].found == sum(p[true] == q[true] for true in p.keys() & q.keys()) > 30
    assert gains[B].false == 0


def test_exchanged_ids_are_false_associations(solved, gains):
    met = solved[A]
    landmarks = list(met.joint.landmarks)
    i, j, *_ = (k for k, keys in enumerate(landmarks) if len(keys) == 2)
    (p_i, q_i), (p_j, q_j) = landmarks[i], landmarks[j]
    landmarks[i], landmarks[j] = (p_i, q_j), (p_j, q_i)

    rating = experiment.gain(met.truth, met.maps, replace(met.joint, landmarks=tuple(landmarks)))

    assert (rating.found, rating.false) == (gains[A].found - 2, gains[A].false + 2)


@pytest.mark.parametrize('task', [A, B])
def test_heading_sigmas_are_relative_to_the_start_of_each_robot(solved, gains, task):
    joint = solved[task].joint
    for robot, sigmas in gains[task].joined.items():
        first = joint.first_poses[robot]
        P = joint.information().joint(poses=[first, first + 10, first + len(sigmas) - 1])
        P = P[2::3, 2::3]
        for k, sample in ((1, 10), (2, len(sigmas) - 1)):
            variance = P[k, k] + P[0, 0] - 2.0 * P[k, 0]
            # rounding, of factors of different frames
            assert sigmas[sample] == pytest.approx(math.sqrt(variance), rel=1e-6)
        assert sigmas[0] == 0.0


def test_heading_sigmas_before_joining_are_those_of_the_robots_own_map(solved, gains):
    for local in solved[A].maps:
        P, _ = JointMap.of(local).information().marginals()
        assert_allclose(gains[A].before[local.robot], np.sqrt(P[:, 2, 2]), rtol=1e-9)


def test_q_over_p_compares_both_in_the_frame_of_p(solved, gains):
    joint = solved[B].joint
    P = joint.information().joint(poses=range(len(joint.values.poses)))
    sigmas = np.sqrt(np.diag(P)[2::3])
    half = len(sigmas) // 2

    assert gains[B].q_over_p == pytest.approx(
        sum(sigmas[half + 1:]) / sum(sigmas[1:half]), rel=1e-6)  # rounding


@pytest.mark.parametrize('task', [A, B])
def test_nees_compares_with_ground_truth_in_the_frame_of_the_start_of_p(solved, gains, task):
    truth, joint = solved[task].truth, solved[task].joint
    to_p = np.linalg.inv(matrix(truth.true_poses['p'][0]))
    P, P_points = joint.information().marginals()

    landmarks = [
        rated(joint.values.points[k] - (
            to_p @ [*truth.landmarks[truth.landmark_of[robot][id_]], 1.0])[:2], P_points[k])
        for k, ((robot, id_), *_) in enumerate(joint.landmarks)]
    poses = [
        rated(np.array([
            *(x[:2] - (to_p @ matrix(true))[:2, 2]),
            wrap(x[2] - true[2] + truth.true_poses['p'][0][2])]), P_x)
        for x, true, P_x in zip(
            joint.values.poses, np.vstack([*truth.true_poses.values()]), P) if P_x.any()]
    base = joint.base_nodes(joint.information())['q']
    at = to_p @ matrix(truth.true_poses['q'][0])
    turn = math.atan2(at[1, 0], at[0, 0])
    e = np.array([*(base.pose[:2] - at[:2, 2]), wrap(base.pose[2] - turn)])

    by_hand = {
        'poses': np.mean(poses), 'landmarks': np.mean(landmarks), 'base_node': rated(e, base.P)}
    assert gains[task].nees == pytest.approx(by_hand, rel=1e-6)  # rounding, of an inverse


def test_the_longest_gap_has_fewer_than_two_landmarks_in_view():
    in_view = [3, 2, 1, 2, 1, 0, 1, 2, 4, 0, 0]
    pose = np.repeat(np.arange(len(in_view)), in_view)
    nowhere = np.empty(0, np.intp)
    local = LocalMap(
        'q', Problem(
            OdometryFactors(nowhere, nowhere, np.empty((0, 3)), np.eye(3)),
            LandmarkFactors(pose, np.zeros_like(pose), np.zeros((len(pose), 2)), np.eye(2))),
        Values(np.zeros((len(in_view), 3)), np.zeros((1, 2))), (('q', 1),))

    assert experiment.longest_gap(local) == (3, 7)


def test_maps_that_cannot_be_aligned_have_a_rejection_reason(monkeypatch):
    truth, records = scene(*B)
    _, *later = (record for record in records if isinstance(record, RobotScan))
    stamps = {scan.stamp for scan in later}
    monkeypatch.setattr(experiment, 'scene', lambda *_: Scene(truth, tuple(
        r for r in records if not (isinstance(r, RobotScan) and r.stamp in stamps))))

    result = experiment.run(B)

    assert result.gain is None
    assert result.rejection_reason == 'not enough observations: 1 of the 2 that are needed'


SEEDS = range(1, 6)
MEASURED = Odometry, Scan, RobotScan


def of_robot(scenario, kind, robot):
    return [r for r in scenario.records if isinstance(r, kind) and r.robot == robot]


def sigmas_alone(scenario, robot):
    """Return the standard deviations of the headings [rad] in the map of a robot alone."""
    odometry, scans = (of_robot(scenario, kind, robot) for kind in (Odometry, Scan))
    smoother = IncrementalSmoother(scans[0].observations)
    for before, after, scan in zip(odometry, odometry[1:], scans[1:]):
        smoother.add(
            between(before.pose, after.pose), 0.25 * after.twist_covariance, scan.observations)
    smoother.solve()
    poses, _ = information(smoother.problem(), smoother.values()).marginals()
    return np.sqrt(poses[:, 2, 2])


@pytest.mark.parametrize('name', ['map_joining', 'sensor_extension'])
def test_a_scene_equals_the_simulation_with_the_seed(name):
    simulated = simulation.parse({'environment': name, 'seed': 3}).records()

    assert [fingerprint(r) for r in simulated if isinstance(r, MEASURED)] == [
        fingerprint(r) for r in scene(name, 3).records if isinstance(r, MEASURED)]


#: Heading sigmas of an independent implementation in layouts of its own [mrad].
ALONE = {
    'p': {20: 5.4, 40: 9.1, 55: 33.0, 80: 42.0},
    'q': {20: 5.1, 40: 28.0, 55: 38.0, 80: 38.0}}


@pytest.mark.parametrize('robot', ['p', slow('q')])
def test_heading_sigmas_before_joining_are_those_of_an_independent_implementation(robot):
    sigmas = np.mean([sigmas_alone(scene('map_joining', s), robot) for s in SEEDS], axis=0)

    for sample, published in ALONE[robot].items():
        # A quarter and 1.5 mrad: layouts differ.
        assert 1e3 * sigmas[sample] == pytest.approx(published, rel=0.25, abs=1.5)


@pytest.mark.parametrize(('name', 'share'), [('map_joining', 0.8), ('sensor_extension', 0.3)])
def test_both_robots_observe_a_large_part_of_the_landmarks(name, share):
    for scenario in (scene(name, seed) for seed in SEEDS):
        p, q = (
            {scenario.truth.landmark_of[robot][s.id] for scan in scans for s in scan.observations}
            for robot in 'pq' for scans in [of_robot(scenario, Scan, robot)])
        assert len(p & q) >= share * len(p | q)
