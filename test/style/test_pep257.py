# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
from ament_pep257.main import main
import pytest

from helpers.paths import ROOT



@pytest.mark.linter
def test_docstrings_follow_pep257():
    folders = [str(ROOT / name) for name in ('setup.py', 'docs', 'fej_slam_ros', 'launch', 'test')]

    # D417 does not know numpydoc's one-line parameters; pydocstyle's own numpy set omits it too.
    assert main(argv=['--add-ignore', 'D417', '--', *folders]) == 0
