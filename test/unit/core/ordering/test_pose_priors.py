# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each pose prior is used once, at the next step of its robot."""

import numpy as np

from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.pose_priors import MAX_WAITING_PRIORS, PosePriors
from fej_slam_ros.core.records import Motion, PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from helpers.records import MS


def prior(ms, x=0.0, robot='r1'):
    return PosePrior(robot, ms * MS, np.array([x, 0.0, 0.0]), np.eye(3))


def test_priors_are_taken_once_and_in_the_order_of_stamps():
    priors = PosePriors(InputStatistics())
    for ms in (300, 100, 200):
        assert priors.add(prior(ms)) is None

    assert [taken.stamp for taken in priors.take('r1', 200 * MS)] == [100 * MS, 200 * MS]
    assert [taken.stamp for taken in priors.take('r1', 900 * MS)] == [300 * MS]
    assert not priors.take('r2', 900 * MS)


def test_the_order_of_arrival_does_not_matter_at_one_stamp():
    taken = []
    for xs in [(2.0, 1.0, 3.0), (3.0, 2.0, 1.0)]:
        priors = PosePriors(InputStatistics())
        for x in xs:
            priors.add(prior(100, x))
        taken.append([prior.pose[0] for prior in priors.take('r1', 100 * MS)])

    assert taken[0] == taken[1]


def test_a_prior_sent_again_is_a_duplicate_also_after_its_robot_returned():
    statistics = InputStatistics()
    priors = PosePriors(statistics)
    priors.add(prior(100))
    priors.leave('r1')
    assert statistics.rejection_counts['r1'] == {RejectionReason.LEFT: 1}

    assert priors.add(prior(100)) is RejectionReason.DUPLICATE
    assert priors.add(prior(100, x=1.0)) is None


def test_equal_priors_of_two_robots_are_no_duplicates():
    priors = PosePriors(InputStatistics())

    assert priors.add(prior(100, robot='r1')) is None
    assert priors.add(prior(100, robot='r2')) is None


def test_the_oldest_prior_beyond_the_maximum_is_rejected():
    statistics = InputStatistics()
    priors = PosePriors(statistics)
    for ms in range(1, MAX_WAITING_PRIORS + 1):
        priors.add(prior(ms))

    assert priors.add(prior(MAX_WAITING_PRIORS + 1)) is None
    assert priors.add(prior(1, x=1.0)) is RejectionReason.AFTER_ODOMETRY

    assert [r.stamp for r in statistics.rejections] == [MS, MS]
    assert priors.take('r1', 900 * MS)[0].stamp == 2 * MS


def test_a_prior_within_a_motion_is_moved_on_by_the_rest_of_it():
    priors, P = PosePriors(InputStatistics()), np.diag([1.0, 1.0, 0.1])
    for ms in (0, 150, 200):
        priors.add(PosePrior('r1', ms * MS, np.array([1.0, 2.0, np.pi / 2]), P))

    priors.advance(
        Motion('r1', 200 * MS, np.array([2.0, 0.0, 0.0]), np.diag([0.04, 0.01, 0.02])), begin=0)

    earlier, within, at_end = priors.take('r1', 200 * MS)
    # A quarter of the motion leads 0.5 m in the direction of y, by eq. (5) with -0.5 m in Phi; its
    # noise is a quarter of Q, whose x is y of map.
    np.testing.assert_allclose(within.pose, [1.0, 2.5, np.pi / 2], atol=1e-15)
    np.testing.assert_allclose(
        within.P, [[1.0275, 0.0, -0.05], [0.0, 1.01, 0.0], [-0.05, 0.0, 0.105]], atol=1e-15)
    assert within.stamp == 150 * MS
    for unmoved in earlier, at_end:
        np.testing.assert_array_equal(unmoved.pose, [1.0, 2.0, np.pi / 2])
        np.testing.assert_array_equal(unmoved.P, P)


def test_an_impossible_motion_leaves_a_prior_within_it_where_it_is():
    priors = PosePriors(InputStatistics())
    priors.add(PosePrior('r1', 150 * MS, np.array([1.0, 2.0, 0.0]), np.eye(3)))

    priors.advance(
        Motion('r1', 200 * MS, np.array([-30.0, 0.0, 0.0]), np.eye(3), 'it began again'), begin=0)

    np.testing.assert_array_equal(priors.take('r1', 200 * MS)[0].pose, [1.0, 2.0, 0.0])


def test_priors_that_no_odometry_has_reached_are_rejected_at_the_end():
    statistics = InputStatistics()
    priors = PosePriors(statistics)
    priors.add(prior(100))
    assert priors.waiting('r1') == 1

    priors.close()

    assert priors.waiting('r1') == 0
    assert statistics.rejection_counts['r1'] == {RejectionReason.AFTER_ODOMETRY: 1}
