# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from ament_flake8.main import main_with_errors
import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.linter
def test_flake8_finds_nothing():
    folders = [str(ROOT / name) for name in ('setup.py', 'docs', 'fej_slam_ros', 'launch', 'test')]

    _, errors = main_with_errors(argv=['--config', str(ROOT / 'setup.cfg'), *folders])

    assert not errors, '\n'.join(errors)
