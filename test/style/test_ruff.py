# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

from helpers.paths import ROOT



@pytest.mark.linter
def test_ruff_finds_nothing():
    pytest.importorskip('ruff', reason='ruff is not among the packages of ROS')

    ruff = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--no-cache',
         'setup.py', 'docs', 'fej_slam_ros', 'launch', 'test'],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )

    assert ruff.returncode == 0, ruff.stdout + ruff.stderr
