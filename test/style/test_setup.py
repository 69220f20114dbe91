# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""setup.py installs the files of the package and no folder."""

from pathlib import Path
import runpy
import shutil

import pytest

from helpers.optional import optional
from helpers.paths import ROOT

pytestmark = pytest.mark.needs('setuptools')

setuptools = optional('setuptools')


@pytest.fixture
def used(tmp_path, monkeypatch):
    """Return the arguments of setup() in a copy of the package that has been used."""
    shutil.copy(ROOT / 'setup.py', tmp_path)
    for name in 'config', 'launch', 'resource':
        shutil.copytree(ROOT / name, tmp_path / name)
        (tmp_path / name / '__pycache__').mkdir(exist_ok=True)
    given = {}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(setuptools, 'setup', lambda **arguments: given.update(arguments))
    runpy.run_path('setup.py')
    return given


def test_data_files_are_files(used):
    listed = [Path(path) for _, paths in used['data_files'] for path in paths]

    assert {path for path in listed if path.is_dir()} == set()
    for folder in 'config', 'launch':
        assert {path.name for path in listed if path.parent.name == folder} == {
            path.name for path in (ROOT / folder).iterdir() if path.is_file()}
