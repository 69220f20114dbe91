# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of records: read back to the same bits, and in the columns that users have."""

from collections import Counter
import csv
from dataclasses import asdict

import numpy as np
from numpy.testing import assert_allclose, assert_equal
import pytest

from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import (
    NO_ID, NS, Odometry, PosePrior, RobotScan, Scan, TrueLandmarks)
from fej_slam_ros.datasets import csv_tables
from fej_slam_ros.errors import UsageError, UserError
from helpers.records import odometry, robot_scan, scan, true_pose

P = np.array([[0.1, 1 / 3, 0.0], [1 / 3, 2.0, -7e-6], [0.0, -7e-6, 1e-9]])
ODOMETRY = 'robot,stamp_ns,x,y,yaw\na,1,0,0,0\n'


def write(folder, **tables):
    for name, text in tables.items():
        (folder / f'{name}.csv').write_text(text, encoding='utf-8')
    return folder


def test_records_are_read_back_to_the_same_bits(tmp_path):
    records = [
        TrueLandmarks({3: np.array([0.1, 0.2])}, 1_000_000),
        odometry('a', 1, (1 / 3, -1e-300, 3.0), P), odometry('b', 1, (0.1, 0.2, 0.3)),
        scan('a', 2, [(-1, (0.1, 0.7)), (4, (1.0, 2.0))]), scan('b', 2), robot_scan('a', 2),
        true_pose('b', 2, (0.1, 0.2, 0.3)), robot_scan('b', 3, [('a', (0.3, 0.1))]),
        PosePrior('a', 3_000_000, np.array([0.1, 1 / 3, -3.0]), P)]
    for name, rows in csv_tables.tables(records).items():
        with (tmp_path / name).open('w', encoding='utf-8', newline='') as file:
            csv.writer(file).writerows(rows)

    got = csv_tables.read(tmp_path, Counter())

    assert sorted(map(repr, map(type, got))) == sorted(map(repr, map(type, records)))
    by_type = {(type(record), getattr(record, 'robot', '')): record for record in records}
    for record in got:
        assert_equal(asdict(record), asdict(by_type[type(record), getattr(record, 'robot', '')]))


def test_rows_of_one_robot_and_stamp_are_one_scan(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY,
        landmarks='robot,stamp_ns,id,x,y,var_x,cov_xy,var_y\n'
        'a,5,1,1,2,.1,0,.2\na,5,2,3,4,.1,0,.2\na,6,1,1,2,.1,0,.2\n'), Counter())

    assert [(r.stamp, [o.id for o in r.observations]) for r in records[1:]] == [
        (5, [1, 2]), (6, [1])]


LANDMARK_HEAD = 'robot,stamp_ns,id,x,y,var_x,cov_xy,var_y\n'


def test_observations_of_one_landmark_at_one_stamp_are_of_several_scans(tmp_path):
    rows = ''.join(
        f'a,5,{id_},{k},2,.1,0,.2\n' for k, id_ in enumerate((1, -1, -1, 2, 2, 1)))

    records = csv_tables.read(
        write(tmp_path, odometry=ODOMETRY, landmarks=LANDMARK_HEAD + rows), Counter())

    assert [(r.stamp, [o.id for o in r.observations]) for r in records[1:]] == [
        (5, [1, -1, -1, 2]), (5, [2, 1])]


def test_an_observation_with_an_empty_id_is_one_without_id(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY, landmarks=f'{LANDMARK_HEAD}a,5,,1,2,.1,0,.2\n'), Counter())

    assert [o.id for o in records[1].observations] == [NO_ID]


def test_an_observation_of_a_robot_without_name_is_an_error(tmp_path):
    folder = write(
        tmp_path, odometry=ODOMETRY,
        robots='robot,stamp_ns,observed,x,y,var_x,cov_xy,var_y\na,5,,1,2,.1,0,.2\n')

    with pytest.raises(UserError, match=r'robots\.csv: correct line 2: observed is empty'):
        csv_tables.read(folder, Counter())


def odometry_table(tmp_path, milliseconds):
    rows = ''.join(f'a,{1_000_000 * at},0,0,0\n' for at in milliseconds)
    return write(tmp_path, odometry='robot,stamp_ns,x,y,yaw\n' + rows)


