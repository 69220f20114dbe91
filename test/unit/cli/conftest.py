# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of verbs."""

import os
import signal

import pytest

from helpers.ros import write_parameters


@pytest.fixture
def places(tmp_path):
    """Return the paths of bag, parameter file (which exists) and results."""
    return tmp_path / 'in', write_parameters(tmp_path / 'params.yaml'), tmp_path / 'out'


@pytest.fixture
def interrupted_write(monkeypatch, same_signals):  # noqa: ARG001
    """Let SIGINT arrive while the first file is written; the command leaves it ignored."""
    sync = os.fsync

    def interrupted(file):
        monkeypatch.setattr(os, 'fsync', sync)
        signal.raise_signal(signal.SIGINT)
        sync(file)

    monkeypatch.setattr(os, 'fsync', interrupted)
