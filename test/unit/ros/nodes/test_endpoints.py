# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The end of a process does not wait long for subscribers."""

from time import monotonic, sleep

import pytest

from fej_slam_ros.errors import UserError
from helpers.optional import optional

endpoints = optional('fej_slam_ros.ros.nodes.endpoints')

pytestmark = pytest.mark.ros


def test_a_missing_package_is_named_with_its_cure_and_ways_without_it():
    with pytest.raises(UserError, match=(
            'need the package nix_msgs: apt install ros-jazzy-nix-msgs, .*fej_slam adapt.*'
            r'formats: \[marker_array\]')):
        endpoints.check_installed(['nav_msgs/msg/Odometry', 'nix_msgs/msg/Nothing'])


class Silent:
    """A publisher whose subscriber acknowledges nothing."""

    def __init__(self):
        self.waits = 0

    def wait_for_all_acked(self, timeout):
        self.waits += 1
        sleep(timeout.nanoseconds * 1e-9)
        return False


def test_the_wait_for_acknowledgements_ends_when_it_is_urgent():
    publishers = [Silent(), Silent()]
    began = monotonic()

    endpoints.wait_for_arrival(publishers, lambda: publishers[0].waits == 3)

    assert [publisher.waits for publisher in publishers] == [3, 0]
    assert monotonic() - began < endpoints.MAX_ACK_WAIT