def test_odometry_that_passes_a_time_twice_is_refused_with_the_place(tmp_path):
    table = odometry_table(tmp_path, [*range(0, 9000, 20), *range(6010, 12_000, 20)])

    with pytest.raises(UserError, match=r'of a goes back by 2.970 s at stamp_ns 6010000000'):
        csv_tables.read(table, Counter())


def test_a_clock_set_back_is_refused_in_a_short_log_too(tmp_path):
    table = odometry_table(tmp_path, [*range(0, 4500, 100), *range(2500, 7000, 100)])

    with pytest.raises(UserError, match=r'of a goes back by 1.900 s at stamp_ns 2500000000'):
        csv_tables.read(table, Counter())


def landmark_table(tmp_path, rows):
    """Write observations, given as milliseconds and ID, beside odometry that begins before."""
    lines = ''.join(f'a,{1_000_000 * at},{id_},1,2,.1,0,.2\n' for at, id_ in rows)
    return write(tmp_path, odometry=ODOMETRY, landmarks=LANDMARK_HEAD + lines)


def test_scans_of_a_clock_set_back_are_refused_though_that_of_odometry_was_not(tmp_path):
    scans = [*range(1, 9000, 100), *range(6041, 12_000, 100)]
    table = landmark_table(tmp_path, [(at, id_) for at in scans for id_ in (4, 7)])

    with pytest.raises(UserError, match=r'landmarks.csv: .* by 2.860 s at stamp_ns 6041'):
        csv_tables.read(table, Counter())


@pytest.mark.parametrize('rows', [
    [(at + 1011 * id_, id_) for id_ in range(9) for at in range(1, 3000, 100)],
    [(at + later, id_) for later in (0, 37) for at in range(1, 9000, 100) for id_ in (4, 7)],
    [*((1, id_) for id_ in range(4)), *((501, id_) for id_ in range(4)), (1, 4),
     *((at, id_) for at in range(501, 9000, 500) for id_ in range(4, 9))],
    [(int(at), 4) for at in np.random.default_rng(1).permutation(9000)[:90]],
], ids=['by landmark', 'by sensor', 'a late row', 'in no order'])
def test_scans_of_one_clock_may_be_listed_in_any_order(tmp_path, rows):
    records = csv_tables.read(landmark_table(tmp_path, rows), Counter())

    assert sum(len(record.observations) for record in records[1:]) == len(rows)


@pytest.mark.parametrize(('name', 'text', 'fault'), [
    ('odometry', 'robot,stamp_ns,x,y,yaw\na,5,0,076,-0,003,0\n',
     'odometry.csv: correct line 2: it has more cells than the first line; decimals'),
    ('landmarks', 'robot,stamp_ns,id,range,bearing,sigma_range,sigma_bearing\na,5,1,2,40,.1,.2\n',
     'landmarks.csv: correct line 2: bearing is 40 rad, more than a turn: is it in degrees?'),
    ('landmarks', '', 'landmarks.csv is no file, or empty'),
    ('ground_truth_landmarks', 'id,x,y\n5,1,2\n6,1,3\n5,30,2\n',
     'ground_truth_landmarks.csv has several positions of landmark 5: keep one'),
], ids=['decimal commas', 'degrees', 'empty', 'two positions'])
def test_a_table_that_would_be_misread_is_refused(tmp_path, name, text, fault):
    folder = write(tmp_path, **{'odometry': ODOMETRY, name: text})

    with pytest.raises(UserError) as caught:
        csv_tables.read(folder, Counter())

    assert fault in str(caught.value)


def test_a_name_of_a_table_that_is_no_file_is_not_taken_for_a_missing_one(tmp_path):
    folder = write(tmp_path, odometry=ODOMETRY)
    (folder / 'landmarks.csv').symlink_to('nowhere')

    with pytest.raises(UserError, match=r'landmarks\.csv is no file'):
        csv_tables.read(folder, Counter())


