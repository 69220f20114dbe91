# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw log is read from its files; errors name the damaged file."""

import numpy as np
import pytest

from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.datasets.victoria_park.raw_log import read, with_ids
from fej_slam_ros.errors import UserError

IDENTITIES = 'data_sensor_clean_clean'
#: Rows of [t, range, bearing, x, y, id].
TREES = [(1000, 10.0, 1.5708, 0, 0, 7), (1000, 20.0, 3.14159, 0, 0, 4)]


def changed(row, column, value):
    """Return TREES with another value."""
    rows = np.array(TREES)
    rows[row, column] = value
    return rows


def test_the_log_holds_the_values_of_the_files(raw_park):
    log = read(raw_park())

    assert log.wheels.stamps[:2].tolist() == [1_000_000_000, 1_025_000_000]
    assert log.wheels.rows[0].tolist() == [5.0, 0.0]
    assert log.trees.stamps[-1] == 13_000_000_000
    assert log.trees.starts[:3].tolist() == [0, 2, 4]
    assert log.trees.ranges[:2].tolist() == [10.0, 20.0]
    assert log.fixes.rows.shape == (61, 2)


def test_a_scan_without_trees_is_kept(raw_park):
    log = read(raw_park(detections=[(0, 1000, 10.0, 1.5, 0.3), (2, 1400, 11.0, 1.5, 0.3)]))

    assert len(log.trees.stamps) == 61
    assert log.trees.starts[:4].tolist() == [0, 1, 1, 2]


def test_detections_have_ids_only_with_the_file_of_ids(raw_park):
    trees = read(raw_park()).trees

    assert (trees.ids == NO_ID).all()
    # The file is rounded to 5 digits.
    assert with_ids(trees, raw_park() / f'{IDENTITIES}.mat').ids.tolist() == 61 * [7, 4]


def test_detections_that_are_not_in_the_file_have_no_id(raw_park):
    folder = raw_park(**{IDENTITIES: TREES[1:]})

    ids = with_ids(read(folder).trees, folder / f'{IDENTITIES}.mat').ids

    assert ids[:4].tolist() == [NO_ID, 4, NO_ID, NO_ID]


def test_a_part_of_the_log_has_odometry_over_all_its_scans(raw_park):
    part = read(raw_park()).between(1_210_000_000, 1_790_000_000).shifted(5)

    assert part.trees.stamps.tolist() == [1_400_000_005, 1_600_000_005]
    assert part.fixes.stamps.tolist() == part.trees.stamps.tolist()
    assert part.trees.starts.tolist() == [0, 2, 4]
    assert part.wheels.stamps[[0, -1]].tolist() == [1_200_000_005, 1_800_000_005]


@pytest.mark.parametrize(('changes', 'file', 'reason'), [
    ({'time': np.zeros(481)}, 'aa3_dr.mat', 'its times do not increase'),
    ({'speed': np.zeros(480)}, 'aa3_dr.mat', 'time, speed, steering are not of one length'),
    ({'speed': np.full(481, np.nan)}, 'aa3_dr.mat', 'a value is not finite'),
    ({'steering': np.full(481, 1.5)}, 'aa3_dr.mat', 'the steering exceeds 1 rad'),
    ({'speed': np.full(481, 1e200)}, 'aa3_dr.mat', 'the speed exceeds 100 m/s'),
    ({'time': np.append(np.arange(480.0), 1e300)}, 'aa3_dr.mat', 'a time is after 2147483647 s'),
    ({'speed': np.zeros((481, 2))}, 'aa3_dr.mat', 'speed is not a matrix of 1 columns'),
    ({'Lo_m': np.full(61, np.inf)}, 'aa3_gpsx.mat', 'a value is not finite'),
    ({'La_m': np.zeros(60)}, 'aa3_gpsx.mat', 'timeGps, Lo_m, La_m are not of one length'),
    ({'scan_time': [(0, 1000), (2, 1200)]}, 'scan_time.csv', 'are not numbered 0, 1'),
    ({'scan_time': [(0, 1000), (1, 900)]}, 'scan_time.csv', 'its times do not increase'),
    ({'scan_time': []}, 'scan_time.csv', 'it has no rows'),
    ({'scan_time': [(0, 1000), (1, 'x')]}, 'scan_time.csv', 'cannot be read as a table'),
    ({'scan_time': [(0, 1000), (1,)]}, 'scan_time.csv', 'cannot be read as a table'),
    ({'detections': [(0, 1000, 1, 1)]}, 'detections.csv', 'cannot be read as a table'),
    ({'detections': [(61, 1000, 1, 1, 1)]}, 'detections.csv', 'do not go up from 0 to 60'),
    ({'detections': [(1, 1000, 1, 1, 1)]}, 'detections.csv', 'another stamp than in scan_time'),
    ({'detections': [(0, 1000, 0, 1, 1)]}, 'detections.csv', 'a range is not positive'),
    ({'detections': [(0, 1000, 1, 1e300, 1)]}, 'detections.csv',
     'a range exceeds 1000 m or a bearing 7 rad'),
    ({'detections': [(0, 1000, 'nan', 1, 1)]}, 'detections.csv', 'a value is not finite'),
])
def test_a_damaged_file_is_rejected_with_the_reason(raw_park, changes, file, reason):
    with pytest.raises(UserError, match=rf'{file}: .*({reason}).*; fetch the file again$'):
        read(raw_park(**changes))


