# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for every test."""

import os

import pytest

import fej_slam_ros.cli  # noqa: F401, one BLAS thread, before anything imports numpy

# rclpy checks the types of message fields only on demand, and publishes garbage otherwise.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
# A domain of this run's own, so that two runs on one machine do not hear each other.
os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


@pytest.fixture
def domain():
    """Return a ROS domain of the test's own; what runs in it ends with the test."""
    live_helpers = pytest.importorskip('live_helpers', reason='rclpy is not installed')
    with live_helpers.Domain() as domain:
        yield domain
