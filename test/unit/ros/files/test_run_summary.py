# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a run has its input statistics, its configuration, and errors by ground truth."""

import json

import numpy as np
import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.parameters import as_parameters
from helpers.ros import (
    csv_rows, finished_run, LANDMARKS, meeting_truth, noisy_meeting, odometry_message, raw,
    raw_record, run_settings, summary_of)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / 'results'


def test_the_summary_holds_all_figures(folder):
    truth = [raw_record(record) for record in meeting_truth(8)]
    late = raw('r1/odom', odometry_message(50), 700)
    stranger = raw('r9/odom', odometry_message(50), 700)
    messages = noisy_meeting()

    run, content = finished_run(folder, [*truth, *messages, late, stranger])

    summary = summary_of(folder)
    assert summary == json.loads(json.dumps(content))
    assert {'state_hash', 'counts', 'nis', 'rmse', 'nees', 'config', 'versions'} <= set(summary)
    assert summary['state_hash'] == run.estimator.state_hash()
    assert summary['counts'] == {
        **{reason.value: 0 for reason in RejectionReason}, 'released_without': 0,
        'late': 1, 'unknown_robot': 1, 'used': len(truth) - 1 + len(messages)}
    assert summary['depends_on_arrival'] is True
    assert summary['config'] == as_parameters(run_settings())


def test_errors_compare_the_trajectory_with_ground_truth(folder):
    finished_run(folder, [*map(raw_record, meeting_truth(8)), *noisy_meeting()])

    scores = summary_of(folder)
    xy = np.array([[float(r['x']), float(r['y'])] for r in csv_rows(folder / 'trajectory_r1.csv')])
    errors = xy - np.column_stack([np.arange(8) / 10.0, np.zeros(8)])
    assert scores['rmse']['r1']['position'] == pytest.approx(
        np.sqrt(np.mean(np.sum(errors**2, axis=1))), rel=1e-12)
    found = np.array([[float(r['x']), float(r['y'])] for r in csv_rows(folder / 'landmarks.csv')])
    assert scores['rmse']['landmarks'] == pytest.approx(
        np.sqrt(np.mean(np.sum((found - [*LANDMARKS.values()])**2, axis=1))), rel=1e-12)
    assert scores['rmse']['r2']['steps'] == 7  # it joins at the second of its eight steps
    assert set(scores['nees']) == {'r1', 'r2', 'landmarks'}


def test_without_ground_truth_there_are_no_errors(folder):
    _, content = finished_run(folder, noisy_meeting())

    assert not {'rmse', 'nees'} & set(content)
