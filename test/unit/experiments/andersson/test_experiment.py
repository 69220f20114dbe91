# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What two robots gain by joining their maps is rated rightly, told plainly, and is enough."""

import csv
from dataclasses import replace
from io import BytesIO, StringIO
import json
import math

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.geometry import wrap
from fej_slam_ros.core.records import RobotScan, Scan
from fej_slam_ros.core.smoothing.least_squares import (
    LandmarkFactors, OdometryFactors, Problem, Values)
from fej_slam_ros.experiments.andersson import experiment, figure, report
from fej_slam_ros.experiments.andersson.scenes import Scene, scene
from fej_slam_ros.experiments.common.executor import in_order, processes

A = experiment.CsamTask('map_joining', 3)
B = experiment.CsamTask('sensor_extension', 2)


@pytest.fixture(scope='module')
def solved():
    return {task: experiment.solve(task) for task in (A, B)}


@pytest.fixture(scope='module')
def gains(solved):
    return {task: experiment.gain(of.truth, of.maps, of.joint) for task, of in solved.items()}


def seen_by(robot, made):
    """Return the true landmarks that a robot has seen."""
    return {
        made.truth.landmark_of[robot][observation.id] for scan in made.records
        if isinstance(scan, Scan) and scan.robot == robot for observation in scan.observations}


def matrix(pose):
    """Return a pose as the matrix that takes homogeneous coordinates from it."""
    x, y, phi = pose
    return np.array([
        [math.cos(phi), -math.sin(phi), x], [math.sin(phi), math.cos(phi), y], [0.0, 0.0, 1.0]])


def rated(e, P):
    return e @ np.linalg.inv(P) @ e / len(e)


def test_true_associations_are_the_landmarks_that_both_robots_saw():
    made = scene(*B)

    assert experiment.run(B).shared == len(seen_by('p', made) & seen_by('q', made))


def test_found_are_the_landmarks_under_which_the_map_has_the_names_of_both_robots(solved, gains):
    numbers = solved[B].joint.landmark_index()
    p, q = (
        {true: numbers[robot, id_] for id_, true in own.items() if (robot, id_) in numbers}
        for robot, own in solved[B].truth.landmark_of.items())

    assert gains[B].found == sum(p[true] == q[true] for true in p.keys() & q.keys()) > 30
    assert gains[B].false == 0


def test_names_that_are_mixed_up_are_false_associations(solved, gains):
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


def test_before_joining_heading_sigmas_are_those_of_the_map_alone(solved, gains):
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
def test_nees_is_that_of_the_truth_seen_from_the_start_of_p(solved, gains, task):
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
    base, at = joint.base_nodes['q'], to_p @ matrix(truth.true_poses['q'][0])
    turn = math.atan2(at[1, 0], at[0, 0])
    e = np.array([*(base.pose[:2] - at[:2, 2]), wrap(base.pose[2] - turn)])

    by_hand = {
        'poses': np.mean(poses), 'landmarks': np.mean(landmarks), 'base_node': rated(e, base.P)}
    assert gains[task].nees == pytest.approx(by_hand, rel=1e-6)  # rounding, of an inverse


def test_a_robot_is_blind_while_it_sees_fewer_than_two_landmarks():
    in_view = [3, 2, 1, 2, 1, 0, 1, 2, 4, 0, 0]
    pose = np.repeat(np.arange(len(in_view)), in_view)
    nowhere = np.empty(0, np.intp)
    local = LocalMap(
        'q', Problem(
            OdometryFactors(nowhere, nowhere, np.empty((0, 3)), np.eye(3)),
            LandmarkFactors(pose, np.zeros_like(pose), np.zeros((len(pose), 2)), np.eye(2))),
        Values(np.zeros((len(in_view), 3)), np.zeros((1, 2))), (('q', 1),))

    assert experiment.blind(local) == (3, 7)


def test_maps_that_cannot_be_aligned_are_told_with_the_reason(monkeypatch):
    truth, records = scene(*B)
    _, *later = (record for record in records if isinstance(record, RobotScan))
    stamps = {scan.stamp for scan in later}
    monkeypatch.setattr(experiment, 'scene', lambda *_: Scene(truth, tuple(
        r for r in records if not (isinstance(r, RobotScan) and r.stamp in stamps))))

    result = experiment.run(B)

    assert result.gain is None
    assert result.rejection_reason == 'not enough observations: 1 of the 2 that are needed'


def gain(**changes):
    """Return what a run may have gained, with numbers that are easy to reckon with."""
    before = {robot: np.arange(101.0) for robot in 'pq'}
    joined = {'p': 0.5 * before['p'], 'q': np.minimum(before['q'], 50.0)}
    return replace(experiment.Gain(
        9, 0, {'poses': 1.0, 'landmarks': 0.9, 'base_node': 1.1}, 1.01, before, joined, 1.25,
        (40, 60)), **changes)


