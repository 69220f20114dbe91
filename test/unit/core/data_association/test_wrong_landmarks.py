# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of moved landmarks and of those of lost robots, without false alarms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.data_association.wrong_landmarks import (
    note_accepted, remove_started, remove_untrusted, report_moved)
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, GatedObservation
from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NS, Observation, Scan, TrueLandmarks
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings
from helpers.core import estimate
from helpers.moved_landmarks import drive, SECOND_LOOP, SHIFT, with_moved

TEAM = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1')


def place(records, number):
    """Return the true position of a landmark before it is moved."""
    return next(r for r in records if isinstance(r, TrueLandmarks)).positions[number]


def rejected(estimator, reason):
    """Return how many observations were rejected for a reason, and of which landmarks."""
    return estimator.statistics.total(reason), {
        r.id for r in estimator.statistics.rejections if r.reason is reason}


@pytest.mark.parametrize(('seed', 'number'), [(1, 5), (2, 12), (3, 20)])
def test_report_keeps_a_moved_landmark_in_the_map(seed, number):
    records = drive(seed)

    estimator, _ = estimate(with_moved(records, number, SECOND_LOOP))

    count, numbers = rejected(estimator, RejectionReason.MOVED_LANDMARK)
    assert estimator.groups.moved_landmarks() == [('', number)]
    assert (count > 5, numbers) == (True, {number})
    x = estimator.groups.team.state.estimate(estimator.groups.team.state.landmarks['', number])
    assert np.linalg.norm(x - place(records, number)) < 0.3


@pytest.mark.parametrize(('seed', 'number'), [(1, 5), (2, 12), (3, 20)])
def test_forget_restarts_a_moved_landmark_at_its_new_position(seed, number):
    records = drive(seed)

    estimator, _ = estimate(with_moved(records, number, SECOND_LOOP), moved_landmarks='forget')

    count, numbers = rejected(estimator, RejectionReason.MOVED_LANDMARK)
    # Both robots may see it at the stamp at which it is forgotten.
    assert (count <= 2, numbers) == (True, {number})
    assert estimator.groups.moved_landmarks() == []
    x = estimator.groups.team.state.estimate(estimator.groups.team.state.landmarks['', number])
    assert np.linalg.norm(x - place(records, number) - SHIFT) < 0.3


@pytest.mark.parametrize('policy', ['report', 'ignore'])
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_landmark_started_by_a_misread_id_is_started_again(seed, policy):
    records = drive(seed)
    firsts = {}
    for r in records:
        if isinstance(r, Scan):
            for s in r.observations:
                firsts.setdefault(s.id, r)
    number, first = max(firsts.items(), key=lambda item: item[1].stamp)
    # One of another landmark, a second before.
    misread = next(
        r for r in records if isinstance(r, Scan) and r.robot == first.robot and r.observations
        and r.stamp >= first.stamp - NS)
    wrong = replace(misread, observations=(
        *misread.observations[1:], replace(misread.observations[0], id=number)))

    estimator, _ = estimate(
        [wrong if r is misread else r for r in records], moved_landmarks=policy)

    team = estimator.groups.team.state
    x = team.estimate(team.landmarks['', number])
    assert np.linalg.norm(x - place(records, number)) < 0.3
    # The misread one and the correct one that contradicts it.
    of_landmark = [
        r.stamp for r in estimator.statistics.rejections
        if r.reason is RejectionReason.GATED and r.id == number]
    assert sorted(of_landmark)[:2] == [misread.stamp, first.stamp]
    assert len(of_landmark) <= 4  # one in a thousand correct ones


def test_ignore_only_gates_a_moved_landmark():
    estimator, _ = estimate(with_moved(drive(1), 5, SECOND_LOOP), moved_landmarks='ignore')
    reporting, _ = estimate(with_moved(drive(1), 5, SECOND_LOOP))

    assert rejected(estimator, RejectionReason.MOVED_LANDMARK) == (0, set())
    assert estimator.state_hash() == reporting.state_hash()
    assert rejected(estimator, RejectionReason.GATED)[0] == sum(
        rejected(reporting, reason)[0]
        for reason in (RejectionReason.GATED, RejectionReason.MOVED_LANDMARK))


