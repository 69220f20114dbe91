# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The package has types that mypy accepts in strict mode."""

from importlib.metadata import PackageNotFoundError, version
import subprocess
import sys

import numpy as np
import pytest

from helpers.paths import ROOT

pytestmark = [pytest.mark.linter, pytest.mark.needs('mypy')]


def major_version(package):
    """Return the first number of the version of a package, 0 if it is not installed."""
    try:
        return int(version(package).partition('.')[0])
    except PackageNotFoundError:
        return 0


@pytest.mark.skipif(
    major_version('mypy') < 2 or np.lib.NumpyVersion(np.__version__) < '2.4.0',
    reason='needs mypy 2 and numpy 2.4: with mypy 1.9 and the stubs of numpy 1.26, as in'
           ' Ubuntu 24.04, correct code is reported')
def test_mypy_finds_no_error():
    mypy = subprocess.run(
        [sys.executable, '-m', 'mypy', 'fej_slam_ros', 'docs/generate.py'],
        cwd=ROOT, capture_output=True, text=True, check=False)

    assert mypy.returncode == 0, mypy.stdout + mypy.stderr
