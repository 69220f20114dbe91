# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every rejection reason is a finding with a cure."""

from collections import Counter
from unittest import mock

import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.doctor import rejections
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import REASONS_OF_THE_RUN
from helpers.records import team


@pytest.mark.parametrize(
    'reason', sorted(
        {*RejectionReason} - {RejectionReason.AFTER_TIME_JUMP, *REASONS_OF_THE_RUN}))
def test_each_reason_has_a_cure_without_placeholders(reason):
    trial = mock.Mock(
        rejected=Counter({('r1/landmarks', reason): 1000}), first={('r1/landmarks', reason): 5},
        stale={'r1/landmarks': Counter(r2=1000)})
    trial.inputs.time_jump_detector.jump = None

    finding, = rejections.check(Survey(), trial, team())

    assert (finding.name, finding.where, finding.stamp) == (reason.value, 'r1/landmarks', 5)
    assert finding.cure
    assert '{' not in finding.cure
    assert ("'r2' (1000)" in finding.what) == (reason is RejectionReason.OTHER_ROBOT_STALE)
