# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A survey or the map of an earlier run is a prior map, or is refused in one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure
from fej_slam_ros.sim.world import make_world
from helpers.ros import drive, feed, meeting, raw_record, run_settings, save

#: What an ID must be.
AN_ID = 'an integer from -1073741824 to 2147483647 other than -1'
HEADER = 'id,x,y,var_x,cov_xy,var_y'
MESSAGES = [raw_record(record) for record in meeting(8)]


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a file and returns settings that name it."""

    def write(text, name='survey.csv', **changes):
        (tmp_path / name).write_text(text, encoding='utf-8')
        return run_settings(prior_landmarks=str(tmp_path / name), **changes)

    return write


def rejected(path, **changes):
    """Return what is said of a file that is not taken."""
    with pytest.raises(UserError) as caught:
        prior_map(run_settings(prior_landmarks=str(path), **changes))
    return str(caught.value)


def test_a_survey_is_read_in_any_order_of_columns_and_without_frames(file):
    settings = file('y,x,id,name,var_y,cov_xy,var_x\n2,1.5,7,post,0.3,0.1,0.2\n')

    found = prior_map(settings)

    assert found.ids == (7,)
    np.testing.assert_array_equal(found.points, [[1.5, 2.0]])
    np.testing.assert_array_equal(found.P, [[0.2, 0.1], [0.1, 0.3]])


def test_a_byte_order_mark_is_ignored(file):
    assert prior_map(file(f'\ufeff{HEADER}\n7,1,2,0.2,0,0.3\n')).ids == (7,)


def test_rows_of_other_frames_are_ignored(file):
    settings = file(f'{HEADER},frame\n7,1,2,1,0,1,map\n8,1,2,1,0,1,r2/map\n')

    found = prior_map(settings)

    assert found.ids == (7,)


@pytest.mark.parametrize(
    ('text', 'fault'),
    [
        ('', 'it lacks the column id of id,x,y,var_x,cov_xy,var_y'),
        ('id,x,y\n', 'it lacks the column var_x of id,x,y,var_x,cov_xy,var_y'),
        (f'{HEADER}\n', 'it has no landmark in the frame map'),
        (f'{HEADER},frame\n1,0,0,1,0,1,odom\n', 'it has no landmark in the frame map'),
        (f'{HEADER}\n1,0,0,1,0,1\n2,0,,1,0,1\n',
         "correct line 3: y is '' and not a finite number"),
        (f'{HEADER}\n1,nan,0,1,0,1\n', "correct line 2: x is 'nan' and not a finite number"),
        (f'{HEADER}\n1,0,0,1\n', 'correct line 2: it ends before cov_xy'),
        (f'{HEADER},frame\n1;0,0,1,0,1,map\n', 'correct line 2: it ends before frame'),
        (f'{HEADER}\n1.0,0,0,1,0,1\n',
         f"correct line 2: id is '1.0' and not {AN_ID}"),
        (f'{HEADER}\n-1,0,0,1,0,1\n',
         f"correct line 2: id is '-1' and not {AN_ID}"),
        (f'{HEADER}\n1,0,0,1,2,1\n',
         'correct line 2: the covariance is not positive definite'),
        (f'{HEADER}\n1,0,0,0,0,0\n',
         'correct line 2: the covariance is not positive definite'),
        (f'{HEADER}\n1,0,2e9,1,0,1\n', 'correct line 2: it exceeds 1e+09 m or 1e+12 m^2'),
        (f'{HEADER}\n1,0,0,1,0,1\n2,0,0,1,0,1\n1,5,0,1,0,1\n',
         'id 1 is in line 2 and in line 4, keep one'),
    ],
)
def test_a_mistake_in_a_survey_is_named_with_its_line(file, text, fault):
    path = file(text).node.prior_landmarks

    assert rejected(path) == f'{path} cannot be read as a table of landmarks: {fault}'


def test_ids_that_an_earlier_run_assigned_are_accepted(file):
    settings = file(f'{HEADER}\n-2,1,2,1,0,1\n-41,5,6,1,0,1\n')

    assert prior_map(settings).ids == (-2, -41)


def test_a_table_has_at_most_the_landmarks_of_a_map(file):
    rows = ''.join(f'{k},{k}.0,0.0,0.1,0.0,0.1\n' for k in range(30_000))
    path = file(f'{HEADER}\n{rows}').node.prior_landmarks

    assert "more than 2,500 landmarks in map, the value of 'max_landmarks'" in rejected(path)
    assert 'more than 100 landmarks' in rejected(path, max_landmarks=100)
    assert len(prior_map(file(
        HEADER + '\n' + ''.join(rows.splitlines(True)[:100]), max_landmarks=100)).ids) == 100


def test_a_checkpoint_has_at_most_the_landmarks_of_a_map(tmp_path):
    first_run(tmp_path)

    assert 'more than 2 landmarks in map' in rejected(tmp_path / 'checkpoint', max_landmarks=2)


@pytest.mark.parametrize(('name', 'reason'), [
    ('missing.csv', 'No such file or directory'), ('.', 'Is a directory')])
def test_a_survey_that_is_no_file_is_named_with_what_to_give(tmp_path, name, reason):
    path = tmp_path / name

    assert rejected(str(path)) == (
        f'cannot read the prior landmarks {path}: {reason}; give the path of a table, or of'
        ' landmarks.csv or the checkpoint of an earlier run')


def first_run(folder, messages=MESSAGES, **changes):
    """Return a run that has left its files and its checkpoint in a folder."""
    run = EstimatorSession(run_settings(checkpoint=str(folder / 'checkpoint'), **changes), folder)
    drive(run, messages)
    run.write_files()
    save(run)
    return run


def test_the_csv_map_of_an_earlier_run_has_independent_landmarks(tmp_path):
    state = first_run(tmp_path).estimator.groups.team.state

    found = prior_map(run_settings(prior_landmarks=str(tmp_path / 'landmarks.csv')))

    for k, number in enumerate(found.ids):
        landmark = state.landmarks['', number]
        np.testing.assert_array_equal(found.points[k], state.estimate(landmark))
        own = slice(2 * k, 2 * k + 2)
        np.testing.assert_array_equal(found.P[own, own], state.marginal([landmark]))
    assert np.count_nonzero(found.P) <= 4 * len(found.ids) == 12


def test_the_checkpoint_of_other_robots_has_the_joint_covariance_of_its_map(tmp_path):
    state = first_run(tmp_path).estimator.groups.team.state

    found = prior_map(run_settings(prior_landmarks=str(tmp_path / 'checkpoint')))

    landmarks = [state.landmarks['', number] for number in (1, 2, 3)]
    assert found.ids == (1, 2, 3)
    np.testing.assert_array_equal(found.points, [state.estimate(mark) for mark in landmarks])
    np.testing.assert_array_equal(found.P, state.marginal(landmarks))


@pytest.mark.parametrize('name', ['landmarks.csv', 'checkpoint'])
def test_a_map_without_shared_ids_is_no_prior_map(tmp_path, name):
    first_run(tmp_path, shared_landmark_ids=False)

    path = tmp_path / name
    assert rejected(str(path)).startswith(
        f'{path} has no landmarks in map with IDs that all robots share')


@pytest.mark.parametrize('name', ['landmarks.csv', 'checkpoint'])
def test_a_second_run_with_the_map_of_the_first_has_smaller_errors(tmp_path, name):
    circles, rng = ENVIRONMENTS['circles'], np.random.default_rng(4)
    world = make_world(replace(circles.world, landmarks=30, loops=1), rng)
    first, second = (
        [raw_record(record) for record in measure(world, circles.sensors, rng)] for _ in range(2))
    first_run(tmp_path, first)

    scores = []
    for prior in ('', str(tmp_path / name)):
        run = EstimatorSession(run_settings(prior_landmarks=prior), None)
        drive(run, second)
        scores.append(run.write_files()['rmse'])

    # Over 40 seeds with 30 landmarks the error is 0.4 of that without.
    for robot in ('r1', 'r2'):
        without, with_map = (rmse[robot]['position'] for rmse in scores)
        assert with_map < 0.7 * without


def test_a_restored_run_needs_the_same_prior_map_and_continues_bit_for_bit(file, tmp_path):
    survey = f'{HEADER}\n1,5,1,0.01,0,0.01\n4,9,9,0.5,0,0.5\n'
    saved = tmp_path / 'run.checkpoint'
    whole = EstimatorSession(file(survey), None)
    drive(whole, MESSAGES)
    begun = EstimatorSession(file(survey, checkpoint=str(saved)), None)
    feed(begun, MESSAGES[:20])
    save(begun)

    restored = EstimatorSession(file(survey, 'moved.csv', restore=str(saved)), None)
    drive(restored, MESSAGES[20:])

    assert restored.estimator.state_hash() == whole.estimator.state_hash()
    for other in (run_settings(), file(survey.replace('0.5', '0.6'))):
        with pytest.raises(UserError, match=r'was made with prior_landmarks = .2 landmarks with '):
            checkpoint.load(saved, other, prior_map(other))


def test_without_an_anchor_a_robot_may_have_a_known_start(file):
    settings = file(f'{HEADER}\n1,5,1,0.01,0,0.01\n', anchor='')
    known = RobotSettings('r1', 1, start_pose=(0.0, 0.0, 0.0))

    estimation = replace(settings.estimation, robots=(known, settings.estimation.robots[1]))
    run = EstimatorSession(replace(settings, estimation=estimation), None)
    drive(run, MESSAGES)

    assert run.estimator.groups.not_in_map == {}
