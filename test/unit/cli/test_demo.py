# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`demo` without what it needs; live/test_demo.py runs it."""

import sys

from helpers.ros import assert_one_sentence, run_verb


def test_missing_matplotlib_is_reported_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'matplotlib', None)

    status = run_verb('demo', '--output', tmp_path / 'demo')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'matplotlib is missing', '.[plot]')
