# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of verbs."""

import os
import signal

import pytest

from fej_slam_ros.interrupts import INTERRUPTS
from helpers.ros import write_parameters


@pytest.fixture
def places(tmp_path):
    """Return the paths of bag, parameter file (which exists) and results."""
    return tmp_path / 'in', write_parameters(tmp_path / 'params.yaml'), tmp_path / 'out'


@pytest.fixture
def interrupted_write(monkeypatch):
    """Let SIGINT arrive while the first file is written."""
    before, sync = {number: signal.getsignal(number) for number in INTERRUPTS}, os.fsync

    def interrupted(file):
        monkeypatch.setattr(os, 'fsync', sync)
        signal.raise_signal(signal.SIGINT)
        sync(file)

    monkeypatch.setattr(os, 'fsync', interrupted)
    yield
    # The command has left them ignored.
    for number, handler in before.items():
        signal.signal(number, handler)