def test_a_landmark_moved_back_is_no_longer_reported():
    records = drive(1)
    stamps = [
        r.stamp for r in records if isinstance(r, Scan) and any(s.id == 5 for s in r.observations)]
    gone, back = stamps[len(stamps) // 3], stamps[len(stamps) // 3 * 2]

    away = with_moved(records, 5, gone)
    estimator, _ = estimate([a if r.stamp < back else r for a, r in zip(away, records)])

    assert rejected(estimator, RejectionReason.MOVED_LANDMARK)[1] == {5}
    assert estimator.groups.moved_landmarks() == []


def test_a_landmark_moved_after_ignore_was_switched_off_is_reported():
    estimator, is_switched = Estimator(replace(TEAM, moved_landmarks='ignore')), False

    # Landmark 11 is older than those around it, so that only its latest observation shows that
    # they were right when it still was.
    for record in with_moved(drive(2), 11, SECOND_LOOP):
        if not is_switched and record.stamp >= SECOND_LOOP:
            estimator.change_team(TEAM.robots, TEAM)
            is_switched = True
        estimator.add(record)
        list(estimator.take())

    assert estimator.groups.moved_landmarks() == [('', 11)]


def is_doubted(others, d2=50.0):
    """
    Return whether a scan speaks against a landmark that was started at 10 ns.

    The others are given by when they were started and whether they pass the gate.
    """
    state = JointState()
    robot = state.insert_robot('r1', 10, np.zeros(3), np.eye(3))
    seen = []
    for number, (started, _) in enumerate([(10, False), *others]):
        robot.stamp = started
        landmark = state.augment(('', number), robot, np.ones(2), np.eye(2, 3), np.eye(2))
        seen.append(Association(robot, landmark, Observation(number, np.ones(2), np.eye(2))))
    used = [a for a, (_, passed) in zip(seen[1:], others) if passed]
    gated = [GatedObservation(a, d2, 13.8) for a in seen if a not in used]

    innovation = Innovation(used, np.zeros(2 * len(used)), gated, ())
    report_moved(state, innovation, innovation.scan_gate_statistics())

    return seen[0].observed.moved_evidence is not None


@pytest.mark.parametrize(('others', 'doubted'), [
    ([(0, True), (10, True)], True),
    ([(0, True), (10, True), (0, False)], True),
    ([(0, True)], False),
    ([(0, True), (0, False)], False),
    ([(0, True), (0, True), (0, False), (0, False)], False),
    # What was started later may be as wrong as the robot.
    ([(20, True), (20, True)], False),
    ([(0, True), (0, False), (20, True), (20, True)], False)])
def test_a_landmark_is_suspected_if_most_others_of_its_scan_pass(others, doubted):
    assert is_doubted(others) == doubted


@pytest.mark.parametrize(('probability', 'doubted'), [(1e-8, False), (1e-10, True)])
def test_a_landmark_is_suspected_only_far_beyond_the_gate(probability, doubted):
    assert is_doubted([(0, True), (0, True)], chi2.isf(probability, 2)) == doubted


@pytest.mark.parametrize(('times', 'robots', 'step', 'certain'), [
    (9, 1, 1.0, False), (10, 1, 0.25, True), (10, 1, 0.2, False), (100, 1, 0.0, False),
    (10, 2, 0.0, True)])
def test_a_landmark_counts_as_moved_after_ten_observations_from_apart_or_by_two_robots(
        times, robots, step, certain):
    evidence = MovedLandmarkEvidence()

    for k in range(times):
        evidence.add(f'r{k % robots}', np.array([7.0, -step * k]))

    assert evidence.is_sufficient() == certain


def robots_and_landmarks(*owners):
    """Return r1, r2 and landmarks of owners, of which only the first two are trusted."""
    state = JointState()
    robots = {name: state.insert_robot(name, 10, np.zeros(3), np.eye(3)) for name in ('r1', 'r2')}
    landmarks = []
    for number, owner in enumerate(owners):
        robots[owner].stamp = 10 if number < 2 else 20
        landmarks.append(state.augment(
            ('', number), robots[owner], np.ones(2), np.eye(2, 3), np.eye(2), number < 2))
    return state, robots, landmarks


def see(state, stamp, robot, landmarks, failed=()):
    """Account for a scan of landmarks, of which some failed the gate."""
    associations = [Association(robot, f, Observation(f.key[1], np.ones(2), np.eye(2)))
                    for f in landmarks]
    innovation = Innovation(
        [a for a in associations if a.observed not in failed], np.empty(0),
        [GatedObservation(a, 50.0, 13.8) for a in associations if a.observed in failed])
    statistics = innovation.scan_gate_statistics()
    note_accepted(innovation, statistics)
    remove_started(state, statistics, stamp)


def test_landmarks_are_trusted_once_trusted_ones_confirm_a_scan_of_them():
    state, robots, landmarks = robots_and_landmarks('r1', 'r2', 'r1', 'r1', 'r1')
    assert [f.is_trusted for f in landmarks] == [True, True, False, False, False]

    # A scan of one trusted landmark does not confirm the pose.
    see(state, 30, robots['r1'], landmarks[1:3])
    assert not landmarks[2].is_trusted
    see(state, 30, robots['r1'], landmarks[:4])

    assert [f.is_trusted for f in landmarks] == [True, True, True, True, False]


def test_landmarks_of_a_lost_robot_are_removed_unless_others_confirm_them():
    state, robots, landmarks = robots_and_landmarks('r1', 'r2', 'r1', 'r2', 'r1')
    see(state, 30, robots['r2'], landmarks[:3])

    remove_untrusted(state, 'r1')

    assert [*state.landmarks.values()] == landmarks[:4]


def test_landmarks_started_by_a_failed_scan_are_removed_at_once():
    state, robots, landmarks = robots_and_landmarks('r1', 'r1', 'r2', 'r1', 'r1')

    see(state, 20, robots['r1'], [*landmarks[:2], landmarks[3]], failed=landmarks[:2])

    # That of r2 has the same stamp.
    assert [*state.landmarks.values()] == landmarks[:3]
