# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rejected observations are published once, in their order."""

import numpy as np
import pytest

from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.outputs import rejections, thinned
from helpers.records import scan
from helpers.ros import drive, meeting, raw_record, run_settings, through_cdr


def published_rejections(*observations):
    """Return a run with a scan of a robot that knows the map, and the values of its rejections."""
    run = EstimatorSession(run_settings(), None)
    published = drive(run, map(raw_record, [*meeting(), scan('r1', 400, observations)]))
    return run, [
        {value.key: value.value for value in through_cdr(message).values}
        for topic, message in published if topic == '~/rejections']


def test_a_rejected_observation_is_published_once():
    run, rejected = published_rejections((1, (-9.0, 3.0)))

    (values,) = rejected
    assert (values['robot'], values['id'], values['reason']) == ('r1', '1', 'gated')
    # Chi-square with two degrees of freedom: -2 ln(1 - 0.999).
    assert float(values['threshold']) == pytest.approx(-2.0 * np.log(0.001), rel=1e-9)
    assert float(values['d2']) > float(values['threshold'])
    assert list(rejections(run.estimator.statistics)) == []


def test_rejections_are_published_in_their_order():
    _, rejected = published_rejections((1, (-9.0, 3.0)), (2, (-9.0, 3.0)))

    assert [values['id'] for values in rejected] == ['1', '2']


@pytest.mark.parametrize('most', [1, 3, 4, 9, 10, 20])
def test_a_thinned_path_is_evenly_spaced_and_ends_with_the_newest_pose(most):
    path = [(stamp, np.zeros(3)) for stamp in range(10)]

    stamps = [stamp for stamp, _ in thinned(path, most)]

    assert stamps[-1] == 9
    assert len(stamps) <= most
    assert len({*np.diff(stamps)}) <= 1
