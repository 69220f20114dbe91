# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node publishes predicted poses and fused odometry without waiting for other robots."""

import pytest

from helpers.optional import optional
from helpers.records import MS, odometry
from helpers.ros import meeting, ODOMETRY, raw_record

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros


def stamps(messages):
    """Return the stamps of messages in ms."""
    return [m.header.stamp.sec * 1000 + m.header.stamp.nanosec // MS for m in messages]


def test_poses_of_a_robot_are_predicted_while_it_waits_for_a_slow_one(domain):
    domain.estimate(robots=['r1', 'r2'], stale_after=30.0)
    settled = domain.listen('r1/pose', live_helpers.POSE)
    predicted = domain.listen('r1/predicted_pose', live_helpers.POSE)
    fused = domain.listen('r1/odometry/filtered', ODOMETRY)
    domain.wait_for_reports()

    domain.send(*map(raw_record, meeting()))
    domain.until(lambda: 400 in stamps(predicted) and 200 in stamps(settled))
    domain.send(*(raw_record(odometry('r1', ms)) for ms in range(420, 1000, 20)))
    domain.until(lambda: 980 in stamps(predicted) and 980 in stamps(fused))

    assert max(stamps(settled)) < 400
    assert set(range(420, 1000, 20)) <= set(stamps(predicted))
    last = predicted[-1]
    # Robot r1 drives from the origin of map at 1 m/s; the meeting is exact but for rounding.
    assert (last.header.frame_id, last.pose.pose.position.x) == ('map', pytest.approx(0.98))
    assert fused[-1].child_frame_id == 'r1/base_link'