def test_cells_that_are_empty_may_follow_the_columns(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry='robot,stamp_ns,x,y,yaw\na,5,1,2,3,,\n'), Counter())

    assert records[0].pose.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize('rows', [
    pytest.param([*range(6000, 9000, 20), *range(0, 6000, 20)], id='parts in the wrong order'),
    pytest.param(
        np.random.default_rng(1).permutation(np.arange(0, 9000, 20)).tolist(), id='any order'),
])
def test_odometry_in_any_order_is_sorted(tmp_path, rows):
    stamps = [record.stamp for record in csv_tables.read(
        odometry_table(tmp_path, rows), Counter())]

    assert stamps == [1_000_000 * at for at in range(0, 9000, 20)]


def test_times_in_seconds_keep_their_nanoseconds(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry='time,robot,x,y,yaw\n1700000000.123456789,a,0,0,0\n'), Counter())

    assert records[0].stamp == 1_700_000_000_123_456_789


def test_ids_may_be_whole_floats_or_empty_as_pandas_writes_them(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY,
        landmarks='robot,stamp_ns,id,x,y,var_x,cov_xy,var_y\n'
        'a,5,4.0,1,2,.1,0,.2\na,5,,1,3,.1,0,.2\n'), Counter())

    assert [observation.id for observation in records[1].observations] == [4, -1]


def test_polar_observations_become_cartesian(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY,
        landmarks='robot,stamp_ns,id,range,bearing,sigma_range,sigma_bearing\n'
        'a,5,1,2,0.7,0.1,0.25\n'), Counter())

    observation, = records[1].observations
    z, R = polar(r=2.0, beta=0.7, sigma_r=0.1, sigma_beta=0.25)
    assert_allclose(observation.z, z, rtol=1e-15)
    assert_allclose(observation.R, R, rtol=1e-15)


def test_a_column_range_beside_x_and_y_is_ignored_as_other_columns_are(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY,
        landmarks=f'range,{LANDMARK_HEAD}9,a,5,4,1,2,.1,0,.2\n'), Counter())

    assert_equal(records[1].observations[0].z, [1.0, 2.0])


def test_records_are_in_the_order_of_stamps_with_true_landmarks_first(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry='robot,stamp_ns,x,y,yaw\nb,7,0,0,0\na,9,0,0,0\na,3,0,0,0\n',
        robots='robot,stamp_ns,observed,x,y,var_x,cov_xy,var_y\na,5,b,1,2,.1,0,.2\n',
        ground_truth_landmarks='id,x,y\n4,1,2\n'), Counter())

    assert [(type(r), r.stamp) for r in records] == [
        (TrueLandmarks, 3), (Odometry, 3), (RobotScan, 5), (Odometry, 7), (Odometry, 9)]


def test_the_team_has_the_robots_with_odometry():
    settings = csv_tables.settings([odometry('b', 1), odometry('a', 2), scan('c', 3)])

    assert [(robot.name, robot.id) for robot in settings.robots] == [('a', 1), ('b', 2)]
    assert settings.anchor == 'a'
    assert settings.anchor_pose == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(('begin', 'start'), [(2, (4.0, 3.0, np.pi / 2)), (503, (0.0, 0.0, 0.0))])
def test_the_anchor_starts_where_its_first_true_pose_and_odometry_put_it(begin, start):
    # Since its first odometry it has driven 2 m ahead by the next, to (4, 5) facing left of x.
    records = [
        odometry('a', 2, (1.0, 0.0, 0.0)), odometry('a', begin + 1, (3.0, 0.0, 0.0)),
        true_pose('a', 1, (9.0, 9.0, 0.0)), true_pose('a', begin + 1, (4.0, 5.0, np.pi / 2))]

    # Rounding of one rotation.
    assert_allclose(csv_tables.settings(records).anchor_pose, start, atol=1e-14)


@pytest.mark.parametrize(('rows', 'reason'), [
    ('a,1,0,0', 'line 2: it ends before yaw'),
    ('a,1', 'line 2: it ends before x'),
    ('a,1,0,0,0\n# pause', 'line 3: it ends before stamp_ns'),
    ('a,1,0,0,0\n   ', 'line 3: it ends before stamp_ns'),
    ('a,1,0,x,0', "line 2: y is 'x' and not a finite number"),
    ('a,x,0,0,0', "line 2: stamp_ns is 'x' and not an integer"),
    (f'a,{2 ** 63},0,0,0', "line 2: stamp_ns is '9223372036854775808' and not an integer"),
    (',1,0,0,0', 'line 2: robot is empty'),
    ('1,1,0,0,0', "line 2: robot is '1', and a name begins with a letter"),
    ('a ,1,0,0,0', "line 2: robot is 'a ', and a name"),
    ('a,1,0,0,0\na,1,0,0,nan', "line 3: yaw is 'nan'")])
