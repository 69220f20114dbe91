# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The anchor of a run is the robot that determines the frame of the ground truth best."""

import math

import numpy as np
import pytest

from fej_slam_ros.datasets.mrclam.files import read
from fej_slam_ros.datasets.mrclam.run_settings import settings, with_known_anchor
from helpers.mrclam import EXACT, STRAIGHT, write_set

ALSO_ROBOT_2 = {name.replace('1', '2'): rows for name, rows in STRAIGHT.items()}


def test_the_robot_with_a_known_start_is_the_anchor(tmp_path):
    # Ground truth begins two seconds late: until then the robot drives 0.2 m ahead, along -y.
    truth = [(102.0, 5.0, 1.0, -math.pi / 2), (103.0, 5.0, 0.9, -math.pi / 2)]
    data = read(write_set(tmp_path, {
        **STRAIGHT, **ALSO_ROBOT_2, 'Robot2_Groundtruth': truth}))

    chosen = settings(data, EXACT)

    assert [(r.name, r.id, r.start_pose) for r in chosen.robots] == [
        ('r1', 1, None), ('r2', 2, None)]
    assert chosen.anchor == 'r2'
    np.testing.assert_allclose(chosen.anchor_pose, [5.0, 1.2, -math.pi / 2], atol=1e-6)
    # 0.2 m at 0.006 rad^2 per metre are 0.035 rad, motion capture adds 0.01, the camera 0.02 rad.
    assert chosen.anchor_sigma[2] == pytest.approx(math.hypot(0.035, 0.01, 0.02), abs=0.001)
    assert min(chosen.anchor_sigma) > 0.01
    # The robot faces -y, so its motion is not along x.
    assert chosen.anchor_sigma[1] >= chosen.anchor_sigma[0]


def test_the_robot_whose_start_determines_the_frame_best_is_the_anchor(tmp_path):
    """Until robot 1 observes a landmark it turns by 4 rad; robot 2 observes one at once."""
    truth = [(100.0 + k, 5.0, 1.0, 0.0) for k in range(11)]
    both = {
        **STRAIGHT, **ALSO_ROBOT_2, 'Robot1_Groundtruth': truth, 'Robot2_Groundtruth': truth}
    turning = [(100.0 + k, 0.1, 0.5) for k in range(11)]
    late = {'Robot1_Odometry': turning, 'Robot1_Measurement': [(109.0, 7, 1.5, 0.7)]}

    chosen = [
        settings(read(write_set(tmp_path / name, {**both, **changes})), EXACT).anchor
        for name, changes in {'equal': {}, 'late': late}.items()]

    assert chosen == ['r1', 'r2']


@pytest.mark.parametrize(('later', 'anchor'), [(50.0, 'r1'), (80.0, 'r2')])
def test_a_robot_for_which_the_others_would_wait_more_than_a_minute_is_not_the_anchor(
        tmp_path, later, anchor):
    """Robot 1 begins later, and observes thirty times as often, which determines the frame."""
    truth = [(100.0 + k, 5.0, 1.0, 0.0) for k in range(11)]
    at_rest = [(100.0 + k, 0.0, 0.0) for k in range(11)]
    first = {
        'Odometry': at_rest, 'Measurement': [(101.0 + k / 5, 7, 2.0, 0.5) for k in range(30)],
        'Groundtruth': truth}
    second = {**first, 'Measurement': [(101.0, 7, 2.0, 0.5)]}
    of_both = {
        **{f'Robot1_{k}': [(t + later, *row) for t, *row in rows] for k, rows in first.items()},
        **{f'Robot2_{k}': rows for k, rows in second.items()}}

    chosen = settings(read(write_set(tmp_path, {**STRAIGHT, **of_both})), EXACT)

    assert chosen.anchor == anchor


def test_a_robot_that_observes_no_landmark_is_not_the_anchor(tmp_path):
    truth = [(100.0 + k, 5.0, 1.0, 0.0) for k in range(11)]
    data = read(write_set(tmp_path, {
        **STRAIGHT, **ALSO_ROBOT_2, 'Robot1_Groundtruth': truth, 'Robot2_Groundtruth': truth,
        'Robot1_Measurement': [(101.0, 14, 2.0, 0.5), (99.0, 7, 2.0, 0.5)]}))

    assert settings(data, EXACT).anchor == 'r2'


