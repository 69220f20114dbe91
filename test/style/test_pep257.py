# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from helpers.optional import optional
from helpers.paths import ROOT, SOURCES

pytestmark = [pytest.mark.linter, pytest.mark.needs('ament_pep257')]

pep257 = optional('ament_pep257.main')


def test_docstrings_follow_pep257():
    # D417 does not know numpydoc's one-line parameters; pydocstyle's own numpy set omits it too.
    arguments = '--add-ignore', 'D417', '--', *(str(ROOT / name) for name in SOURCES)

    assert pep257.main(argv=list(arguments)) == 0