def test_a_damaged_row_is_named(tmp_path, rows, reason):
    folder = write(tmp_path, odometry=f'robot,stamp_ns,x,y,yaw\n{rows}\n')

    with pytest.raises(UserError, match=rf'odometry\.csv: correct {reason}'):
        csv_tables.read(folder, Counter())


def test_a_row_that_is_cut_in_its_last_required_number_is_no_row_without_covariance(tmp_path):
    heading = 'robot,stamp_ns,x,y,yaw,cov_vxvx,cov_vxvy,cov_vxwz,cov_vyvy,cov_vywz,cov_wzwz'
    folder = write(tmp_path, odometry=f'{heading}\na,1,0,0,0.5,,,,,,\na,2,0,0,0.\n')

    with pytest.raises(UserError, match=r'odometry\.csv: correct line 3: it ends before cov_vxvx'):
        csv_tables.read(folder, Counter())


def test_a_first_line_that_is_no_heading_is_named(tmp_path):
    folder = write(tmp_path, odometry=f'# log of Monday\n{ODOMETRY}')

    with pytest.raises(UserError, match=r"its first line, which lacks the column 'robot'"):
        csv_tables.read(folder, Counter())


def test_rows_that_repeat_an_observation_of_their_stamp_are_left_out_and_counted(tmp_path):
    one, other, again = 'a,5,1,1,2,.1,0,.2\n', 'a,5,,3,4,.1,0,.2\n', 'a,5,1,1.5,2,.1,0,.2\n'
    repeated = Counter()

    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY, landmarks=LANDMARK_HEAD + 2 * (2 * one + 2 * other + again)),
        repeated)

    assert [[o.z[0] for o in record.observations] for record in records[1:]] == [
        [1.0, 3.0], [1.5]]
    assert repeated == {'landmarks.csv': 7}


def test_a_row_that_repeats_one_from_elsewhere_in_the_table_is_left_out_and_counted(tmp_path):
    rows = [f'a,{stamp},{id_},1,0,.1,0,.2\n' for stamp in (5, 6) for id_ in (1, 2)]
    repeated = Counter()

    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY, landmarks=''.join([LANDMARK_HEAD, *rows, *rows[::-1]])),
        repeated)

    scans = [record for record in records if isinstance(record, Scan)]
    assert [[o.id for o in scan.observations] for scan in scans] == [[1, 2], [1, 2]]
    assert repeated == {'landmarks.csv': 4}


@pytest.mark.parametrize(('stamps', 'fault'), [
    ([0, *range(10 ** 18, 10 ** 18 + 20 * NS, NS)], 'stamp_ns 0 is 11574 days from most of them'),
    ([*range(0, 20 * NS, NS), 10 ** 15], 'stamp_ns 1000000000000000 is 12 days from most of them'),
    ([*range(17 * 10 ** 11, 17 * 10 ** 11 + 2000, 100)],
     'their times are 100 ns apart: give stamp_ns in nanoseconds')])
def test_a_stray_stamp_or_another_unit_is_refused(tmp_path, stamps, fault):
    rows = ''.join(f'a,{stamp},0,0,0\n' for stamp in stamps)
    folder = write(tmp_path, odometry=f'robot,stamp_ns,x,y,yaw\n{rows}')

    with pytest.raises(UserError, match=f'odometry.csv, rows of a: {fault}'):
        csv_tables.read(folder, Counter())


def test_odometry_whose_rows_have_one_time_is_refused(tmp_path):
    """A spreadsheet has rounded Unix time to six digits."""
    folder = write(tmp_path, odometry=(
        'robot,time,x,y,yaw\na,1.70000E+09,0,0,0\na,1.70000E+09,1,0,0\nb,1,0,0,0\n'))

    with pytest.raises(UserError) as rejected:
        csv_tables.read(folder, Counter())

    assert str(rejected.value) == (
        f'{folder / "odometry.csv"}: all 2 rows of a have the same time: export it with all its'
        ' digits, or as stamp_ns')


