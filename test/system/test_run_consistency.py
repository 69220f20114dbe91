# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics distinguish a filter that is given too little noise from a consistent one."""

from itertools import takewhile

import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import with_scaled_noise
from helpers.ros import raw_record, run_settings, through_cdr
from helpers.slow import slow

OK, WARN = 0, 1


def reports(seed, seconds, noise_told_as=1.0):
    """Yield level and sentence of robots and filter after each second of a simulated run."""
    simulated = simulation.parse({'seed': seed, 'loops': -(-5 * seconds // 63)})
    run = EstimatorSession(run_settings(), None)
    due = simulation.FIRST_STAMP + NS
    end = simulation.FIRST_STAMP + seconds * NS
    for record in takewhile(lambda record: record.stamp <= end, simulated.records()):
        run.receive(raw_record(with_scaled_noise(noise_told_as, record)))
        for _ in run.take():
            pass
        if record.stamp >= due:
            due += NS
            _, report = run.diagnostics.report(record.stamp, at_rest=False)
            yield [(status.level, status.message) for status in through_cdr(report).status]


@pytest.mark.parametrize(
    ('seed', 'minutes'),
    [(0, 2)] + [slow(seed, 10) for seed in range(20)])
def test_a_consistent_filter_stays_ok(seed, minutes):
    for report in reports(seed, 60 * minutes):
        assert report == [
            (OK, 'in map'), (OK, 'in map'), (OK, 'compatible'), (OK, 'no error'),
            (OK, 'running')]


@pytest.mark.parametrize('seed', [0, *map(slow, range(1, 20))])
def test_a_filter_with_a_third_of_the_noise_gives_a_warning_within_a_minute(seed):
    for number in range(2):
        assert any(
            report[number][0] >= WARN and 'overconfident by' in report[number][1]
            for report in reports(seed, 60, noise_told_as=1.0 / 3.0))
