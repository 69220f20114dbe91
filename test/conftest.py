# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures and hooks of all tests."""

import math
import os
from pathlib import Path
import signal

import numpy as np
import pytest
from scipy.io import savemat

import fej_slam_ros.cli  # noqa: F401, one BLAS thread, before anything imports numpy
from fej_slam_ros.experiments.liu.victoria_park import reproduce
from fej_slam_ros.interrupts import INTERRUPTS
from helpers.network import Network, why_none
from helpers.optional import is_installed
from helpers.shared_results import computed_once

# Assertions in these helpers are explained as those of tests are.
pytest.register_assert_rewrite('helpers.gtsam_reference', 'helpers.ros')

#: Longest time of a slow test [s], with other work on the machine.
SLOW_TIMEOUT = 1200

# rclpy checks the types of message fields only on demand, and publishes garbage otherwise.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
# A domain of this run's own, so that two runs on one machine do not hear each other.
os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark as slow what needs the Victoria Park experiment; give slow tests time."""
    for item in items:
        if 'victoria_park' in getattr(item, 'fixturenames', ()):
            item.add_marker('slow')
        if item.get_closest_marker('slow') and not item.get_closest_marker('timeout'):
            item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT))


def pytest_runtest_setup(item):
    """Skip a test whose optional dependencies are not installed."""
    modules = [name for mark in item.iter_markers('needs') for name in mark.args]
    if item.get_closest_marker('ros'):
        modules.append('rclpy')
    for name in modules:
        if not is_installed(name):
            pytest.skip(f'{name} is not installed')


@pytest.fixture(scope='session')
def data():
    """Return the folder of the data sets."""
    if 'FEJ_SLAM_DATA' not in os.environ:
        pytest.skip('FEJ_SLAM_DATA does not name the folder of the data sets')
    return Path(os.environ['FEJ_SLAM_DATA'])


@pytest.fixture(scope='session')
def victoria_park(data, tmp_path_factory):
    """Return the Victoria Park experiment of the paper, and the progress messages of its run."""
    def compute():
        messages = []
        return reproduce(data / 'fej_ekf_paper', messages.append), messages
    return computed_once(tmp_path_factory, 'victoria_park', compute)


@pytest.fixture
def domain():
    """Return a ROS domain of the test's own; what runs in it ends with the test."""
    live = pytest.importorskip('helpers.live', reason='rclpy is not installed')
    with live.Domain() as domain:
        yield domain


@pytest.fixture
def raw_park(tmp_path):
    """
    Return a function that writes a synthetic raw log of Victoria Park, with changed columns.

    From (100, 200, 0.5) at 1 s the car drives straight for 12 s at 5 m/s and observes two trees,
    10 m ahead of its laser and 20 m to the left, in scans 0.2 s apart.

    """

    def write(**changed):
        folder = tmp_path / 'raw_park'
        folder.mkdir(exist_ok=True)
        park = _synthetic_park() | changed
        for name, columns in {
            'aa3_dr': ('time', 'speed', 'steering'), 'aa3_gpsx': ('timeGps', 'Lo_m', 'La_m'),
            'data_sensor_clean_clean': ('data_sensor_clean_clean',),
        }.items():
            arrays = {column: np.asarray(park[column], dtype=float) for column in columns}
            savemat(folder / f'{name}.mat', arrays, oned_as='column')
        for name, head in {
            'scan_time': 'scan,t_ms', 'detections': 'scan,t_ms,range_m,bearing_rad,diameter_m',
        }.items():
            lines = [','.join(map(str, row)) for row in park[name]]
            (folder / f'{name}.csv').write_text('\n'.join([head, *lines, '']))
        return folder

    return write


def _synthetic_park():
    ms, gps_ms, scan_ms = (np.arange(1000, 13001, step) for step in (25, 200, 200))
    distance = 3.9 + 5.0 * (gps_ms - 1000) / 1000.0
    c, s = math.cos(0.5), math.sin(0.5)
    scans = list(enumerate(scan_ms.tolist()))
    return {
        'time': ms, 'speed': np.full(len(ms), 5.0), 'steering': np.zeros(len(ms)),
        'timeGps': gps_ms, 'Lo_m': 100.0 + c * distance - s * 0.46,
        'La_m': 200.0 + s * distance + c * 0.46,
        'scan_time': scans,
        'detections': [
            (k, t, *tree, 0.3) for k, t in scans for tree in ((10.0, 1.5708), (20.0, 3.14159))],
        'data_sensor_clean_clean': [
            (t, r, bearing, 0, 0, number) for _, t in scans
            for r, bearing, number in ((10.0, 1.570801, 7), (20.0, 3.141589, 4))],
    }


@pytest.fixture
def same_signals():
    """Restore the handlers of signals."""
    before = {number: signal.getsignal(number) for number in INTERRUPTS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def network():
    """Return two hosts and a link between them that can be cut and can lose frames."""
    why = why_none()
    if why:
        pytest.skip(why)
    with Network(seed=1) as network:
        yield network
