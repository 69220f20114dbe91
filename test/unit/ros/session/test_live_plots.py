# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plots show one node of this package, whatever other nodes publish on /diagnostics."""

import json

import pytest

from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session.live_plots import consistency, MAX_SILENCE, PlottedNode

NIS = {'sightings_used': 5, 'nis_ratio': 1.5, 'nis_band': '0.500..2.000'}


def report(*names, **values):
    """Return a report of robots."""
    return outgoing.diagnostics(0, [
        outgoing.diagnostic_status(name, 0, '', values, name.rpartition(': ')[2])
        for name in names])


def plotted(**values):
    """Return what is plotted of a robot with values."""
    robot, = consistency({'r1': {name: str(value) for name, value in values.items()}})['robots']
    return robot


def test_each_value_has_its_band():
    robot = plotted(**NIS, nees_latest=0.7)

    assert (robot['nis'], robot['nis_low'], robot['nis_high']) == (1.5, 0.5, 2.0)
    assert robot['nees_low'] < robot['nees'] == 0.7 < robot['nees_high']


@pytest.mark.parametrize('values', [
    {}, {'nis_band': '0.5..2.0'}, {'nis_ratio': 1.0}, {'nis_ratio': 1.0, 'nis_band': 'wide'},
    {'nis_ratio': 1.0, 'nis_band': '0..0'}, {'nis_ratio': 'nan', 'nis_band': '0.5..2.0'},
    {'nis_ratio': 1.0, 'nis_band': '..'}, {'nis_ratio': '1e999', 'nis_band': '0.5..2.0'},
    {'nees_latest': 'inf'}, {'nees_latest': ''}, {'nees_latest': '[1, 2]'}])
def test_values_that_are_missing_or_no_finite_numbers_are_left_out(values):
    robot = plotted(**values)

    assert robot == {'name': 'r1'}
    assert json.loads(json.dumps(robot, allow_nan=False)) == robot


@pytest.mark.parametrize('message', [
    report(), report('motor: left', voltage=3), report('r1', **NIS), report(': ', **NIS),
    outgoing.diagnostics(0, [outgoing.diagnostic_status('estimator: r1', 0, '', NIS, 'm1')])])
def test_other_statuses_are_no_robots(message):
    assert PlottedNode().robots_of(message, 0.0) == {}


def test_a_second_node_is_not_mixed_with_the_first():
    node = PlottedNode()
    assert [*node.robots_of(report('estimator: r1', **NIS), 0.0)] == ['r1']

    assert node.robots_of(report('fleet/estimator: r1', 'fleet/estimator: r2', **NIS), 0.1) == {}

    assert [*node.robots_of(report('estimator: r1', **NIS), 1.0)] == ['r1']
    assert (node.take_ignored(), node.take_ignored()) == (['fleet/estimator'], [])


def test_another_node_takes_the_place_of_a_silent_one():
    node = PlottedNode()
    node.robots_of(report('estimator: r1', **NIS), 0.0)

    found = node.robots_of(report('other: r2', **NIS), MAX_SILENCE + 0.1)

    assert ([*found], node.name) == (['r2'], 'other')


def test_an_estimator_takes_the_place_of_a_smoother():
    node = PlottedNode()
    node.robots_of(report('smoother: r1', sightings_used=5), 0.0)

    node.robots_of(report('estimator: r1', **NIS), 0.1)

    assert node.robots_of(report('smoother: r1', sightings_used=5), 0.2) == {}
    assert node.name == 'estimator'
