# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log is read exactly; its two robots are those of the paper, to every digit."""

from itertools import pairwise
import math

import numpy as np
import pytest
from scipy.io import savemat

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, wrap_all
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.datasets.victoria_park.associated_log import (
    CAR_TEAMS, CarTeam, divide, find, read, records, settings)
from fej_slam_ros.errors import UserError

#: A drive that was made up: [from, to, x, y, phi] and [pose, id, x, y], poses not in order.
STEPS = np.array([
    [0, 1, 1.0, 0.0, math.pi / 2], [1, 2, 2.0, 0.5, 0.0], [2, 3, 1.0, 0.0, -math.pi / 2]])
OBSERVATIONS = np.array([
    [2, 4, 7.0, -8.0], [0, 9, 1.0, 2.0], [0, 4, 3.0, 4.0], [1, 5, 5.0, -6.0]])


def zstate():
    """Return [value, type, to-pose or id, from-pose], a row for each coordinate."""
    of_steps = [(value, 1, end, begin) for begin, end, *u in STEPS for value in u]
    of_observations = [(value, 2, id_, pose) for pose, id_, *z in OBSERVATIONS for value in z]
    return {'Zstate': np.array(of_observations[:4] + of_steps + of_observations[4:])}


def clean_data(steps=STEPS, observations=OBSERVATIONS):
    """Return [1, step, 6 of its covariance] and [0, observation, 3 of its covariance, 4 zeros]."""
    of_steps = [(1, *step, *[0.01] * 6) for step in steps]
    of_observations = [(0, *observation, *[0.01] * 3, *[0.0] * 4) for observation in observations]
    return {'VicPark_clean_data': np.array(of_observations[:2] + of_steps + of_observations[2:])}


def changed(array, row, column, value):
    array = array.copy()
    array[row, column] = value
    return array


def rows_of(log):
    return [[pose, s.id, *s.z] for pose, seen in enumerate(log.observations) for s in seen]


@pytest.fixture
def file(tmp_path):
    """Return a function that writes variables as a MATLAB file."""

    def write(variables, name='log.mat'):
        savemat(tmp_path / name, variables)
        return tmp_path / name

    return write


@pytest.mark.parametrize('form', [zstate, clean_data])
def test_either_format_gives_increments_and_observations_by_pose_and_id(file, form):
    log = read(file(form()))

    assert log.increments.tolist() == STEPS[:, 2:].tolist()
    assert rows_of(log) == [[0, 4, 3, 4], [0, 9, 1, 2], [1, 5, 5, -6], [2, 4, 7, -8]]


def test_odometry_is_the_composition_of_the_increments(file):
    poses = [r.pose for r in records({'r1': read(file(zstate()))}) if isinstance(r, Odometry)]

    by_hand = [[0, 0, 0], [1, 0, math.pi / 2], [0.5, 2, math.pi / 2], [0.5, 3, 0]]
    np.testing.assert_allclose(poses, by_hand, atol=1e-15)  # rounding of sines


def test_all_robots_start_together_and_step_by_fifths_of_a_second(file):
    team = CarTeam({'r1': (0, 1), 'r2': (2, 3)})

    found = list(records(divide(read(file(zstate())), team)))

    # No observation of pose 3 means that there was no scan, not that there was nothing to see.
    assert [(type(r), r.robot, (r.stamp - found[0].stamp) / 1e9) for r in found] == [
        (Odometry, 'r1', 0.0), (Scan, 'r1', 0.0), (Odometry, 'r2', 0.0), (Scan, 'r2', 0.0),
        (Odometry, 'r1', 0.2), (Scan, 'r1', 0.2), (Odometry, 'r2', 0.2)]


def test_a_robot_has_only_the_measurements_of_its_own_part(file):
    parts = divide(read(file(zstate())), CarTeam({'r1': (0, 1), 'r2': (2, 3)}))

    assert parts['r1'].increments.tolist() == STEPS[:1, 2:].tolist()
    assert parts['r2'].increments.tolist() == STEPS[2:, 2:].tolist()
    assert rows_of(parts['r2']) == [[0, 4, 7, -8]]


