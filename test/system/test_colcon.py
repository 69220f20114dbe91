# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import shutil
import subprocess
import sys

import pytest

from fej_slam_ros.cli.main import VERBS
from helpers.paths import ROOT

SOURCES = ('package.xml', 'setup.py', 'setup.cfg', 'resource', 'config', 'launch', 'fej_slam_ros')


def bash(folder, script):
    """Return what a script printed; where it fails, show that."""
    process = subprocess.run(
        ['bash', '-ec', script], cwd=folder, capture_output=True, text=True, check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a folder in which colcon has built a copy of the package."""
    pytest.importorskip('colcon_core', reason='colcon is not installed')
    workspace = tmp_path_factory.mktemp('workspace')
    package = workspace / 'src' / 'fej_slam_ros'
    package.mkdir(parents=True)
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, package / name)
    bash(workspace, f'{sys.executable} -m colcon build')
    return workspace


@pytest.mark.ros
def test_colcon_installs_one_executable_a_verb(workspace):
    executables = workspace / 'install/fej_slam_ros/lib/fej_slam_ros'

    assert names(executables) == set(VERBS)


@pytest.mark.ros
@pytest.mark.parametrize('verb', VERBS)
def test_an_installed_executable_says_how_it_is_used(workspace, verb):
    usage = bash(
        workspace, f'. install/setup.bash; install/fej_slam_ros/lib/fej_slam_ros/{verb} --help',
    )

    assert usage.startswith(f'usage: fej_slam {verb}')


@pytest.mark.ros
@pytest.mark.parametrize('folder', ['config', 'launch'])
def test_colcon_installs_every_file_of(workspace, folder):
    installed = workspace / 'install/fej_slam_ros/share/fej_slam_ros' / folder

    assert names(installed) == names(ROOT / folder)
