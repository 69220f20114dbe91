# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a set are read as logs of each robot; impossible rows are counted."""

import math

import numpy as np
import pytest

from fej_slam_ros.datasets.mrclam.files import read
from fej_slam_ros.datasets.mrclam.motion_capture import TRUTH_SIGMA, truth_sigma
from fej_slam_ros.errors import UserError
from helpers.mrclam import STRAIGHT, write_set

NAN = math.nan


@pytest.fixture
def read_set(tmp_path):
    """Return a function that reads a set of one robot with some files of it replaced."""

    def make(**files):
        return read(write_set(tmp_path, {**STRAIGHT, **files}))

    return make


def observed(log):
    series = log.observations
    return [(t / 1e9, *row) for t, row in zip(series.stamps.tolist(), series.rows)]


def test_bar_codes_are_looked_up_once(read_set):
    rows = [(101.0, code, 2.0, 0.1) for code in (7, 14, 16, 9)]

    log = read_set(Robot1_Measurement=rows).logs[1]

    # 16 is the code of 17, 14 that of 2; both are subjects of other robots or landmarks, too.
    assert log.observations.rows[:, 0].tolist() == [8, 2, 17, 18]
    assert +log.counts == {}


@pytest.mark.parametrize(('row', 'reason'), [
    ((101.0, 99, 2.0, 0.1), 'unknown bar code'),
    ((101.0, 7.5, 2.0, 0.1), 'unknown bar code'),
    ((101.0, 5, 2.0, 0.1), 'observation of itself'),
    ((101.0, 7, -2.0, 0.1), 'impossible range or bearing'),
    ((101.0, 7, 0.0, 0.1), 'impossible range or bearing'),
    ((101.0, 7, 2.0, 7.0), 'impossible range or bearing'),
    ((101.0, 7, 1e300, 0.1), 'impossible range or bearing'),
    ((1e9, 7, 2.0, 0.1), 'stamp far from those of other rows'),
    ((101.0, 7, NAN, 0.1), 'broken row'),
    ((NAN, 7, 2.0, 0.1), 'broken row'),
    ((-5.0, 7, 2.0, 0.1), 'broken row'),
    ((1e12, 7, 2.0, 0.1), 'broken row'),
    ((101.0, 7, 2.0), 'broken row'),
    ((101.0, 7, 2.0, 0.1, 3), 'broken row'),
    ((101.0, 'seven', 2.0, 0.1), 'broken row'),
])
def test_impossible_observations_are_counted_and_dropped(read_set, row, reason):
    log = read_set(Robot1_Measurement=[row, (101.0, 7, 3.0, 0.5)]).logs[1]

    assert observed(log) == [(101.0, 8, 3.0, 0.5)]
    assert +log.counts == {reason: 1}


def test_bearings_of_a_whole_turn_are_those_of_half_a_turn_to_both_sides(read_set):
    bearings = [0.1, math.pi, 3.5, 6.0]

    log = read_set(Robot1_Measurement=[(101.0 + k, 7, 2.0, b) for k, b in enumerate(bearings)])

    # Rounding of a difference of two angles.
    np.testing.assert_allclose(
        log.logs[1].observations.rows[:, 2],
        [0.1, math.pi, 3.5 - 2.0 * math.pi, 6.0 - 2.0 * math.pi], atol=1e-15)
    assert +log.logs[1].counts == {}


def test_bearings_in_degrees_are_refused(read_set):
    rows = [(101.0 + k / 2, 7, 2.0, 10.0 * k - 40.0) for k in range(15)]

    with pytest.raises(UserError, match=(
            r'Robot1_Measurement.dat: 14 of 15 rows have an impossible range or bearing: give')):
        read_set(Robot1_Measurement=rows)


