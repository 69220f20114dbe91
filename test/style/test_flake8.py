# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

from helpers.paths import ROOT



@pytest.mark.linter
def test_flake8_finds_nothing():
    folders = [str(ROOT / name) for name in ('setup.py', 'docs', 'fej_slam_ros', 'launch', 'test')]

    # It forks, which ends badly in a process in which a test has had a node.
    flake8 = subprocess.run(
        [sys.executable, '-m', 'ament_flake8.main', '--config', ROOT / 'setup.cfg', *folders],
        capture_output=True, text=True, check=False)

    assert flake8.returncode == 0, flake8.stdout + flake8.stderr
