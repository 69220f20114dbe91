# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import numpy as np
import pytest

from helpers.paths import ROOT

pytestmark = [pytest.mark.linter, pytest.mark.needs('mypy')]


@pytest.mark.skipif(
    np.lib.NumpyVersion(np.__version__) < '2.4.0', reason='the stubs of older numpy differ')
def test_mypy_finds_no_error():
    mypy = subprocess.run(
        [sys.executable, '-m', 'mypy', 'fej_slam_ros', 'docs/generate.py'],
        cwd=ROOT, capture_output=True, text=True, check=False)

    assert mypy.returncode == 0, mypy.stdout + mypy.stderr
