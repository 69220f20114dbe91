# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`convert victoria_park`: bags with their parameters, and error messages."""

import math
from pathlib import Path
import re

import numpy as np
import pytest
from scipy.io import savemat

from fej_slam_ros.datasets.victoria_park.associated_log import CAR_TEAMS, settings
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from helpers.ros import run_bag, run_verb

TURN = math.tau / 20


def log(poses):
    """Return steps on a circle, 20 per loop, around landmark 7, which is 2 m to the left."""
    increment = 2.0 * math.sin(TURN), 2.0 - 2.0 * math.cos(TURN), TURN
    steps = [(1, k, k + 1, *increment, *[0] * 6) for k in range(poses - 1)]
    observations = [(0, k, 7, 0.0, 2.0, *[0] * 7) for k in range(poses)]
    return {'VicPark_clean_data': np.array(steps + observations)}


@pytest.fixture
def bag(tmp_path):
    return tmp_path / 'bag'


@pytest.fixture
def convert(bag, capsys):
    """Return a function that converts a log with a number of poses."""

    def run(*options, poses=3):
        source = bag.parent / 'data'
        source.mkdir(exist_ok=True)
        savemat(source / 'VicPark_clean_data.mat', log(poses))
        status = run_verb(
            'convert', 'victoria_park', '--input', source, '--output', bag, *options)
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def convert_raw(raw_park, bag, capsys):
    """Return a function that converts a raw log."""

    def run(*options):
        places = '--input', raw_park(), '--output', bag
        status = run_verb('convert', 'victoria_park', '--raw', *places, *options)
        return status, *capsys.readouterr()

    return run


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_bag_holds_odometry_and_scans_at_their_stamps(convert, bag, storage):
    convert('--robots', '1', '--storage', storage)

    found = [(m.topic, m.type_name, m.received) for m in bags.read(bag)]

    t0 = found[0][-1]
    assert found == [
        (topic, type_name, t0 + k * 200_000_000) for k in range(3) for topic, type_name in (
            ('r1/odom', 'nav_msgs/msg/Odometry'),
            ('r1/landmarks', 'sensor_msgs/msg/PointCloud2'))]


def test_two_robots_are_the_default_and_their_records_are_counted(convert, bag):
    status, said, _ = convert(poses=5811)

    assert status == 0
    assert bags.topics(bag).keys() == {'r1/odom', 'r1/landmarks', 'r2/odom', 'r2/landmarks'}
    assert 'robots: 2, landmarks: 1\n' in said
    assert 'r2: steps: 2545, observations: 2546\n' in said
    assert said.endswith(f'wrote {bag} and {bag}.yaml\n')


@pytest.mark.parametrize('robots', [1, 2])
def test_the_parameters_beside_the_bag_are_those_of_the_run(convert, bag, robots):
    convert('--robots', str(robots), poses=5811)

    assert parameters.load(Path(f'{bag}.yaml')).estimation == settings(CAR_TEAMS[robots])


def test_a_converted_loop_closes_when_it_is_run_with_its_parameters(convert, bag):
    convert('--robots', '1', poses=21)

    run = run_bag(bag)

    state = run.estimator.groups.team.state
    assert run.estimator.statistics.rejected.total() == 0
    # The bag is exact except for rounding in quaternions.
    np.testing.assert_allclose(state.estimate(state.robots['r1']), [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(state.estimate(state.landmarks['', 7]), [0, 2], atol=1e-12)


@pytest.mark.parametrize('existing', ['bag', 'bag.yaml'])
def test_existing_files_are_not_replaced_without_force(convert, bag, existing):
    (bag.parent / existing).mkdir()

    status, said, error = convert('--robots', '1')

    assert (status, said) == (2, '')
    assert re.search(rf'{existing} exists: .*--force', error)
    assert [path.name for path in bag.parent.iterdir() if path.name != 'data'] == [existing]


def test_force_replaces_the_bag_and_its_parameters(convert, bag):
    convert('--robots', '1', poses=3)

    status, _, _ = convert('--robots', '1', '--force', poses=5)

    assert status == 0
    assert len(list(bags.read(bag))) == 2 * 5
    assert sorted(p.name for p in bag.parent.iterdir()) == ['bag', 'bag.yaml', 'data']


def test_a_short_log_is_reported_and_leaves_no_files(convert, bag):
    status, said, error = convert('--robots', '2', poses=9)

    assert (status, said) == (1, '')
    assert error.startswith('convert: the log ends at pose 8, but robot r1 needs poses')
    assert [path.name for path in bag.parent.iterdir()] == ['data']


@pytest.mark.parametrize('options', [['--robots', '3'], ['--storage', 'db3'], ['--roboter', '1']])
def test_bad_arguments_end_with_status_2(convert, options):
    status, said, _ = convert(*options)

    assert (status, said) == (2, '')


def test_the_raw_log_is_converted_to_odometry_scans_and_gps(convert_raw, bag):
    status, said, _ = convert_raw('--robots', '1')

    assert status == 0
    assert {name: topic.messages for name, topic in bags.topics(bag).items()} == {
        'r1/odom': 481, 'r1/landmarks': 61, 'r1/gps': 61}
    assert (
        'r1: odometry: 481, scans: 61, detections: 122 (122 without ID), GPS: 61'
        ' (0 gaps, 0 doubtful fixes)\n') in said


def test_a_raw_log_with_ids_runs_with_its_parameters(convert_raw, raw_park, bag):
    convert_raw('--robots', '1', '--identities', str(raw_park() / 'data_sensor_clean_clean.mat'))

    run = run_bag(bag)

    state = run.estimator.groups.team.state
    assert {id_ for _, id_ in state.landmarks} == {4, 7}
    assert run.inputs.unused == {'r1/gps': 61}


def test_identities_require_the_raw_log(convert):
    status, said, error = convert('--identities', 'file.mat')

    assert (status, said) == (2, '')
    assert '--identities is for the raw log: give --raw as well' in error


def test_a_raw_log_too_short_for_two_robots_is_reported(convert_raw, bag):
    status, said, error = convert_raw()

    assert (status, said) == (1, '')
    assert 'wheel data reach from 1.0 to 13.0 s, but robot r1 needs 187.382 to' in error
    assert [path.name for path in bag.parent.iterdir()] == ['raw_park']
