# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A data set becomes a bag with its parameters; nothing that exists is lost on the way."""

import math
from pathlib import Path
import re

from mrclam_helpers import STRAIGHT, write_set
import numpy as np
import pytest
from scipy.io import savemat

from fej_slam_ros.cli.main import executable
from fej_slam_ros.datasets.victoria_park import settings, TEAMS
from fej_slam_ros.ros import bags, parameters
from fej_slam_ros.ros.run import Run

TURN = math.tau / 20


def log(poses):
    """Return steps on a circle, 20 a loop, around landmark 7, which stays 2 m to the left."""
    increment = 2.0 * math.sin(TURN), 2.0 - 2.0 * math.cos(TURN), TURN
    steps = [(1, k, k + 1, *increment, *[0] * 6) for k in range(poses - 1)]
    sightings = [(0, k, 7, 0.0, 2.0, *[0] * 7) for k in range(poses)]
    return {'VicPark_clean_data': np.array(steps + sightings)}


@pytest.fixture
def bag(tmp_path):
    return tmp_path / 'bag'


@pytest.fixture
def convert(bag, monkeypatch, capsys):
    """Return a function that runs convert from a log of some poses to a bag, with more options."""

    def run(*options, poses=3):
        source = bag.parent / 'data'
        source.mkdir(exist_ok=True)
        savemat(source / 'VicPark_clean_data.mat', log(poses))
        places = ['--input', str(source), '--output', str(bag)]
        monkeypatch.setattr('sys.argv', ['convert', 'victoria_park', *places, *options])
        status = executable()
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


def test_two_robots_are_the_default_and_the_output_counts_what_they_did(convert, bag):
    status, said, _ = convert(poses=5811)

    assert status == 0
    assert bags.topics(bag).keys() == {'r1/odom', 'r1/landmarks', 'r2/odom', 'r2/landmarks'}
    assert 'robots: 2, landmarks: 1\n' in said
    assert 'r2: steps: 2545, sightings: 2546\n' in said
    assert said.endswith(f'wrote {bag} and {bag}.yaml\n')


@pytest.mark.parametrize('robots', [1, 2])
def test_the_parameters_beside_the_bag_are_those_of_the_run(convert, bag, robots):
    convert('--robots', str(robots), poses=5811)

    assert parameters.load(Path(f'{bag}.yaml')) == settings(TEAMS[robots])