@pytest.mark.parametrize(('head', 'row', 'reason'), [
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,now,1,0,0,1,0,1', "time is 'now'"),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,1e999999999,1,0,0,1,0,1', 'time is'),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,1,2.5,0,0,1,0,1',
     r"id is '2\.5' and not an integer"),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,1,-2,0,0,1,0,1', 'id is -2 and not from -1'),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,-1,1,0,0,1,0,1', 'its time is -1000000000 ns'),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,3e9,1,0,0,1,0,1', "time is '3e9' and not a"),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,nan,1,0,0,1,0,1', "time is 'nan' and not a"),
    ('robot,time,id,x,y,var_x,cov_xy,var_y', 'a,1e900000,1,0,0,1,0,1', "time is '1e900000' and")])
def test_a_column_that_is_wrong_is_named(tmp_path, head, row, reason):
    folder = write(tmp_path, odometry=ODOMETRY, landmarks=f'{head}\n{row}\n')

    with pytest.raises(UserError, match=rf'landmarks\.csv: correct line 2: {reason}'):
        csv_tables.read(folder, Counter())


@pytest.mark.parametrize(('head', 'row', 'column'), [
    ('robot,stamp_ns,id,x,y,var_x,var_y', 'a,1,1,0,0,1,1', 'cov_xy'),
    ('robot,stamp_ns,x,y,var_x,cov_xy,var_y', 'a,1,0,0,1,0,1', 'id'),
    ('robot;stamp_ns;id;x;y', 'a;1;1;0;0', 'id'),
    ('a,1,1,0,0', 'a,2,1,0,0', 'id')])
def test_a_column_that_is_missing_is_named_with_the_first_line(tmp_path, head, row, column):
    folder = write(tmp_path, odometry=ODOMETRY, landmarks=f'{head}\n{row}\n')

    with pytest.raises(UserError) as rejected:
        csv_tables.read(folder, Counter())

    assert str(rejected.value) == (
        f'{folder / "landmarks.csv"}: correct its first line, which lacks the column {column!r},'
        f' separated by commas: {head!r}')


def test_a_column_that_is_there_twice_is_named(tmp_path):
    folder = write(
        tmp_path, odometry=ODOMETRY, landmarks='robot,stamp_ns,id,x,y,x\na,1,1,0,0,1\n')

    with pytest.raises(UserError) as rejected:
        csv_tables.read(folder, Counter())

    assert str(rejected.value) == (
        f"{folder / 'landmarks.csv'}: correct line 1: it has the column 'x' twice")


@pytest.mark.parametrize('row', ['b,1,a,1,2,.1,0,.2', 'a,1,b,1,2,.1,0,.2'])
def test_a_robot_that_is_observed_or_observes_without_odometry_is_named(tmp_path, row):
    folder = write(
        tmp_path, odometry=ODOMETRY,
        robots=f'robot,stamp_ns,observed,x,y,var_x,cov_xy,var_y\n{row}\n')

    with pytest.raises(UserError, match='has observations by or of b, without odometry'):
        csv_tables.read(folder, Counter())


def test_a_folder_without_odometry_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match=r'odometry\.csv is missing or has no row'):
        csv_tables.read(tmp_path, Counter())
    with pytest.raises(UsageError, match='no folder'):
        csv_tables.read(tmp_path / 'none', Counter())


HEADS = {name.removesuffix('.csv'): ','.join(head) for name, head in csv_tables.COLUMNS.items()}