def test_a_robot_that_turns_much_before_its_first_true_pose_is_not_the_anchor(tmp_path):
    truth = [(100.0 + k, 5.0, 1.0, 0.0) for k in range(11)]
    data = read(write_set(tmp_path, {
        **STRAIGHT, **ALSO_ROBOT_2, 'Robot1_Odometry': [(100.0 + k, 0.1, 0.3) for k in range(11)],
        'Robot1_Groundtruth': truth[5:], 'Robot2_Groundtruth': truth}))

    assert settings(data, EXACT).anchor == 'r2'


def test_a_robot_whose_odometry_turns_away_from_its_true_headings_is_not_the_anchor(tmp_path):
    """Robot 1 slips by 0.5 rad on a straight way of a metre, for which 0.06 rad are expected."""
    truth = [(100.0 + k, 5.0, 1.0, 0.0) for k in range(11)]
    slipping = [(t, x, y, 0.0 if t < 103.0 else 0.5) for t, x, y, _ in truth]
    both = {**STRAIGHT, **ALSO_ROBOT_2, 'Robot2_Groundtruth': truth}

    chosen = [
        settings(read(write_set(tmp_path / name, {**both, 'Robot1_Groundtruth': rows})), EXACT)
        for name, rows in {'true': truth, 'slip': slipping}.items()]

    assert [of_run.anchor for of_run in chosen] == ['r1', 'r2']


def test_an_anchor_that_turns_much_before_its_first_true_pose_begins_there(tmp_path):
    # It turns by 20 rad until then, and commands are 5 % larger than the motion.
    data = read(write_set(tmp_path, {
        **STRAIGHT, 'Robot1_Odometry': [(100.0 + k / 8, 0.2, 1.0) for k in range(200)],
        'Robot1_Groundtruth': [(120.06, 5.0, 1.0, 2.0), (122.0, 5.1, 1.1, -2.4)]}))

    kept = with_known_anchor(data, EXACT)

    chosen = settings(kept, EXACT)
    # It begins with the command at 120 s, which turns it by 0.06 rad and moves it by 1.2 cm.
    np.testing.assert_allclose(chosen.anchor_pose, [5.0, 1.0, 1.94], atol=0.0125)
    assert chosen.anchor_pose[2] == pytest.approx(1.94, abs=1e-6)
    assert max(chosen.anchor_sigma) < 0.05
    assert kept.logs[1].counts['command before the first true pose'] == 160
    assert len(kept.logs[1].commands) == 40


def test_an_anchor_with_a_well_known_start_keeps_all_its_commands(tmp_path):
    truth = [(102.0, 5.0, 1.0, -math.pi / 2), (103.0, 5.0, 0.9, -math.pi / 2)]
    data = read(write_set(tmp_path, {**STRAIGHT, 'Robot1_Groundtruth': truth}))

    assert with_known_anchor(data, EXACT) is data


def test_starts_of_all_robots_are_given_on_request(tmp_path):
    truth = [(100.0 + k, 5.0, 1.0 + 0.1 * k, math.pi / 2) for k in range(11)]
    data = read(write_set(tmp_path, {
        **STRAIGHT, 'Robot1_Groundtruth': truth, 'Robot2_Groundtruth': truth,
        'Robot2_Odometry': STRAIGHT['Robot1_Odometry'],
        'Robot3_Odometry': [(100, 0, 0), (101, 0, 0)]}))

    chosen = settings(data, EXACT, known_starts=True)

    assert [robot.start_pose for robot in chosen.robots] == [None, (5.0, 1.0, 1.570796), None]
    assert chosen.robots[1].start_sigma == (0.005, 0.005, 0.01)


def test_without_ground_truth_the_first_robot_starts_at_the_origin(tmp_path):
    chosen = settings(read(write_set(tmp_path, STRAIGHT)), EXACT)

    assert (chosen.anchor, chosen.anchor_pose, chosen.anchor_sigma) == ('r1', (0, 0, 0), (0, 0, 0))


def test_the_estimator_waits_as_long_as_commands_are_trusted(tmp_path):
    chosen = settings(read(write_set(tmp_path, STRAIGHT)), EXACT)

    # The longest gaps of the published sets are 1.4 s long.
    assert chosen.stale_after > 1.4