@pytest.mark.parametrize('command', [(1e300, 0.0), (-51.0, 0.0), (0.1, 1e6), (0.1, -10.1)])
def test_commands_that_no_robot_can_follow_are_counted_and_dropped(read_set, command):
    rows = [(100.0, 0.1, 0.0), (100.1, *command), (100.2, 0.3, 0.0)]

    log = read_set(Robot1_Odometry=rows).logs[1]

    assert log.commands.rows.tolist() == [[0.1, 0.0], [0.3, 0.0]]
    assert +log.counts == {'impossible command': 1}


@pytest.mark.parametrize('row', [0, 150, 299])
@pytest.mark.parametrize('stamp', [0.0, 1e9, 2e9])
def test_a_damaged_stamp_costs_its_own_row_only(read_set, row, stamp):
    rows = [(1.3e9 + 0.1 * k, 0.1, 0.0) for k in range(300)]
    rows[row] = (stamp, 0.1, 0.0)
    observations = [(1.3e9 + k, 7, 2.0, 0.1) for k in range(1, 29)]

    log = read_set(Robot1_Odometry=rows, Robot1_Measurement=observations).logs[1]

    assert (len(log.commands), len(log.observations)) == (299, 28)
    assert +log.counts == {'stamp far from those of other rows': 1}


def test_few_commands_an_hour_away_cost_their_own_rows_only(read_set):
    # Those between two with the same shift are correct.
    shift = {150: 3600.0, 151: 3600.0, 155: 3600.0, 200: -3600.0}
    rows = [(1.3e9 + 0.1 * k + shift.get(k, 0.0), 0.1, 0.0) for k in range(300)]

    log = read_set(Robot1_Odometry=rows, Robot1_Measurement=[]).logs[1]

    assert len(log.commands) == 296
    assert +log.counts == {'stamp far from those of other rows': 4}


def test_the_first_of_two_observations_of_a_subject_in_one_scan_is_kept(read_set):
    rows = [(101.0, 7, 2.0, 0.5), (101.0, 16, 3.0, 0.1), (101.0, 7, 4.0, 0.2)]

    log = read_set(Robot1_Measurement=rows).logs[1]

    assert observed(log) == [(101.0, 8, 2.0, 0.5), (101.0, 17, 3.0, 0.1)]
    assert +log.counts == {'seen twice in one scan': 1}


def test_stamps_that_step_back_are_put_in_order_and_counted(read_set):
    log = read_set(Robot1_Odometry=[(100.0, 0.1, 0), (100.2, 0.3, 0), (100.1, 0.2, 0)]).logs[1]

    assert log.commands.stamps.tolist() == [100_000_000_000, 100_100_000_000, 100_200_000_000]
    assert log.commands.rows[:, 0].tolist() == [0.1, 0.2, 0.3]
    assert +log.counts == {'stamp steps back (put in order)': 1}


def test_the_later_of_two_commands_at_one_stamp_is_in_force(read_set):
    rows = [(100, 0.1, 0), (101, 0.2, 0), (101, 0.3, 0), (102, 0, 0)]

    log = read_set(Robot1_Odometry=rows).logs[1]

    assert log.commands.rows[:, 0].tolist() == [0.1, 0.3, 0.0]
    assert +log.counts == {'command replaced at its own stamp': 1}


def test_stamps_are_exact_to_the_millisecond_of_the_files(read_set):
    log = read_set(Robot1_Odometry=[('1248444187.156', 0, 0), ('1248444187.186', 0, 0)]).logs[1]

    assert log.commands.stamps.tolist() == [1248444187_156_000_000, 1248444187_186_000_000]


def test_true_poses_around_a_jump_are_dropped(read_set):
    truth = [(100.0 + 0.02 * k, 0.002 * k, 0.0, 0.0 if k < 50 else 0.2) for k in range(100)]

    log = read_set(Robot1_Groundtruth=truth).logs[1]

    # From 100.98 to 101.00 the heading jumps by 0.2 rad.
    gap = np.diff(log.truth.stamps).argmax()
    assert (log.truth.stamps[gap:gap + 2] / 1e9).tolist() == [100.72, 101.26]
    assert log.counts['truth at a jump'] == 100 - len(log.truth)


