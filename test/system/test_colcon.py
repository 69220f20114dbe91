# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""colcon builds, installs and tests the package in a workspace."""

import shutil
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest

from fej_slam_ros.cli.main import VERBS
from helpers.paths import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.needs('colcon_core', 'rclpy')]

SOURCES = (
    'package.xml', 'setup.py', 'setup.cfg', 'resource', 'config', 'launch', 'fej_slam_ros', 'test')
#: Tests that `colcon test` runs here.
SOME = 'test/unit/core/test_geometry.py', 'test/live/test_lifecycle.py'
#: Imports each test module as launch_testing does, and lets `Skipped` escape.
LAUNCH_TESTING = """
from _pytest.pathlib import import_path
import pytest

def pytest_pycollect_makemodule(module_path, parent):
    more = {} if pytest.version_tuple < (8, 1) else {'consider_namespace_packages': False}
    import_path(module_path, root=None, **more)
    return pytest.Module.from_parent(parent, path=module_path)
"""


def bash(folder, script):
    """Run a script and return what it printed; show that where it fails."""
    process = subprocess.run(
        ['bash', '-ec', script], cwd=folder, capture_output=True, text=True, check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def names(folder):
    return {path.name for path in folder.iterdir() if path.name != '__pycache__'}


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a folder in which colcon has built a copy of the package."""
    workspace = tmp_path_factory.mktemp('workspace')
    package = workspace / 'src' / 'fej_slam_ros'
    package.mkdir(parents=True)
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, package / name)
    for name in 'config', 'launch':
        (package / name / '__pycache__').mkdir(exist_ok=True)
    bash(workspace, f'{sys.executable} -m colcon build')
    return workspace


def test_colcon_installs_one_executable_per_verb(workspace):
    executables = workspace / 'install/fej_slam_ros/lib/fej_slam_ros'

    assert names(executables) == set(VERBS)


@pytest.mark.parametrize('verb', VERBS)
def test_an_installed_executable_prints_its_usage(workspace, verb):
    usage = bash(
        workspace, f'. install/setup.bash; install/fej_slam_ros/lib/fej_slam_ros/{verb} --help',
    )

    assert usage.startswith(f'usage: {verb}')


@pytest.mark.parametrize('folder', ['config', 'launch'])
def test_colcon_installs_every_file_of(workspace, folder):
    installed = workspace / 'install/fej_slam_ros/share/fej_slam_ros' / folder

    assert names(installed) == names(ROOT / folder)


def test_colcon_test_runs_the_tests_beside_the_plugin_of_launch_testing(workspace, tmp_path):
    (tmp_path / 'imports_modules.py').write_text(LAUNCH_TESTING)
    about = tmp_path / 'launch_testing-1.0.dist-info'
    about.mkdir()
    (about / 'METADATA').write_text('Metadata-Version: 2.1\nName: launch_testing\nVersion: 1.0\n')
    (about / 'entry_points.txt').write_text('[pytest11]\nlaunch_testing = imports_modules\n')

    bash(workspace, f"""
        export PYTHONPATH={tmp_path}:$PYTHONPATH
        {sys.executable} -m colcon test --pytest-args {' '.join(SOME)}""")

    suite = ET.parse(  # noqa: S314, written by pytest
        workspace / 'build/fej_slam_ros/pytest.xml').find('testsuite')
    counts = {name: int(suite.get(name)) for name in ('tests', 'errors', 'failures', 'skipped')}
    assert counts.pop('tests') > 10
    assert set(counts.values()) == {0}