@pytest.mark.parametrize(('table', 'row', 'names'), [
    ('odometry', 'a,1,0,0,0,.1,0,0,-.1,0,.1', 'cov_vxvx, cov_vxvy, cov_vxwz, cov_vyvy'),
    ('odometry', 'a,1,0,0,0,.1,.2,0,.1,0,.1', 'cov_vxvx'),
    ('odometry', 'a,1,0,0,0,0,.1,0,.1,0,.1', 'cov_vxvx'),
    ('landmarks', 'a,1,7,1,2,-.1,0,.1', 'var_x, cov_xy, var_y'),
    ('landmarks', 'a,1,7,1,2,.1,.1,.1', 'var_x'), ('landmarks', 'a,1,7,1,2,.1,0,0', 'var_x'),
    ('robots', 'a,1,a,1,2,.1,-.2,.1', 'var_x'),
    ('pose_priors', 'a,1,0,0,0,1,0,0,1,0,-1', 'cov_xx, cov_xy, cov_xyaw, cov_yy'),
    ('pose_priors', 'a,1,0,0,0,0,0,0,0,0,0', 'cov_xx')])
def test_a_covariance_that_is_none_is_named_with_its_line(tmp_path, table, row, names):
    write(tmp_path, **{'odometry': ODOMETRY, table: f'{HEADS[table]}\n{row}\n'})

    with pytest.raises(UserError, match=rf'{table}\.csv: correct line 2: {names}.* are no '):
        csv_tables.read(tmp_path, Counter())


@pytest.mark.parametrize(('sigmas', 'name'), [('-.1,.2', 'sigma_r'), ('.1,-.2', 'sigma_beta')])
def test_a_negative_standard_deviation_is_named_with_its_line(tmp_path, sigmas, name):
    folder = write(
        tmp_path, odometry=ODOMETRY,
        landmarks=f'robot,stamp_ns,id,range,bearing,sigma_range,sigma_bearing\na,5,1,2,0,{sigmas}')

    with pytest.raises(UserError, match=rf'landmarks\.csv: correct line 2: {name} is -'):
        csv_tables.read(folder, Counter())


@pytest.mark.parametrize('block', [
    # Of wheels that do not slip sideways, and of two velocities from one encoder: rounded.
    '.1,0,0,0,0,.2', '.01,0,.003333333,0,0,.001111111', '0,0,0,0,0,0'])
def test_the_covariance_of_a_velocity_may_be_singular(tmp_path, block):
    record, = csv_tables.read(write(
        tmp_path, odometry=f'{HEADS["odometry"]}\na,1,0,0,0,{block}\n'), Counter())

    upper = record.twist_covariance[np.triu_indices(3)]
    assert upper.tolist() == [*map(float, block.split(','))]


@pytest.mark.parametrize('table', [
    f'{LANDMARK_HEAD}a,5,1,1,2,0,0,0\n', f'{LANDMARK_HEAD}a,5,1,1,2,,,\n',
    'robot,stamp_ns,id,x,y\na,5,1,1,2\n'])
def test_an_observation_without_covariance_has_zeros_as_in_scans(tmp_path, table):
    records = csv_tables.read(write(tmp_path, odometry=ODOMETRY, landmarks=table), Counter())

    assert not records[1].observations[0].R.any()


def test_a_scan_without_observations_stays_a_scan(tmp_path):
    records = csv_tables.read(write(
        tmp_path, odometry=ODOMETRY,
        landmarks='robot,stamp_ns,id,x,y,var_x,cov_xy,var_y\na,5,,,,,,\n'), Counter())

    assert [(type(r), r.observations) for r in records[1:]] == [(Scan, ())]


def test_two_drives_of_equal_length_on_two_days_have_no_stray_stamps(tmp_path):
    stamps = [day * 86_400 * NS + k * NS for day in (0, 2) for k in range(5)]
    rows = ''.join(f'a,{stamp},0,0,0\n' for stamp in stamps)
    folder = write(tmp_path, odometry=f'robot,stamp_ns,x,y,yaw\n{rows}')

    records = csv_tables.read(folder, Counter())

    assert [r.stamp for r in records] == stamps


@pytest.mark.parametrize('stamp', ['stamp_ns,5000000000', 'time,5'])
def test_a_row_that_ends_after_its_stamp_is_an_empty_scan(tmp_path, stamp):
    column, value = stamp.split(',')
    folder = write(
        tmp_path, odometry=ODOMETRY, landmarks=f'robot,{column},id,x,y\na,{value}\n')

    records = csv_tables.read(folder, Counter())

    assert [(r.stamp, r.observations) for r in records if isinstance(r, Scan)] == [(5 * NS, ())]
