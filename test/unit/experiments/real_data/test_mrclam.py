# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results on five real robots, and an exact result on a set without noise."""

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.real_data import mrclam
from helpers.mrclam import write_set


def circling(robot, x, y):
    """Return the files of a robot that goes round a circle of 1 m in 60 s, and what it sees."""
    t = np.arange(0.0, 60.0, 0.01)
    w = 2.0 * np.pi / 60.0
    pose = np.column_stack([x + np.sin(w * t), y - np.cos(w * t), w * t])
    seen = [
        (100.0 + t[k], code, np.hypot(*z), np.arctan2(z[1], z[0]))
        for k in range(0, len(t), 500) for code, point in ((7, (2.0, 1.0)), (16, (3.0, -1.0)))
        for z in [between(pose[k], np.array([*point, 0.0]))[:2]]]
    return {
        f'Robot{robot}_Odometry': [(100.0 + s, w, w) for s in t],
        f'Robot{robot}_Groundtruth': [(100.0 + s, *p) for s, p in zip(t, pose)],
        f'Robot{robot}_Measurement': seen}


@pytest.mark.slow
@pytest.mark.parametrize('filter_', ['fej', mrclam.LEAST_SQUARES])
def test_measurements_without_noise_give_the_true_poses(tmp_path, filter_):
    write_set(tmp_path, {**circling(1, 0.0, 0.0), **circling(2, 1.0, 0.5)})

    run = mrclam.run(mrclam.MrclamTask(tmp_path, filter_, robots_seen=True))

    # Delay and scale are measured to 1e-3 s and of w = 0.1 rad/s.
    assert run.position < 1e-2
    assert run.fitted_position <= run.position
    assert (run.landmarks, run.true_landmarks) == (2, 3)
    assert run.in_map['r1'] == 1.0
    if filter_ == 'fej':
        assert run.dead_reckoning['r1'] < 1e-2


def test_a_set_without_ground_truth_is_rejected(tmp_path):
    write_set(tmp_path, {'Robot1_Odometry': [(100.0, 0.0, 0.0), (101.0, 0.0, 0.0)]})

    with pytest.raises(UserError, match='no ground truth of r1'):
        mrclam.run(mrclam.MrclamTask(tmp_path, 'fej', robots_seen=True))


@pytest.mark.parametrize(('files', 'lack'), [
    ({'Robot1_Groundtruth': [(500.0, 0.0, 0.0, 0.0)]}, 'no ground truth of r1'),
    ({'Robot1_Measurement': []}, 'no known landmark that is observed twice')])
def test_a_set_with_too_little_data_to_evaluate_is_rejected(tmp_path, files, lack):
    write_set(tmp_path, {**circling(1, 0.0, 0.0), **files})

    with pytest.raises(UserError, match=lack):
        mrclam.run(mrclam.MrclamTask(tmp_path, 'fej', robots_seen=True))


def test_a_folder_of_sets_gives_those_that_can_be_evaluated(tmp_path):
    write_set(tmp_path / 'a', circling(1, 0.0, 0.0))
    write_set(tmp_path / 'b', {'Robot1_Groundtruth': [(100.0, 0.0, 0.0, 0.0)]})
    (tmp_path / 'notes').mkdir()

    usable, refused = mrclam.sets(tmp_path)

    assert usable == [tmp_path / 'a']
    assert refused.keys() == {'b'}
    assert 'holds no odometry of any robot' in refused['b']
    assert [(task.name, task.filter, task.robots_seen) for task in mrclam.tasks(usable)] == [
        ('a', name, used) for used in (True, False)
        for name in ('standard', 'fej', 'invariant', 'least squares')]


def test_a_folder_without_any_usable_set_is_rejected_with_all_reasons(tmp_path):
    write_set(tmp_path / 'a', {'Robot1_Odometry': [(100.0, 0.0, 0.0), (101.0, 0.0, 0.0)]})
    write_set(tmp_path / 'b', {})

    with pytest.raises(UserError, match=r'no ground truth of r1.*; .*no odometry of any robot'):
        mrclam.sets(tmp_path)


@pytest.mark.slow
def test_robots_without_ground_truth_take_part_and_are_not_evaluated(tmp_path):
    unknown = circling(2, 1.0, 0.5)
    del unknown['Robot2_Groundtruth']
    write_set(tmp_path, {**circling(1, 0.0, 0.0), **unknown})

    run = mrclam.run(mrclam.MrclamTask(tmp_path, 'fej', robots_seen=True))

    assert run.of_robots.keys() == {'r1'}
    assert run.position < 1e-2


@pytest.mark.slow
def test_five_real_robots_are_localized_as_by_least_squares_with_known_starts(data):
    run = mrclam.run(mrclam.MrclamTask(data / 'mrclam_6', 'fej', robots_seen=True))

    # That of the data's README has 0.076 m and 0.059 m; 1.3 times as much is the requirement.
    assert run.fitted_position < 1.3 * 0.076
    assert run.landmark_rmse < 0.059
    assert 0.6 < run.nees < 1.6
    assert (run.landmarks, run.true_landmarks) == (15, 15)
    assert min(run.in_map.values()) > 0.9
