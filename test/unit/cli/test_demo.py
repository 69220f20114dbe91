# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`demo` without what it needs; live/test_demo.py runs it."""

import sys

import pytest

from helpers.ros import assert_one_sentence, run_verb


def test_missing_matplotlib_is_reported_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'matplotlib', None)

    status = run_verb('demo', '--output', tmp_path / 'demo')

    assert_one_sentence((status, *capsys.readouterr()), 1, 'matplotlib is missing', '.[plot]')


@pytest.mark.parametrize('name', [
    'scene.png', 'summary.json', 'landmarks.csv', 'ids.csv', 'r1.tum', 'r2.tum',
    'trajectory_r1.csv', 'trajectory_r2.csv'])
def test_no_file_of_another_run_is_overwritten_without_force(tmp_path, capsys, name):
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    (tmp_path / name).write_text('of another run')

    status = run_verb('demo', '--output', tmp_path)

    assert_one_sentence((status, *capsys.readouterr()), 2, f'{name} exists', '--force')
