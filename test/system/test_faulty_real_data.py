# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of loggers, missing truth, missing robots and long occlusions, made up in real data."""

import numpy as np
import pytest

from fej_slam_ros.datasets.mrclam import files
from fej_slam_ros.datasets.mrclam.noise import best_options
from fej_slam_ros.experiments.real_data import mrclam

LOGS = ('Odometry', 'Measurement')
#: Robot 4 pauses for longer than the clocks step in these tests.
ROBOTS = (1, 2, 3, 5)


class FaultySet:
    """A copy of set 6, whose files are changed row by row; rows begin with their time [s]."""

    def __init__(self, source, folder):
        self.folder = folder
        folder.mkdir()
        for path in source.iterdir():
            (folder / path.name).symlink_to(path)
        self.begin = float(self.rows(1, 'Odometry')[0][0])

    def rows(self, robot, kind):
        lines = (self.folder / f'Robot{robot}_{kind}.dat').read_text().splitlines()
        return [line.split() for line in lines if line and not line.startswith('#')]

    def change(self, robots, kinds, change):
        """Replace the rows of some files by a function of them."""
        for robot in robots:
            for kind in kinds:
                path = self.folder / f'Robot{robot}_{kind}.dat'
                rows = change(self.rows(robot, kind))
                path.unlink()
                path.write_text('\n'.join(map(' '.join, rows)))

    def within(self, rows, first, last):
        """Return the rows between two times since the begin [s]."""
        return [row for row in rows if first <= float(row[0]) - self.begin < last]


def shifted(rows, seconds):
    return [[f'{float(time) + seconds:.3f}', *rest] for time, *rest in rows]


@pytest.fixture
def faulty(data, tmp_path):
    return FaultySet(data / 'mrclam_6', tmp_path / 'set')


@pytest.fixture(scope='module')
def original(data):
    return files.read(data / 'mrclam_6')


def assert_repaired(found, original, within):
    """Compare the logs with those before the fault; stamps are right within some seconds."""
    for robot in ROBOTS:
        for kind in ('commands', 'observations'):
            series, expected = (getattr(logs[robot], kind) for logs in (found.logs, original.logs))
            np.testing.assert_array_equal(series.rows, expected.rows)
            assert np.abs(series.stamps - expected.stamps).max() <= within * 1e9


@pytest.mark.slow
@pytest.mark.parametrize('change', [
    pytest.param(lambda f, rows: [
        *f.within(rows, 0, 200), *f.within(rows, 230, 260), *f.within(rows, 200, 230),
        *f.within(rows, 260, 1e9)], id='buffers written late'),
    pytest.param(
        lambda f, rows: [*f.within(rows, 0, 400), *f.within(rows, 340, 1e9)],
        id='logs that share a minute'),
    pytest.param(
        lambda f, rows: [*f.within(rows, 400, 1e9), *f.within(rows, 0, 400)],
        id='logs in the wrong order'),
    pytest.param(
        lambda f, rows: [*rows, *shifted(f.within(rows, 50, 350), 300)],
        id='another recording at the same time'),
])
def test_rows_at_the_wrong_place_change_no_log(faulty, original, change):
    faulty.change(ROBOTS, LOGS, lambda rows: change(faulty, rows))

    assert_repaired(files.read(faulty.folder), original, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize('is_right_after', [True, False])
@pytest.mark.parametrize('truth_seconds', [0.0, 10.0])
def test_a_clock_that_was_set_back_goes_on_in_time(
        faulty, original, is_right_after, truth_seconds):
    def step(rows):
        before, after = faulty.within(rows, 0, 300), faulty.within(rows, 300, 1e9)
        return [*shifted(before, 5), *after] if is_right_after else [*before, *shifted(after, -5)]

    faulty.change(ROBOTS, LOGS, step)
    if truth_seconds:
        faulty.change(range(1, 6), ['Groundtruth'], lambda rows: sparse(rows, truth_seconds))

    # A step of odometry is 10 to 50 ms.
    assert_repaired(files.read(faulty.folder), original, 0.05)


def sparse(rows, seconds):
    """Return a row once in a time [s]."""
    periods = np.array([float(row[0]) for row in rows]) // seconds
    return [rows[k] for k in np.unique(periods, return_index=True)[1]]


def run(faulty):
    return mrclam.run(mrclam.MrclamTask(faulty.folder, 'fej', robots_seen=True))


@pytest.mark.slow
def test_two_robots_that_are_hidden_for_five_minutes_come_back(faulty):
    hidden = {'14', '32'}  # The codes of robots 2 and 4.

    def hide(robot):
        return lambda rows: [row for row in rows if not (
            300 <= float(row[0]) - faulty.begin < 600 and (robot in {2, 4} or row[1] in hidden))]

    for robot in range(1, 6):
        faulty.change([robot], ['Measurement'], hide(robot))

    found = run(faulty)

    # Without the occlusion 0.11 m and 1.7.
    assert found.fitted_position < 0.4
    assert found.nees < 2.0
    assert min(found.in_map.values()) > 0.9


@pytest.mark.slow
def test_a_team_of_two_is_localized(faulty):
    for robot in (3, 4, 5):
        for kind in (*LOGS, 'Groundtruth'):
            (faulty.folder / f'Robot{robot}_{kind}.dat').unlink()

    found = run(faulty)

    assert found.of_robots.keys() == {'r1', 'r2'}
    assert found.fitted_position < 0.4
    assert found.nees < 2.0


@pytest.mark.slow
def test_sparse_true_poses_give_the_turns_that_motion_capture_gives(faulty, original):
    dense = best_options(original).own_turns
    faulty.change(range(1, 6), ['Groundtruth'], lambda rows: sparse(rows, 50.0))

    found = best_options(files.read(faulty.folder)).own_turns

    # Three sigma: 17 windows with heading errors of 0.2 rad over 60 m and 60 rad in all.
    for robot, (per_metre, per_radian) in dense.items():
        assert found[robot][0] == pytest.approx(per_metre, abs=0.04)
        assert found[robot][1] == pytest.approx(per_radian, abs=0.06)