def test_the_noise_is_that_of_the_paper(file):
    found = list(records({'r1': read(file(clean_data()))}))
    first, second = [r for r in found if isinstance(r, Odometry)][:2]

    assert first.twist_covariance is None
    np.testing.assert_allclose(
        np.sqrt(np.diag(second.twist_covariance)) * 0.2, [0.075, 0.075, 0.015 * math.pi])
    assert all(
        s.R.tolist() == [[0.075**2, 0], [0, 0.075**2]]
        for r in found if isinstance(r, Scan) for s in r.observations)


def test_one_robot_starts_at_the_origin_and_drives_the_whole_log(file):
    log = read(file(zstate()))

    one = settings(CAR_TEAMS[1])

    assert divide(log, CAR_TEAMS[1])['r1'].increments.tolist() == log.increments.tolist()
    assert (one.anchor_pose, one.anchor_sigma) == ((0, 0, 0), (0, 0, 0))


def test_two_robots_run_as_in_the_paper():
    two = settings(CAR_TEAMS[2])

    assert [(robot.name, robot.id, robot.start_pose) for robot in two.robots] == [
        ('r1', 1, None), ('r2', 2, None)]
    assert two.anchor == 'r1'
    assert two.anchor_pose == (65.0492, 7.7931, 3.3150 - 2 * math.pi)
    assert two.anchor_sigma == (0.005, 0.005, 0.005 * math.pi)
    assert (two.filter, two.gate_probability) == ('fej', 1.0)
    assert two.start_covariance == 'independent'


def test_the_file_of_the_papers_authors_is_preferred(file):
    other = file(clean_data(), 'VicPark_clean_data.mat')
    assert find(other.parent) == other

    authors = file(zstate(), 'Zstate_VicPark_6898_loops.mat')

    assert find(other.parent) == authors


def test_a_folder_without_the_data_is_rejected_with_the_names_of_the_files(tmp_path):
    with pytest.raises(UserError, match='holds no associated Victoria Park data: put Zstate_'):
        find(tmp_path)
    with pytest.raises(UserError, match=r'no folder .*nowhere: give the one with'):
        find(tmp_path / 'nowhere')


@pytest.mark.parametrize(('variables', 'reason'), [
    ({'X': STEPS}, 'neither of the variables Zstate and VicPark_clean_data is in it'),
    ({'Zstate': np.zeros((5, 3))}, 'Zstate is not a matrix of 4 columns'),
    ({'Zstate': 'text'}, 'Zstate is not a matrix of 4 columns'),
    ({'VicPark_clean_data': np.zeros(12)[:, None]}, 'is not a matrix of 12 columns'),
    ({'Zstate': zstate()['Zstate'][:-1]}, '7 rows are no multiple of 2 coordinates'),
    ({'Zstate': zstate()['Zstate'][[0, 2, 1, *range(3, 17)]]}, 'rows that belong together name'),
    ({'Zstate': changed(zstate()['Zstate'], 0, 1, 3.0)}, 'column 2 holds something other'),
    ({'Zstate': zstate()['Zstate'][:4]}, 'no steps or no observations'),
    (clean_data(steps=STEPS[1:]), 'the steps do not lead from pose 0 to 1'),
    (clean_data(steps=STEPS[[0, 2, 1]]), 'the steps do not lead from pose 0 to 1'),
    (clean_data(steps=changed(STEPS, 0, 2, np.nan)), 'a value is not finite'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 2, np.inf)), 'a value is not finite'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 0, 4.0)), 'none of the poses 0 to 3'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 0, 0.5)), 'none of the poses 0 to 3'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 1, -1.0)), 'an id that is not an integer'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 1, 2.0**31)), 'an id that is not an integ'),
    (clean_data(observations=changed(OBSERVATIONS, 0, 1, 4.5)), 'an id that is not an integer'),
    (clean_data(observations=changed(OBSERVATIONS, 2, 1, 9.0)), 'observes one landmark twice'),
])
def test_a_foreign_or_damaged_file_is_rejected_with_the_reason(file, variables, reason):
    with pytest.raises(UserError, match=rf'log.mat: .*{reason}.*; fetch the file again$'):
        read(file(variables))


@pytest.mark.parametrize('length', [0, 1, 60, 130, 200, 500])
def test_a_truncated_file_is_rejected(file, length):
    path = file(zstate())
    path.write_bytes(path.read_bytes()[:length])

    with pytest.raises(UserError, match='cannot be read as a MATLAB file'):
        read(path)