@pytest.mark.parametrize('name', [
    'aa3_dr.mat', 'aa3_gpsx.mat', 'detections.csv', 'scan_time.csv'])
def test_a_missing_or_foreign_file_is_rejected(raw_park, name):
    path = raw_park() / name
    path.write_bytes(b'\xff\x00 something else')
    with pytest.raises(UserError, match=f'{name}: cannot be read as .*; fetch the file again'):
        read(path.parent)

    path.unlink()

    with pytest.raises(UserError, match=f'{name}: there is no such file; give the path'):
        read(path.parent)


def test_a_table_with_other_columns_is_rejected(raw_park):
    path = raw_park() / 'scan_time.csv'
    path.write_text('t_ms,scan\n1000,0\n')

    with pytest.raises(UserError, match='its first line is not scan,t_ms; fetch'):
        read(path.parent)


def test_a_missing_folder_is_rejected(tmp_path):
    with pytest.raises(UserError, match=r'no folder .*nowhere: give the one with'):
        read(tmp_path / 'nowhere')


@pytest.mark.parametrize(('rows', 'reason'), [
    (changed(0, 0, 1001), 'there was no scan at 1001 ms'),
    (changed(0, 0, 99999), 'there was no scan at 99999 ms'),
    (changed(0, 1, 10.1), 'the scan at 1000 ms is not one of its detections'),
    (changed(1, slice(1, 3), (10.0, 1.5708)), 'the scan at 1000 ms is not one of its'),
    (changed(1, 5, 7), 'a scan observes one landmark twice'),
    (changed(1, 5, 4.5), 'an id that is not an integer from'),
    (changed(1, 5, -1), 'an id that is not an integer from'),
    (changed(1, 5, np.nan), 'a value is not finite'),
    (np.zeros((3, 5)), 'is not a matrix of 6 columns'),
])
def test_ids_of_other_scans_are_rejected(raw_park, rows, reason):
    folder = raw_park(**{IDENTITIES: rows})

    with pytest.raises(UserError, match=rf'{IDENTITIES}.mat: .*{reason}.*; fetch the file again'):
        with_ids(read(folder).trees, folder / f'{IDENTITIES}.mat')


def test_the_published_log_is_read_whole(data):
    folder = data / 'victoria_park'

    log = read(folder)
    ids = with_ids(log.trees, folder / f'{IDENTITIES}.mat').ids

    # The counts in the README of the data.
    assert (len(log.wheels.stamps), len(log.trees.stamps), len(ids)) == (61945, 7249, 52974)
    assert len(log.fixes.stamps) == 4466
    assert (np.diff(log.trees.starts) == 0).sum() == 19
    assert (ids != NO_ID).sum() == 46860
    assert len(np.unique(ids)) == 299 + 1
