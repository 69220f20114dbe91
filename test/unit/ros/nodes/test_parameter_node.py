# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the executor has found ready before it was destroyed does nothing."""

from unittest import mock

import pytest

from helpers.optional import optional

live_helpers = optional('helpers.live')

pytestmark = pytest.mark.ros


def found_ready(handlers):
    """Let handlers of events be found ready, as by an executor."""
    wait_set = mock.Mock()
    wait_set.is_ready.return_value = True
    for handler in handlers:
        handler.add_to_wait_set(wait_set)
        assert handler.is_ready(wait_set)


def test_events_of_topics_that_are_destroyed_meanwhile_do_not_end_the_node(domain):
    node = domain.estimate(robots=['r1'])
    odometry, = (s for s in node.subscriptions if s.topic_name == '/r1/odom')
    poses, = (p for p in node.publishers if p.topic_name == '/r1/pose')
    handlers = [*odometry.event_handlers, *poses.event_handlers]
    found_ready(handlers)

    node.destroy_subscription(odometry)
    node.destroy_lifecycle_publisher(poses)

    assert len(handlers) > 1
    assert [handler.take_data() for handler in handlers] == [None] * len(handlers)
