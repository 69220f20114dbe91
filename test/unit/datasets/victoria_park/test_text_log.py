# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The text files of RFS-SLAM are the log of the original files."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.datasets.victoria_park import raw_log, text_log
from fej_slam_ros.errors import UserError

#: Time that RFS-SLAM subtracts from the original times [ms].
OFFSET = 20_967


def lines(ms, *columns, digits):
    """Return the lines of a table in the format of RFS-SLAM."""
    return ''.join(
        f'{(t - OFFSET) / 1000.0:10.3f}' + ''.join(f' {x:10.{digits}f}' for x in row) + '\n'
        for t, *row in zip(ms, *columns))


@pytest.fixture
def text_park(raw_park, tmp_path):
    """Return a folder with the text files of the raw log, and that log."""
    log = raw_log.read(raw_park())
    folder = tmp_path / 'text_park'
    folder.mkdir()
    wheels, trees, fixes = log.wheels, log.trees, log.fixes
    of_detections = np.repeat(trees.stamps, np.diff(trees.starts))
    for name, text in {
        'inputs.dat': lines(wheels.stamps // 10**6, *wheels.rows.T, digits=4),
        'measurements.dat': lines(
            of_detections // 10**6, trees.ranges, trees.bearings, 0.3 * trees.ranges, digits=5),
        'gps.dat': lines(fixes.stamps // 10**6, *fixes.rows.T, digits=9),
    }.items():
        (folder / name).write_text(text)
    return folder, log


def test_the_text_files_hold_the_original_log(text_park):
    folder, log = text_park

    read = text_log.read(folder)

    for part, expected in (
            (read.wheels, log.wheels), (read.trees, log.trees), (read.fixes, log.fixes)):
        for name in expected.__slots__:
            # Fixes are written with 9 digits, all other values exactly.
            assert_allclose(
                getattr(part, name), getattr(expected, name), rtol=0.0, atol=1e-9, err_msg=name)


def test_a_folder_is_read_by_the_files_that_it_has(text_park, raw_park):
    folder, _ = text_park

    assert text_log.is_in(folder)
    assert not text_log.is_in(raw_park())


@pytest.mark.parametrize(('name', 'content', 'reason'), [
    ('inputs.dat', '0.973 0.0\n', 'cannot be read as a table'),
    ('inputs.dat', '0.973 0.0 2.0\n', 'the steering exceeds 1 rad'),
    ('measurements.dat', '0.852 -1.0 0.5 0.3\n', 'a range is not positive'),
    ('measurements.dat', '0.852 1.0 nan 0.3\n', 'a value is not finite'),
    ('measurements.dat', '0.852 1.0 0.5 0.3\n0.700 1.0 0.5 0.3\n', 'its times do not increase'),
    ('gps.dat', '', 'it has no rows')])
def test_a_damaged_file_is_named_with_the_reason(text_park, name, content, reason):
    folder, _ = text_park
    (folder / name).write_text(content)

    with pytest.raises(UserError, match=rf'{name}: .*({reason}).*; fetch the file again$'):
        text_log.read(folder)


def test_a_file_that_is_missing_is_named(text_park):
    folder, _ = text_park
    (folder / 'gps.dat').unlink()

    with pytest.raises(UserError, match=r'gps\.dat: there is no such file; give the path'):
        text_log.read(folder)
