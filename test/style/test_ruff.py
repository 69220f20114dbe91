# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

from helpers.paths import ROOT, SOURCES

# Ruff is not among the packages of ROS.
pytestmark = [pytest.mark.linter, pytest.mark.needs('ruff')]


def test_ruff_finds_no_error():
    ruff = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--no-cache', *SOURCES],
        cwd=ROOT, capture_output=True, text=True, check=False)

    assert ruff.returncode == 0, ruff.stdout + ruff.stderr
