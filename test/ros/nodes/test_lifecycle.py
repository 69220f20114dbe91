# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator is a managed node: it begins, rests and ends when it is told to."""

import json
import signal

from stream_helpers import MS
import pytest
from ros_helpers import meeting, raw_record, write_parameters

live_helpers = pytest.importorskip('live_helpers', reason='rclpy is not installed')
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2']}


def change(domain, label):
    """Ask for a transition and return whether it was made."""
    transition = Transition(label=label)
    return domain.ask('/estimator/change_state', ChangeState, transition=transition).success


def state(domain):
    return domain.ask('/estimator/get_state', GetState).current_state.label


def listeners(domain, topic):
    return len(domain.node.get_subscriptions_info_by_topic(topic))


def steps_of(folder):
    """Return the stamps of the poses of r1 in the files of a run, in ms."""
    rows = (folder / 'trajectory_r1.csv').read_text().splitlines()[1:]
    return [int(row.partition(',')[0]) // MS for row in rows]


@pytest.mark.parametrize(('given', 'expected'), [
    ({}, 'active'), ({'autostart': True}, 'active'), ({'autostart': False}, 'unconfigured')])
def test_a_node_is_active_from_the_start_unless_told_to_wait(domain, given, expected):
    domain.estimate(**TEAM, **given)

    assert state(domain) == expected

def test_wrong(domain):
    domain.estimate(**TEAM)
    assert not change(domain, 'activate')
    assert not domain.ask('/estimator/change_state', ChangeState, transition=Transition(id=77)).success
    assert not domain.ask('/estimator/change_state', ChangeState, transition=Transition(id=1)).success
    assert state(domain) == 'active'
