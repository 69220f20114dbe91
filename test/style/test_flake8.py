# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

from helpers.paths import ROOT, SOURCES

pytestmark = [pytest.mark.linter, pytest.mark.needs('ament_flake8')]


@pytest.mark.slow
def test_flake8_finds_no_error():
    # A process of its own, because flake8 forks, which is not safe once a test has had a node.
    flake8 = subprocess.run(
        [sys.executable, '-m', 'ament_flake8.main', '--config', 'setup.cfg', *SOURCES],
        cwd=ROOT, capture_output=True, text=True, check=False)

    assert flake8.returncode == 0, flake8.stdout + flake8.stderr
