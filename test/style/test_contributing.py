# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CONTRIBUTING.md names files and folders that exist."""

import re

from helpers.paths import ROOT

#: Files that a contributor makes have a name in angle brackets.
PATH = re.compile(r'`((?:[\w.-]+/)+[\w.-]*|[\w-]+\.py)`')


def test_every_path_of_the_guide_exists():
    guide = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')

    paths = {path for path in PATH.findall(guide) if not path.startswith('.')}

    assert len(paths) > 30
    assert not {
        path for path in paths
        if not any((folder / path).exists() for folder in (
            ROOT, ROOT / 'fej_slam_ros', ROOT / 'fej_slam_ros' / 'core'))}
