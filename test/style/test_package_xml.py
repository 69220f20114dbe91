# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import ast
import re

import pytest

import fej_slam_ros
from helpers.optional import optional
from helpers.paths import ROOT

pytestmark = [pytest.mark.linter, pytest.mark.needs('catkin_pkg')]

catkin = optional('catkin_pkg.package')


@pytest.fixture
def package():
    return catkin.parse_package(str(ROOT / 'package.xml'))


def test_package_xml_is_valid():
    warnings = []

    catkin.parse_package(str(ROOT / 'package.xml'), warnings=warnings)

    assert not warnings


def test_all_files_state_the_same_version(package):
    in_setup = re.search(r"version='(.*)'", (ROOT / 'setup.py').read_text())
    in_changelog = re.search(r'^(\S+) \(', (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE)

    assert fej_slam_ros.__version__ == in_setup[1] == in_changelog[1] == package.version


def test_every_ros_package_that_is_imported_is_declared(package):
    sources = [*ROOT.glob('fej_slam_ros/**/*.py'), *ROOT.glob('launch/*.py')]
    nodes = [node for path in sources for node in ast.walk(ast.parse(path.read_text()))]
    imported = {
        node.module.partition('.')[0]
        for node in nodes if isinstance(node, ast.ImportFrom) and node.module
    } | {
        alias.name.partition('.')[0]
        for node in nodes if isinstance(node, ast.Import) for alias in node.names
    }
    ros = {
        name for name in imported
        if re.fullmatch(
            'rclpy|launch|launch_ros|ament_index_python|.*_(interfaces|msgs|srvs)', name)
    }

    assert ros <= {depend.name for depend in package.exec_depends}