def made_up(task, of, rejection_reason=''):
    sizes = {'p': {'subset': 30, 'log': 20, 'map': 90}, 'q': {'subset': 10, 'log': 20, 'map': 90}}
    return experiment.CsamRun(task, 10, sizes, of, rejection_reason)


@pytest.fixture
def runs():
    """Return runs that were made up: two of A, of which one is not joined, and one of B."""
    return [
        made_up(A, gain(false=1, nees={'poses': 2.0, 'landmarks': 1.0, 'base_node': 1.0})),
        made_up(A._replace(seed=4), None, 'cannot align: test'), made_up(B, gain())]


def test_entries_are_over_all_runs_and_say_what_is_held(runs):
    made = report.entries(runs[:2])

    assert {name: entry.value for name, entry in made.items()} == pytest.approx({
        'joined': 50.0, 'found': 45.0, 'false': 10.0, 'touched': 50.0, 'nees_poses': 2.0,
        'nees_landmarks': 1.0, 'nees_base_node': 1.0, 'chi_square': 1.01, 'ratio_p': 0.5,
        'ratio_q': (sum(range(51)) + 50 * 50.0) / 5050.0, 'by_sample_p': 0.5,
        'by_sample_q': (50.0 + sum(50.0 / k for k in range(51, 101))) / 100.0,
        'not_worse_p': 100.0, 'not_worse_q': 100.0, 'worst_p': 0.5, 'worst_q': 1.0,
        'big_step': 0.5}, rel=1e-12)
    assert [name for name, entry in made.items() if entry.is_held is False] == [
        'found', 'false', 'touched', 'nees_poses', 'ratio_q']
    assert report.entries(runs[2:])['q_over_p'].is_held is False


def test_runs_of_which_none_was_joined_have_found_nothing(runs):
    made = report.entries(runs[1:2])

    assert {name: entry.value for name, entry in made.items()} == {
        'joined': 0.0, 'found': 0.0, 'false': 0.0, 'touched': 0.0}
    assert 'Seed 4 was not joined' in report.markdown(runs[1:2])


def test_the_page_says_what_is_asked_what_was_reached_and_in_which_frame(runs):
    text = report.markdown(runs)

    assert '| NEES/3 of joined poses | 0.85 to 1.17 | 2.000 | **not held** |' in text
    assert '| true associations found [%] | at least 98.5 | 45.00 | **not held** |' in text
    assert "| Q's big step, joined / before | at most 0.6 | 0.500 | held |" in text
    assert "Q's heading sigma / P's, in P's frame | at most 1.2 | 1.250 | **not held** |" in text
    assert 'Seed 4 was not joined: cannot align: test.' in text
    assert '| P | 30 | 20 | 90 | log |\n| Q | 10 | 20 | 90 | subset |' in text
    assert '| Q | 20000.0 -> 20000.0 | 40000.0 -> 40000.0 | 55000.0 -> 50000.0 |' in text
    assert 'in the frame of **its own\nstart**' in text


def test_there_is_a_row_for_each_run(runs):
    file = StringIO()
    csv.writer(file).writerows(report.csv_rows(runs))
    file.seek(0)

    first, second, third = csv.DictReader(file)

    assert [first[name] for name in ('seed', 'shared', 'found', 'false')] == ['3', '10', '9', '1']
    assert (float(first['big_step']), first['q_over_p'], first['subset_q']) == (0.5, '', '10')
    assert (second['refusal'], second['found']) == ('cannot align: test', '')
    assert (third['experiment'], third['big_step'], third['q_over_p']) == (
        'sensor_extension', '', '1.25')


def test_the_summary_is_json(runs):
    told = json.loads(json.dumps(report.summary(runs), allow_nan=False))

    assert told['map_joining']['entries']['found'] == {
        'value': 45.0, 'asked': [98.5, None], 'held': False}
    assert told['map_joining']['not_joined'] == {'4': 'cannot align: test'}
    assert told['sensor_extension']['bytes']['q'] == {'subset': 10.0, 'log': 20.0, 'map': 90.0}


def test_the_figure_is_a_png(solved):
    picture = BytesIO()

    figure.draw(picture, solved[A], solved[A].joint)

    assert picture.getvalue().startswith(b'\x89PNG')


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('experiment', experiment.EXPERIMENTS)
def test_over_100_runs_all_is_held_that_is_asked(experiment):
    with processes(2) as workers:
        runs = [*in_order(workers, experiment.run, [experiment.CsamTask(experiment, k) for k in range(1, 101)])]

    missed = {n: e for n, e in report.entries(runs).items() if e.is_held is False}
    assert not missed
    assert all(run.gain is not None for run in runs)