def test_a_log_too_short_for_the_team_is_rejected(file):
    with pytest.raises(UserError, match='ends at pose 3, but robot r1 needs poses 719 to 3264'):
        divide(read(file(zstate())), CAR_TEAMS[2])


# What follows needs the published data.

@pytest.fixture(scope='module')
def paper(data):
    """Return inputs and results of the authors' two-robot run."""
    return np.load(data / 'fej_ekf_paper' / 'exact_victoria_park.npz')


@pytest.fixture(scope='module')
def logs(data):
    return divide(read(find(data / 'fej_ekf_paper')), CAR_TEAMS[2])


@pytest.fixture(scope='module')
def run(logs):
    """Return the estimator after the whole run, and the estimates of each robot."""
    estimator = Estimator(settings(CAR_TEAMS[2]))
    results = []
    for record in records(logs):
        estimator.add(record)
        results += estimator.take()
    results += estimator.close()
    poses = {name: [p for r in results for p in r.poses if p.robot == name] for name in logs}
    return estimator, poses


def test_both_published_files_hold_the_same_log(data):
    authors, openslam = (
        read(find(data / name)) for name in ('fej_ekf_paper', 'victoria_park'))

    assert len(authors.increments) == 6898
    assert np.array_equal(authors.increments, openslam.increments)
    assert len(rows_of(authors)) == 45390
    assert rows_of(authors) == rows_of(openslam)


@pytest.mark.parametrize(('robot', 'observations'), [('r1', 18529), ('r2', 14196)])
def test_the_two_robots_have_the_measurements_of_the_paper(logs, paper, robot, observations):
    increments = paper[f'{robot.upper()}OdoSet'][:, 2].reshape(-1, 3)
    seen = paper[f'{robot.upper()}ObsSet'].reshape(-1, 2, 3)
    rows = np.column_stack([seen[:, 0, :2], seen[:, :, 2]]).tolist()

    poses = [r.pose for r in records({robot: logs[robot]}) if isinstance(r, Odometry)]

    # The integrated poses are up to 300 m away, and their differences lose that many digits.
    again = [between(a, b) for a, b in pairwise(poses)]
    np.testing.assert_allclose(again, increments, rtol=0, atol=1e-12)
    assert len(rows) == observations
    assert rows_of(logs[robot]) == sorted(rows)


def test_the_two_robots_share_eight_landmarks_at_the_start_and_observe_287(logs):
    at_start = [{s.id for s in log.observations[0]} for log in logs.values()]
    ever = {s.id for log in logs.values() for seen in log.observations for s in seen}

    assert at_start[0] & at_start[1] == {3, 5, 9, 11, 18, 19, 21, 22}
    assert len(ever) == 287


@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_the_estimator_has_the_trajectory_of_the_authors_fej_filter(run, paper, robot):
    name = robot.upper()
    true = np.column_stack([
        paper[f'{name}XrTrue'][:, 1].reshape(-1, 2), paper[f'{name}XphiT'][:, 1]])
    errors = paper[f'Fej_Delta{name}Xp'][:, 1].reshape(-1, 3)
    P = paper[f'Fej_{name}P'].reshape(-1, 3, 3)

    estimates = run[1][robot][-len(errors):]

    # The authors stop the Gauss-Newton of step 0 earlier, at |dx|^2 < 1e-9.
    off = np.array([estimate.pose for estimate in estimates]) - true[-len(errors):] - errors
    assert np.abs(off[:, :2]).max() < 1e-6
    assert np.abs(wrap_all(off[:, 2])).max() < 1e-8
    assert np.abs(np.array([estimate.P for estimate in estimates]) - P).max() < 1e-8


def test_the_estimator_ends_with_the_map_of_the_authors_fej_filter(run, paper):
    rows = paper['XfTrueAll'].reshape(-1, 2, 2)
    true = dict(zip(rows[:, 0, 0], rows[:, :, 1]))
    result = paper['Fej_DeltaXf'].reshape(-1, 2, 2)
    state = run[0].groups.team.state

    map_ = np.array([state.estimate(state.landmarks['', int(i)]) for i in result[:, 0, 0]])

    # As above.
    by_authors = [true[i] + error for i, error in zip(result[:, 0, 0], result[:, :, 1])]
    assert len(state.landmarks) == len(by_authors)
    assert np.abs(map_ - by_authors).max() < 1e-6
