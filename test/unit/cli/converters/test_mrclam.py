# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`convert mrclam`: bags with their parameters, and tables of measured noise."""

import math
import re

import numpy as np
import pytest

from fej_slam_ros.ros.files import bags
from helpers.mrclam import BARCODES, STRAIGHT, write_set
from helpers.ros import run_bag, run_verb


@pytest.fixture
def bag(tmp_path):
    return tmp_path / 'bag'


@pytest.fixture
def convert_mrclam(bag, capsys):
    """Return a function that converts a set of one robot on a line, with more files."""

    def run(*options, **files):
        source = write_set(bag.parent / 'data', {**STRAIGHT, **files})
        status = run_verb('convert', 'mrclam', '--input', source, *options)
        return status, *capsys.readouterr()

    return run


@pytest.mark.parametrize(('period', 'said_so'), [(1.0, False), (5.0, True)])
def test_commands_that_were_recorded_on_change_only_are_named(
        convert_mrclam, bag, period, said_so):
    _, said, _ = convert_mrclam(
        '--output', bag, Robot1_Odometry=[(100 + period * k, 0.1, 0.1 * k) for k in range(11)])

    assert ('for 100% of the time the last command is older than 2 s' in said) == said_so


@pytest.mark.parametrize(('commands', 'observations', 'sentences'), [
    (round, float, ['most commands have the stamp of another']),
    (float, round, ['stamps of observations are whole seconds']),
    (float, float, [])])
def test_stamps_without_their_decimals_are_named(
        convert_mrclam, bag, commands, observations, sentences):
    _, said, _ = convert_mrclam(
        '--output', bag,
        Robot1_Odometry=[(commands(100 + 0.25 * k), 0.1, 0.01 * k) for k in range(80)],
        Robot1_Measurement=[(observations(101 + 1.1 * k), 7, 2.0, 0.5) for k in range(15)])

    assert re.findall('    ([a-z ]*stamps? of [a-z ]+)', said) == sentences


def test_ground_truth_of_another_time_and_unknown_bar_codes_are_named(convert_mrclam, bag):
    _, said, _ = convert_mrclam(
        '--output', bag, Robot1_Groundtruth=[(3700 + k, 0.1 * k, 0, 0) for k in range(15)],
        Robot1_Measurement=[(101, 7, 2, 0.5), (102, 99, 2, 0.5), (103, 98, 1, 0)])

    assert 'no true pose is of the time of the odometry: they begin 3600 s after it' in said
    assert 'most observations have a bar code that is not in Barcodes.dat' in said


def test_a_set_is_converted_to_odometry_observations_and_ground_truth(convert_mrclam, bag):
    status, said, _ = convert_mrclam(
        '--output', bag, '--motion-delay', 0,
        Robot1_Groundtruth=[(100 + k, 0.1 * k, 0, 0) for k in range(15)],
        Robot1_Measurement=[(101, 7, 2, 0.5), (105, 14, 2, 0.5), (105, 99, 1, 0)],
        Robot2_Odometry=[(100, 0, 0), (110, 0, 0)],
        Robot3_Odometry=[(100, 0, 0), (110, 'fast', 0)], Robot3_Measurement=[(105, 7, 2, 0)],
        Barcodes=[*BARCODES, (19, 'torn')])

    assert status == 0
    assert {name: topic.messages for name, topic in bags.topics(bag).items()} == {
        'ground_truth/landmarks': 1, 'r1/odom': 11, 'r1/landmarks': 1, 'r1/robots': 1,
        'r1/ground_truth': 11, 'r2/odom': 2}
    assert 'r1: odometry: 11 (gaps above 0.4 s: 10, longest 1.0 s), observations: 2,' in said
    assert ' true poses: 11 of 15\n' in said
    assert '    unknown bar code: 1\n' in said
    assert said.count('Measurement.dat is missing') == 1
    assert '    Robot2_Measurement.dat is missing, or has no row that can be used' in said
    assert '    broken row in Barcodes.dat: 1\n' in said
    assert (
        'r3 is left out: Robot3_Odometry.dat is missing, or has no two valid rows\n'
        '    broken row: 1\n'
        '    command: 1\n    observation: 1\nr4 is left out') in said
    assert said.endswith(f'wrote {bag} and {bag}.yaml\n')


@pytest.mark.parametrize(('option', 'warnings'), [
    ('--no-robot-observations', []),
    ('--no-robot-sightings', [
        'option --no-robot-sightings is deprecated: write --no-robot-observations'])])
def test_an_old_name_of_an_option_is_accepted_with_a_warning(
        convert_mrclam, bag, caplog, option, warnings):
    status, *_ = convert_mrclam(
        '--output', bag, option, Robot1_Measurement=[(101, 7, 2, 0.5), (105, 14, 2, 0.5)],
        Robot2_Odometry=[(100, 0, 0), (110, 0, 0)])

    assert (status, 'r1/robots' in bags.topics(bag)) == (0, False)
    assert caplog.messages == warnings


