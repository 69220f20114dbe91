# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clock differences between the robots of a bag."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.doctor.clocks import check
from fej_slam_ros.ros.doctor.survey import OdometrySeries, Survey, TopicSeries
from helpers.records import team


def skewed(**ahead):
    """Return 10 s of odometry of robots whose clocks lead that of the recorder [s]."""
    logged = np.arange(0, 10 * NS, NS // 10)
    survey = Survey()
    survey.topics |= {
        f'{robot}/odom': OdometrySeries((logged + round(offset * NS)).tolist(), logged.tolist())
        for robot, offset in ahead.items()}
    return survey


@pytest.mark.parametrize('wrong', ['r1', 'r2', 'r3'])
@pytest.mark.parametrize('offset', [-2.0, 0.5, 2.0])
def test_of_three_clocks_the_one_that_differs_is_named(wrong, offset):
    clocks = {'r1': 0.0, 'r2': 0.0, 'r3': 0.0, wrong: offset}

    found = [*check(skewed(**clocks), team('r1', 'r2', 'r3'), clock_limit=1.0)]

    assert [(finding.name, finding.where) for finding in found] == [('clock_skew', wrong)]


@pytest.mark.parametrize(('ahead', 'found'), [
    (0.0, [('no_overlap', 'warning')] * 3),
    (60.0, [('no_overlap', 'error')] * 3 + [('clock_skew', 'error')])])
def test_robots_that_drive_one_after_another_cost_nothing_if_their_clocks_agree(ahead, found):
    begins = {'r1': 0, 'r2': 1000, 'r3': 3000}
    logged = np.arange(0, 10 * NS, NS // 10)
    survey = Survey()
    survey.topics |= {
        f'{robot}/odom': OdometrySeries(
            (logged + begin * NS + round(ahead * NS) * (robot == 'r3')).tolist(),
            (logged + begin * NS).tolist())
        for robot, begin in begins.items()}

    findings = [*check(survey, team(*begins), clock_limit=1.0)]

    assert [(finding.name, finding.severity.value) for finding in findings] == found


@pytest.mark.parametrize(('offset', 'found'), [
    (0.05, []), (0.3, ['warning']), (0.5, ['error'])])
def test_clocks_that_differ_are_named_also_where_max_delay_waits_for_slow_detectors(offset, found):
    settings = replace(team('r1', 'r2'), max_delay=0.3)

    findings = [*check(skewed(r1=0.0, r2=offset), settings, clock_limit=1.0)]

    assert [finding.severity.value for finding in findings] == found


@pytest.mark.parametrize(('late', 'sensor_delay', 'found'), [
    (-0.3, 0.0, ['delayed']), (-0.3, -0.3, []), (0.3, 0.0, ['clock_skew']), (0.3, 0.3, []),
    (0.0, 0.3, ['delayed'])])
def test_a_delay_that_is_corrected_is_not_named(late, sensor_delay, found):
    survey = skewed(r1=0.0)
    logged = survey.topics['r1/odom'].logged
    survey.topics['r1/landmarks'] = TopicSeries(
        [stamp + round(late * NS) for stamp in logged], logged)
    settings = team('r1', max_delay=0.1)
    (robot,) = settings.robots

    findings = [*check(
        survey, replace(settings, robots=(replace(robot, sensor_delay=sensor_delay),)),
        clock_limit=1.0)]

    assert [finding.name for finding in findings] == found