@pytest.mark.parametrize('rows', [range(30, 60), range(30, 130)])
def test_true_poses_between_a_jump_and_the_jump_back_are_dropped(read_set, rows):
    truth = [
        (100.0 + 0.02 * k, 0.002 * k, 0.5 * (k in rows), 0.0) for k in range(200)]

    log = read_set(Robot1_Groundtruth=truth).logs[1]

    assert (log.truth.rows[:, 1] == 0.0).all()
    # A quarter of a second, 12 poses, before the last good pose and after the first one.
    assert len(log.truth) == 200 - len(rows) - 26
    assert log.counts['truth at a jump'] == 200 - len(log.truth)


def test_true_headings_in_degrees_are_not_used(read_set):
    commands = [(100.0 + 0.1 * k, 0.1, 0.3 - 0.6 * (k // 50 % 2)) for k in range(300)]
    turned = np.cumsum([0.1 * w for _, _, w in commands])
    truth = [(100.0 + 0.1 * k, 0.0, 0.0, np.degrees(turned[k])) for k in range(300)]

    log = read_set(Robot1_Odometry=commands, Robot1_Groundtruth=truth).logs[1]

    (reason, count), = (+log.counts).items()
    assert (len(log.commands), len(log.truth), count) == (300, 0, 300)
    assert 'in metres and radians?' in reason


def test_a_subject_with_several_positions_is_refused(read_set):
    with pytest.raises(UserError, match=r'Landmark_Groundtruth\.dat gives subject 6 several'):
        read_set(Landmark_Groundtruth=[(6, 1.0, 2.0, 0.1, 0.1), (6, 99.0, 99.0, 0.1, 0.1)])


def test_odometry_in_another_format_is_not_called_missing(read_set):
    with pytest.raises(UserError, match='; 2 rows of robot 1 are no such numbers'):
        read_set(Robot1_Odometry=[('100,5', '0,1', '0,0'), ('101,5', '0,1', '0,0')])


def noisy_truth(sigma):
    """Return true poses of a robot at 10 cm/s, twenty a second, with noise."""
    rng = np.random.default_rng(1)
    return np.column_stack([
        100.0 + 0.05 * np.arange(200), 0.005 * np.arange(200), np.zeros((200, 2))
    ]) + np.insert(rng.normal(0.0, sigma, (200, 3)), 0, 0.0, axis=1)


def test_noise_of_true_poses_is_no_jump(read_set):
    truth = read_set(Robot1_Groundtruth=noisy_truth(0.03).tolist()).logs[1].truth

    assert len(truth) == 200
    # The median of 198 correlated differences is known to 10 %.
    assert truth_sigma(truth) == pytest.approx([0.03] * 3, rel=0.3)


def test_a_jump_is_found_in_the_noise_of_true_poses(read_set):
    rows = noisy_truth(0.02)
    rows[100:, 1] += 0.5

    truth = read_set(Robot1_Groundtruth=rows.tolist()).logs[1].truth

    # A quarter of a second on either side, five poses.
    assert len(truth) == 190
    assert not len(truth.between(104_751_000_000, 105_199_000_000))


def test_the_noise_of_sparse_true_poses_is_not_measured(read_set):
    truth = read_set(Robot1_Groundtruth=noisy_truth(0.03)[::40].tolist()).logs[1].truth

    np.testing.assert_array_equal(truth_sigma(truth), TRUTH_SIGMA)


def test_motion_capture_across_a_half_turn_does_not_jump(read_set):
    truth = [(100.0, 0, 0, 3.1415), (100.02, 0, 0, -3.1415)]

    assert len(read_set(Robot1_Groundtruth=truth).logs[1].truth) == 2


@pytest.mark.parametrize('span', ['', ',0.02'])
def test_sparse_truth_stands_in_for_motion_capture(tmp_path, span):
    write_set(tmp_path, STRAIGHT)
    (tmp_path / 'sparse_truth.csv').write_text(
        f'robot,time,x,y,heading\n2,100.5,9,9,9{span}\n1,101.5,1.0,2.0,0.5{span}\n')

    truth = read(tmp_path).logs[1].truth

    assert truth.stamps.tolist() == [101_500_000_000]
    assert truth.rows.tolist() == [[1.0, 2.0, 0.5]]


@pytest.mark.parametrize('subject', [11.5, -10, 3e9])
def test_rows_of_bar_codes_and_landmarks_without_a_subject_are_broken(read_set, subject):
    data = read_set(
        Barcodes=[(7, 70), (subject, 80)],
        Landmark_Groundtruth=[(7, 1.0, 2.0), (subject, 3.0, 4.0), (8, 1e300, 0.0)])

    assert list(data.landmarks) == [7]
    assert +data.broken_rows == {'Barcodes.dat': 1, 'Landmark_Groundtruth.dat': 2}


def test_the_corrected_landmarks_are_preferred(read_set):
    data = read_set(Landmark_Groundtruth_fixed=[(11, 1.0, 2.0, 0.0, 0.0)])

    assert data.landmark_file == 'Landmark_Groundtruth_fixed.dat'
    assert {k: p.tolist() for k, p in data.landmarks.items()} == {11: [1.0, 2.0]}


def test_landmarks_need_no_standard_deviations(read_set):
    data = read_set(Landmark_Groundtruth=[(11, 1.0, 2.0)])

    assert {k: p.tolist() for k, p in data.landmarks.items()} == {11: [1.0, 2.0]}


@pytest.mark.parametrize('text', [
    '\ufeff8 7', '8 7 # a comment', '8,7', '# codes\r\n\r\n8\t7\r\n', '8.0e0 7.0e0\n  \n',
    '8 7\n8 7'])
def test_rows_with_any_separator_comment_or_line_end_are_read(tmp_path, text):
    write_set(tmp_path, STRAIGHT)
    (tmp_path / 'Barcodes.dat').write_text(text, encoding='utf-8', newline='')

    assert [row[1] for row in observed(read(tmp_path).logs[1])] == [8, 8]


def test_a_robot_without_two_rows_of_odometry_is_excluded(read_set):
    data = read_set(
        Robot2_Measurement=[(101.0, 7, 2.0, 0.1)], Robot3_Odometry=[],
        Robot4_Odometry=[(100.0, 0.1, 0.0), (100.0, 0.2, 0.0)])

    assert list(data.logs) == [1]


@pytest.mark.parametrize(('files', 'reason'), [
    ({'Robot1_Odometry': []}, 'holds no odometry of any robot: put Robot1_Odometry.dat'),
    ({'Robot1_Odometry': [('1248444187156', 0, 0)]}, r'with rows of time \[s\]'),
    ({'Barcodes': []}, 'Barcodes.dat is missing or has no bar codes'),
    ({'Barcodes': [('8;7',), ('9;16',)]}, 'Barcodes.dat has no row of two numbers'),
    ({'Barcodes': [(8, 7), (9, 16), (9, 16), (17, 7)]},
     'gives bar code 7 to subjects 8 and 17: correct'),
    ({'Robot6_Odometry': [(100, 0, 0)]}, 'holds Robot6_Odometry.dat: .* the subjects 1 to 5'),
])
def test_an_incomplete_folder_is_rejected_with_the_missing_files(read_set, files, reason):
    with pytest.raises(UserError, match=reason):
        read_set(**files)


def test_a_missing_folder_is_rejected(tmp_path):
    with pytest.raises(UserError, match=r'no folder .*nowhere: give the one with the files'):
        read(tmp_path / 'nowhere')
