# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of topics, thousands in a large team, cost nothing when they are declared."""

import pytest

from helpers.optional import optional

live_parameters = optional('fej_slam_ros.ros.nodes.live_parameters')
rclpy_parameter = optional('rclpy.parameter')

pytestmark = pytest.mark.ros


class Node:
    """Keeps the callbacks of parameters that are set, as rclpy calls them."""

    def add_pre_set_parameters_callback(self, callback):
        self.before = callback

    def add_on_set_parameters_callback(self, callback):
        self.on_set = callback

    def add_post_set_parameters_callback(self, callback):
        self.after = callback

    def has_parameter(self, _name):
        return False


def test_parameters_of_topics_do_not_ask_for_those_of_all_robots():
    node, asked = Node(), []
    live_parameters.LiveParameters(node, asked.append, lambda: asked.append('all') or {})
    declared = [
        rclpy_parameter.Parameter(f'qos_overrides./r1/odom.subscription.{policy}', value=1)
        for policy in ('depth', 'history')]

    assert node.on_set(node.before(declared)).successful
    node.after(declared)

    assert asked == []


def test_other_parameters_are_compared_with_those_in_force_once():
    node, asked = Node(), []
    live_parameters.LiveParameters(node, asked.append, lambda: asked.append('all') or {})
    changes = [rclpy_parameter.Parameter(name, value=1.0) for name in ('one', 'other')]

    assert node.on_set(changes).successful

    assert asked == ['all']