def test_a_converted_loop_closes_when_it_is_run_with_its_parameters(convert, bag):
    convert('--robots', '1', poses=21)
    run = Run(parameters.load(Path(f'{bag}.yaml')), None)

    for message in bags.read(bag):
        run.receive(message)
    list(run.close())

    state = run.estimator.team.state
    assert run.estimator.ledger.refused.total() == 0
    # The bag is exact, but for the rounding of half an angle's sine.
    np.testing.assert_allclose(state.estimate(state.robots['r1']), [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(state.estimate(state.landmarks['', 7]), [0, 2], atol=1e-12)


@pytest.mark.parametrize('existing', ['bag', 'bag.yaml'])
def test_nothing_that_exists_is_replaced_without_force(convert, bag, existing):
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


def test_bad_data_end_with_a_sentence_and_leave_nothing_behind(convert, bag):
    status, said, error = convert('--robots', '2', poses=9)

    assert (status, said) == (1, '')
    assert error.startswith('fej_slam convert: the log ends at pose 8, but robot r1 needs poses')
    assert [path.name for path in bag.parent.iterdir()] == ['data']


@pytest.mark.parametrize('options', [['--robots', '3'], ['--storage', 'db3'], ['--roboter', '1']])
def test_bad_arguments_end_with_status_2(convert, options):
    with pytest.raises(SystemExit) as end:
        convert(*options)

    assert end.value.code == 2


@pytest.fixture
def convert_mrclam(bag, monkeypatch, capsys):
    """Return a function that converts a set of a robot that drives straight, with more files."""

    def run(*options, **files):
        source = write_set(bag.parent / 'data', {**STRAIGHT, **files})
        monkeypatch.setattr(
            'sys.argv', ['convert', 'mrclam', '--input', str(source), *map(str, options)])
        status = executable()
        return status, *capsys.readouterr()

    return run


def test_a_set_of_mrclam_becomes_odometry_sightings_and_truth(convert_mrclam, bag):
    status, said, _ = convert_mrclam(
        '--output', bag, '--motion-delay', 0,
        Robot1_Groundtruth=[(100 + k, 0.1 * k, 0, 0) for k in range(11)],
        Robot1_Measurement=[(101, 7, 2, 0.5), (105, 14, 2, 0.5), (105, 99, 1, 0)],
        Robot2_Odometry=[(100, 0, 0), (110, 0, 0)])

    assert status == 0
    assert {name: topic.messages for name, topic in bags.topics(bag).items()} == {
        'ground_truth/landmarks': 1, 'r1/odom': 11, 'r1/landmarks': 1, 'r1/robots': 1,
        'r1/ground_truth': 11, 'r2/odom': 2}
    assert 'r1: odometry: 11 (gaps above 0.4 s: 10, longest 1.0 s), sightings: 2,' in said
    assert '    unknown bar code: 1\n' in said
    assert 'r3 is left out: no rows in Robot3_Odometry.dat\n' in said
    assert said.endswith(f'wrote {bag} and {bag}.yaml\n')


def test_a_set_of_mrclam_runs_with_its_parameters(convert_mrclam, bag):
    convert_mrclam(
        '--output', bag, '--motion-delay', 0, '--odometry-scale', 1, 1,
        Robot1_Groundtruth=[(100 + k, 2 + 0.1 * k, 1, 0) for k in range(11)])
    run = Run(parameters.load(Path(f'{bag}.yaml')), None)

    for message in bags.read(bag):
        run.receive(message)
    list(run.close())

    state = run.estimator.team.state
    assert run.estimator.ledger.refused.total() == 0
    # The second sighting moves it by some of its noise.
    np.testing.assert_allclose(state.estimate(state.robots['r1']), [3, 1, 0], atol=0.1)
    assert list(state.landmarks) == [('', 8)]


def test_noise_is_measured_only_against_motion_capture(convert_mrclam):
    status, said, error = convert_mrclam('--measure')

    assert (status, said) == (1, '')
    assert 'tells no noise: it needs Robot1_Groundtruth.dat' in error


def test_the_measured_noise_is_a_table_and_leaves_nothing_behind(convert_mrclam, bag):
    rows = range(5200)
    status, said, _ = convert_mrclam(
        '--measure',
        Robot1_Odometry=[(100 + k / 100, 0.1, 0.1) for k in rows],
        Robot1_Groundtruth=[(100 + k / 100, 0, 0, 0) for k in rows],
        Robot1_Measurement=[(101 + k, 7, 2.3, 0.5) for k in range(30)])

    assert status == 0
    assert re.search(r'true over commanded speed +0\.000 +0\.000\n', said)
    # From the origin landmark 8 is 2.236 m away.
    assert re.search(r'range mean \[m\] +0\.064\n', said)
    assert [path.name for path in bag.parent.iterdir()] == ['data']


def test_mrclam_needs_something_to_do(convert_mrclam):
    status, _, error = convert_mrclam()

    assert status == 2
    assert 'give --output BAG, or --measure' in error


@pytest.mark.parametrize('options', [
    ['--thin', '-1'], ['--thin', 'nan'], ['--motion-delay', 'x'], ['--odometry-scale', '1'],
    ['--odometry-scale', '0', '1'], ['--range-sigma', '0']])
def test_bad_options_of_mrclam_end_with_status_2(convert_mrclam, bag, options):
    with pytest.raises(SystemExit) as end:
        convert_mrclam('--output', bag, *options)

    assert end.value.code == 2
