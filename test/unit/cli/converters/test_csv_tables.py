# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`convert csv`: a bag of tables, with its parameters, and error messages."""

import pytest

from helpers.ros import assert_one_sentence, run_bag, run_verb

ODOMETRY = """\
robot,time,x,y,yaw
red,0.0,0,0,0
red,0.5,1,0,0
red,1.0,2,0,0
"""
LANDMARKS = """\
robot,time,id,range,bearing,sigma_range,sigma_bearing
red,0.5,7,2.0,0.0,0.1,0.02
red,1.0,7,1.0,0.0,0.1,0.02
"""


@pytest.fixture
def convert(tmp_path, capsys):
    """Return a function that converts tables to a bag and returns status and both outputs."""

    def run(**tables):
        for name, text in tables.items():
            (tmp_path / f'{name}.csv').write_text(text, encoding='utf-8')
        status = run_verb('convert', 'csv', '--input', tmp_path, '--output', tmp_path / 'bag')
        return status, *capsys.readouterr()

    return run


def test_tables_of_a_user_run_with_the_parameters_beside_the_bag(convert, tmp_path):
    status, said, error = convert(odometry=ODOMETRY, landmarks=LANDMARKS)

    assert (status, error) == (0, '')
    assert said.startswith('red: odometry: 3, scans: 2\n')
    state = run_bag(tmp_path / 'bag').estimator.groups.team.state
    assert list(state.landmarks) == [('', 7)]
    # Odometry and both observations agree.
    assert state.estimate(state.robots['red']) == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(('written', 'said_so'), [(int, True), (float, False)])
def test_times_without_their_decimals_are_named(convert, written, said_so):
    rows = ''.join(f'red,{written(0.5 * k)},{k},0,0\n' for k in range(20))

    status, said, _ = convert(odometry='robot,time,x,y,yaw\n' + rows)

    assert status == 0
    assert ('in steps of 1 s and have several poses each' in said) == said_so


@pytest.mark.parametrize(('back', 'said_so'), [(1, True), (0, False)])
def test_rows_with_the_stamp_and_not_the_pose_of_another_are_named(convert, back, said_so):
    # A clock at 1 Hz that is set back by a second: no stamp steps back.
    rows = ''.join(f'red,{k if k < 30 else k - back},{k},0,0\n' for k in range(60))

    status, said, _ = convert(odometry='robot,time,x,y,yaw\n' + rows)

    assert status == 0
    assert ('and not the pose of another: 1, the first at stamp_ns 29000000000' in said) == said_so


def test_a_name_that_cannot_be_a_topic_is_refused_before_a_bag_is_written(convert, tmp_path):
    assert_one_sentence(
        convert(odometry=ODOMETRY.replace('red', 'robot 1')), 1, "robot is 'robot 1', and a name")
    assert not (tmp_path / 'bag').exists()


def test_bad_input_ends_with_one_sentence(convert, tmp_path):
    assert_one_sentence(convert(), 1, 'odometry.csv is missing or has no row', 'robot,stamp_ns,x')
    assert_one_sentence(
        convert(odometry=ODOMETRY, landmarks=LANDMARKS.replace('0.02', '?')), 1,
        'landmarks.csv: correct line 2', "sigma_bearing is '?'")
    assert not (tmp_path / 'bag').exists()
