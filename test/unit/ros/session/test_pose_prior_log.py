# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rejected pose has a line with its reason; test_estimator_reports.py has those in use."""

import numpy as np
import pytest

from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.ros import log_texts, raw, raw_record, run_settings


def test_a_message_that_is_no_pose_prior_is_rejected_with_its_reason():
    run = EstimatorSession(run_settings(), None)

    run.receive(raw_record(PosePrior('r2', 0, np.full(3, np.nan), np.eye(3))))

    assert log_texts(run) == [f'set_pose of r2 rejected: {RejectionReason.NOT_FINITE.value}']


@pytest.mark.parametrize(('prior', 'frame', 'cure'), [
    (np.eye(3), 'r2/odom',
     "wrong_frame, give it in 'map', which is to be the fixed frame of RViz"),
    (np.zeros((3, 3)), 'map',
     'bad_covariance, give the variances of x, y and yaw, all of them above zero')])
def test_a_rejected_pose_is_logged_with_its_cure(prior, frame, cure):
    run = EstimatorSession(run_settings(), None)
    _, message = outgoing.input_message(PosePrior('r2', 0, np.zeros(3), prior), {})
    message.header.frame_id = frame

    run.receive(raw('r2/set_pose', message, 0))

    assert log_texts(run) == [f'set_pose of r2 rejected: {cure}']
