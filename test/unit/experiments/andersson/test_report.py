# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Report of the C-SAM experiments: entries over runs, requirements, and equal files."""

import csv
from dataclasses import replace
from io import StringIO
import json

import numpy as np
import pytest

from fej_slam_ros.experiments.andersson import report
from fej_slam_ros.experiments.andersson.experiment import (
    CsamRun, CsamTask, EXPERIMENTS, JoinGain, run)
from fej_slam_ros.experiments.common.executor import in_order, processes

A = CsamTask('map_joining', 3)
B = CsamTask('sensor_extension', 2)


def gain(**changes):
    """Return what a run may have gained, with numbers that are easy to reckon with."""
    before = {robot: np.arange(101.0) for robot in 'pq'}
    joined = {'p': 0.5 * before['p'], 'q': np.minimum(before['q'], 50.0)}
    return replace(JoinGain(
        9, 0, {'poses': 1.0, 'landmarks': 0.9, 'base_node': 1.1}, 1.01, before, joined, 1.25,
        (40, 60)), **changes)


def made_up(task, join_gain, rejection_reason=''):
    sizes = {'p': {'subset': 30, 'log': 20, 'map': 90}, 'q': {'subset': 10, 'log': 20, 'map': 90}}
    return CsamRun(task, 10, sizes, join_gain, rejection_reason)


@pytest.fixture
def runs():
    """Return synthetic runs: two of A, one of them not joined, and one of B."""
    return [
        made_up(A, gain(false=1, nees={'poses': 2.0, 'landmarks': 1.0, 'base_node': 1.0})),
        made_up(A._replace(seed=4), None, 'cannot align: test'), made_up(B, gain())]


def test_entries_are_over_all_runs_and_say_what_is_met(runs):
    table = report.entries(runs[:2])

    assert {name: entry.value for name, entry in table.items()} == pytest.approx({
        'joined': 50.0, 'found': 45.0, 'false': 10.0, 'touched': 50.0, 'nees_poses': 2.0,
        'nees_landmarks': 1.0, 'nees_base_node': 1.0, 'chi_square': 1.01, 'ratio_p': 0.5,
        'ratio_q': (sum(range(51)) + 50 * 50.0) / 5050.0, 'by_sample_p': 0.5,
        'by_sample_q': (50.0 + sum(50.0 / k for k in range(51, 101))) / 100.0,
        'not_worse_p': 100.0, 'not_worse_q': 100.0, 'worst_p': 0.5, 'worst_q': 1.0,
        'big_step': 0.5}, rel=1e-12)
    assert [name for name, entry in table.items() if entry.is_met is False] == [
        'found', 'false', 'touched', 'nees_poses', 'ratio_q']
    assert report.entries(runs[2:])['q_over_p'].is_met is False


def test_runs_without_a_joined_one_have_no_associations(runs):
    table = report.entries(runs[1:2])

    assert {name: entry.value for name, entry in table.items()} == {
        'joined': 0.0, 'found': 0.0, 'false': 0.0, 'touched': 0.0}
    assert 'Seed 4 was not joined' in report.markdown(runs[1:2])


def test_the_page_has_requirements_values_and_frames(runs):
    text = report.markdown(runs)

    assert '| NEES/3 of joined poses | 0.85 to 1.17 | 2.000 | **not met** |' in text
    assert '| true associations found [%] | at least 98.5 | 45.00 | **not met** |' in text
    assert 'in its longest landmark gap, joined / before | at most 0.6 | 0.500 | met |' in text
    assert "Q's heading sigma / P's, in P's frame | at most 1.2 | 1.250 | **not met** |" in text
    assert 'Seed 4 was not joined: cannot align: test.' in text
    assert '| P | 30 | 20 | 90 | log |\n| Q | 10 | 20 | 90 | subset |' in text
    assert '| Q | 20000.0 -> 20000.0 | 40000.0 -> 40000.0 | 55000.0 -> 50000.0 |' in text
    assert 'in the frame of **its own start**' in text


def test_there_is_a_row_for_each_run(runs):
    file = StringIO()
    csv.writer(file).writerows(report.csv_rows(runs))
    file.seek(0)

    first, second, third = csv.DictReader(file)

    assert [first[name] for name in ('seed', 'shared', 'found', 'false')] == ['3', '10', '9', '1']
    assert (float(first['big_step']), first['q_over_p'], first['subset_q']) == (0.5, '', '10')
    assert (second['refusal'], second['found']) == ('cannot align: test', '')
    assert (third['experiment'], third['big_step'], third['q_over_p']) == (
        'sensor_extension', '', '1.25')


def test_the_summary_is_json(runs):
    content = json.loads(json.dumps(report.summary(runs), allow_nan=False))

    assert content['map_joining']['entries']['found'] == {
        'value': 45.0, 'asked': [98.5, None], 'held': False}
    assert content['map_joining']['not_joined'] == {'4': 'cannot align: test'}
    assert content['sensor_extension']['bytes']['q'] == {'subset': 10.0, 'log': 20.0, 'map': 90.0}


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('experiment', EXPERIMENTS)
def test_100_runs_meet_all_requirements(experiment):
    with processes(2) as workers:
        runs = [*in_order(workers, run, [CsamTask(experiment, k) for k in range(1, 101)])]

    missed = {n: e for n, e in report.entries(runs).items() if e.is_met is False}
    assert not missed
    assert all(run.gain is not None for run in runs)