@pytest.mark.parametrize(('first', 'in_frame'), [(100, True), (399, True), (401, False)])
def test_a_frame_other_than_that_of_the_truth_is_said(convert_mrclam, bag, first, in_frame):
    _, said, _ = convert_mrclam(
        '--output', bag, '--motion-delay', 0,
        Robot1_Odometry=[(100 + k, 0.1, 0) for k in range(400)],
        Robot1_Groundtruth=[(first + k, 2 + 0.1 * k, 1, 0) for k in range(11)])

    assert ('map begins where r1 starts, which has no true pose' not in said) == in_frame
    assert 'too few true poses to measure delay' in said


@pytest.mark.parametrize(('late', 'said_so'), [(0.0, False), (7.0, True)])
def test_ground_truth_of_another_clock_is_said(convert_mrclam, bag, late, said_so):
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 120.0, 0.05)
    turn_rates = np.repeat(rng.uniform(-0.5, 0.5, 60), 40)
    turned = np.cumsum(0.05 * turn_rates) - 0.05 * turn_rates

    status, said, _ = convert_mrclam(
        '--output', bag,
        Robot1_Odometry=[(100.0 + t, 0.0, w) for t, w in zip(times, turn_rates)],
        Robot1_Groundtruth=[(100.0 + t + late, 0.0, 0.0, phi) for t, phi in zip(times, turned)])

    assert status == 0
    sentence = 'true poses do not follow the commands, the correlation of turns is'
    assert (sentence in said) == said_so


@pytest.mark.parametrize(('late', 'delays'), [(0.4, []), (0.9, ['motion', 'camera'])])
def test_delays_at_the_end_of_their_search_are_said(convert_mrclam, bag, late, delays):
    rng = np.random.default_rng(1)
    times = 100.0 + np.arange(0.0, 120.0, 0.05)
    turn_rates = np.repeat(rng.uniform(-0.5, 0.5, 60), 40)
    turned = np.cumsum(0.05 * turn_rates) - 0.05 * turn_rates
    # Landmark 8 is ahead by 2 m and to the left by 1 m of a robot that only turns.
    bearings = np.angle(np.exp(1j * (math.atan2(1, 2) - turned)))

    _, said, _ = convert_mrclam(
        '--output', bag,
        Robot1_Odometry=[(t, 0.0, w) for t, w in zip(times, turn_rates)],
        Robot1_Measurement=[(t, 7, math.sqrt(5), b) for t, b in zip(times[::10], bearings[::10])],
        Robot1_Groundtruth=[(t + late, 0.0, 0.0, phi) for t, phi in zip(times, turned)])

    assert re.findall('the measured ([a-z]+) delay, .* longest', said) == delays


def test_a_converted_set_runs_with_its_parameters(convert_mrclam, bag):
    convert_mrclam(
        '--output', bag, '--motion-delay', 0, '--odometry-scale', 1, 1,
        Robot1_Groundtruth=[(100 + k, 2 + 0.1 * k, 1, 0) for k in range(11)])

    run = run_bag(bag)

    state = run.estimator.groups.team.state
    assert run.estimator.statistics.rejected.total() == 0
    # The second observation corrects the pose by some of its noise.
    np.testing.assert_allclose(state.estimate(state.robots['r1']), [3, 1, 0], atol=0.1)
    assert list(state.landmarks) == [('', 8)]


def test_noise_is_measured_with_motion_capture_only(convert_mrclam):
    status, said, error = convert_mrclam('--measure')

    assert (status, said) == (1, '')
    assert 'is not enough to measure noise: it needs Robot1_Groundtruth.dat' in error


def test_measured_noise_is_not_of_a_conversion(convert_mrclam, bag):
    status, _, error = convert_mrclam('--measure', '--output', bag)

    assert status == 2
    assert '--measure converts nothing: leave out --output' in error


def test_measured_noise_is_printed_and_writes_no_file(convert_mrclam, bag):
    rows = range(5200)
    status, said, _ = convert_mrclam(
        '--measure',
        Robot1_Odometry=[(100 + k / 100, 0.1, 0.0) for k in rows],
        Robot1_Groundtruth=[(100 + k / 100, 0, 0, 0) for k in rows],
        Robot1_Measurement=[(101 + k, 7, 2.3, 0.5) for k in range(30)])

    assert status == 0
    # It never moves ahead; 50 s outweigh the prior, that it drives as commanded, 19 to 1.
    assert re.search(r'true over commanded speed +0\.0[45]\d +1\.000\n', said)
    # Landmark 8 is 2.236 m from the origin.
    assert re.search(r'range mean \[m\] +0\.064\n', said)
    assert [path.name for path in bag.parent.iterdir()] == ['data']


def test_an_output_or_measure_is_required(convert_mrclam):
    status, _, error = convert_mrclam()

    assert status == 2
    assert 'give --output BAG, or --measure' in error


@pytest.mark.parametrize('options', [
    ['--thin', '-1'], ['--thin', 'nan'], ['--motion-delay', 'x'], ['--motion-delay', '-0.1'],
    ['--motion-delay', '1e10'], ['--odometry-scale', '1'],
    ['--odometry-scale', '0', '1'], ['--range-sigma', '0']])
def test_bad_options_end_with_status_2(convert_mrclam, bag, options):
    status, said, _ = convert_mrclam('--output', bag, *options)

    assert (status, said) == (2, '')
