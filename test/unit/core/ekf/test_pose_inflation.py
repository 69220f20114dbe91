# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that is a few standard deviations off is corrected by scans that fit the map."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf.consecutive_rejections import ConsecutiveRejections
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Association, Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.pose_inflation import inflate_poses
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import compose, inverse, transform
from fej_slam_ros.core.records import Observation

POINTS = np.array([[4.0, 0.5], [3.0, -2.0], [1.0, 3.0], [-2.0, 2.5]])
#: Standard deviations of the pose, and of observations.
SIGMA, NOISE = np.array([0.02, 0.02, 0.01]), 0.01
#: An error of the pose of 6 standard deviations of the heading, by which the distances of
#: observations are within 13.8, the limit of the gate, and 41.4, that of a contradiction.
SLIP = np.array([0.0, 0.0, 0.06])


def scan(error, count=4, moved=None, ids=None, sigma=SIGMA):
    """
    Return a filter of one robot, and its scan after an error of its pose.

    The first landmarks of POINTS are in the map almost exactly, one of which was moved, or which
    the scan has under other IDs.

    """
    state = JointState()
    robot = state.insert_robot('r', 0, np.zeros(3), np.diag(sigma**2))
    landmarks = [
        state.augment(('', k), robot, point, np.zeros((2, 3)), 1e-12 * np.eye(2))
        for k, point in enumerate(POINTS[:count])]
    true = POINTS[:count].copy()
    if moved is not None:
        true[moved] += [0.1, 0.1]
    z = transform(inverse(compose(np.zeros(3), error)), true)
    return Filter(state, FirstEstimates(), Gate(0.999)), [
        Association(robot, landmarks[k], Observation(k, z_k, NOISE**2 * np.eye(2)))
        for k, z_k in zip(ids or range(count), z)]


def updated(filter_, observations, may_have_slipped=True, rejections=None):
    """Return P (3, 3) of the robot before and after its covariance is inflated."""
    innovation = filter_.update(observations)
    (robot,) = filter_.state.robots.values()
    before = filter_.state.marginal([robot])
    statistics = innovation.scan_gate_statistics()
    rejections = rejections or ConsecutiveRejections()
    rejections.add(innovation, statistics)
    inflate_poses(filter_, innovation, statistics, rejections, lambda _: may_have_slipped)
    return before, filter_.state.marginal([robot])


def test_the_error_becomes_one_standard_deviation_of_three_dimensions():
    filter_, observations = scan(SLIP)

    before, after = updated(filter_, observations)

    error = SLIP - filter_.state.pose(observations[0].observer)
    assert_allclose(before, np.diag(SIGMA**2))
    # E d2 of 3 dimensions; the scan itself is free of noise.
    assert error @ np.linalg.solve(after, error) == pytest.approx(3.0)
    assert_allclose(after / after[0, 0], before / before[0, 0], atol=1e-9)


def test_the_next_scan_corrects_the_pose():
    filter_, observations = scan(SLIP)
    updated(filter_, observations)

    filter_.update(observations)

    # The noise of the mean of four observations.
    assert_allclose(
        filter_.state.pose(observations[0].observer), SLIP, atol=NOISE / 2.0)


def test_without_it_scan_after_scan_fails():
    filter_, observations = scan(SLIP)

    results = [filter_.update(observations) for _ in range(5)]

    assert all(len(result.rejected) == 4 for result in results)


@pytest.mark.parametrize(('error', 'options'), [
    (np.zeros(3), {}),
    (SLIP / 3.0, {}),
    # Contradictions are those of a lost robot.
    (20.0 * SLIP, {}),
    # They fit no pose.
    (SLIP, {'moved': 1}),
    # A single landmark may be wrong itself.
    (SLIP, {'count': 1}),
    # Half a turn of the robot explains the exchange of two.
    (np.zeros(3), {'count': 2, 'ids': [1, 0]}),
    # A pose that is known exactly, as that of an anchor, has no covariance to inflate.
    (SLIP / 4.0, {'sigma': np.zeros(3)}),
], ids=['none', 'passes', 'lost', 'misfit', 'one', 'exchanged', 'exact'])
def test_the_covariance_stays_where_a_scan_does_not_show_that_the_pose_is_wrong(error, options):
    before, after = updated(*scan(error, **options))

    assert_array_equal(after, before)


def test_a_robot_that_has_not_slipped_is_left_to_the_detection_of_lost_robots():
    before, after = updated(*scan(SLIP), may_have_slipped=False)

    assert_array_equal(after, before)


def test_two_landmarks_are_enough():
    before, after = updated(*scan(SLIP, count=2))

    assert after[2, 2] > 2.0 * before[2, 2]


def one_by_one(error, may_have_slipped=True):
    """Return a filter after three scans of one landmark each, and P (3, 3) before and after."""
    filter_, (a, b, *_) = scan(error)
    rejections = ConsecutiveRejections()
    (before, _), _, (_, after) = (
        updated(filter_, [observation], may_have_slipped, rejections) for observation in (a, b, a))
    return filter_, rejections, before, after


def test_three_scans_of_a_landmark_each_inflate_the_pose_together():
    filter_, rejections, before, after = one_by_one(SLIP)
    _, observations = scan(SLIP)

    assert_allclose(after / after[0, 0], before / before[0, 0], atol=1e-9)
    assert rejections.count('r') == 0
    innovation = filter_.update([
        a._replace(observer=filter_.state.robots['r'],
                   observed=filter_.state.landmarks[a.observed.key]) for a in observations])
    assert len(innovation.used) == 4
    assert_allclose(filter_.state.pose(filter_.state.robots['r']), SLIP, atol=NOISE / 2.0)


def test_three_scans_of_a_landmark_each_leave_a_robot_that_has_not_slipped():
    _, rejections, before, after = one_by_one(SLIP, may_have_slipped=False)

    assert_array_equal(after, before)
    assert rejections.count('r') == 3


def test_a_heading_that_would_be_too_uncertain_to_be_linearised_is_not_inflated():
    # 6 standard deviations of 0.15 rad would become 0.5 rad or more, of at most 0.3 rad.
    filter_, (a, b, *_) = scan(15.0 * SLIP, sigma=np.array([0.3, 0.3, 0.15]))
    rejections = ConsecutiveRejections()

    results = [updated(filter_, [x], rejections=rejections) for x in (a, b, a)]

    assert rejections.count('r') == 3
    assert_array_equal(results[-1][1], results[0][0])
