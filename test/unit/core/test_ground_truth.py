# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth between its stamps, outside of them, and from where a robot started."""

from math import pi

import numpy as np
import pytest

from fej_slam_ros.core.ground_truth import LocalTruth, MissingTruthError, RecordedTruth
from fej_slam_ros.core.records import TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.errors import UserError
from helpers.records import MS, true_pose

ROUNDING = 1e-14

#: A drive of 2 m ahead in 100 ms that begins with the heading +y and turns left by 90 degrees.
QUARTER = (('r1', 100, (1.0, 1.0, pi / 2)), ('r1', 200, (1.0, 3.0, pi)))


def truth_of(*poses, landmarks=()):
    truth = RecordedTruth()
    for pose in poses:
        truth.add(true_pose(*pose))
    truth.add(TrueLandmarks({number: np.array(p) for number, p in landmarks}))
    return truth


def test_truth_at_its_stamp_keeps_every_bit():
    truth = truth_of(*QUARTER)

    np.testing.assert_array_equal(truth.pose('r1', 100 * MS), [1.0, 1.0, pi / 2])
    np.testing.assert_array_equal(truth.pose('r1', 200 * MS), [1.0, 3.0, pi])


@pytest.mark.parametrize(('ms', 'x'), [
    (125, (1.0, 1.5, 0.625 * pi)), (150, (1.0, 2.0, 0.75 * pi)), (175, (1.0, 2.5, 0.875 * pi))])
def test_truth_between_its_stamps_is_interpolated(ms, x):
    np.testing.assert_allclose(truth_of(*QUARTER).pose('r1', ms * MS), x, atol=ROUNDING)


@pytest.mark.parametrize(('gap', 'known'), [(500, True), (501, False)])
def test_truth_across_a_long_gap_is_known_at_its_ends_only(gap, known):
    truth = truth_of(('r1', 0, (0.0, 0.0, 0.0)), ('r1', gap, (1.0, 0.0, 0.0)))

    assert truth.covers('r1', 0)
    assert truth.covers('r1', gap * MS)
    assert truth.covers('r1', 100 * MS) is known


def test_headings_are_interpolated_the_short_way_round():
    truth = truth_of(('r1', 0, (0.0, 0.0, 3.0)), ('r1', 100, (0.0, 0.0, -3.0)))

    # From 3 on by a quarter of 2 pi - 6, and by three quarters, which is beyond pi.
    assert truth.pose('r1', 25 * MS)[2] == pytest.approx(1.5 + pi / 2, abs=ROUNDING)
    assert truth.pose('r1', 75 * MS)[2] == pytest.approx(-1.5 - pi / 2, abs=ROUNDING)


def test_true_poses_are_found_together_as_each_alone():
    truth = truth_of(*QUARTER, ('r1', 300, (0.0, 0.0, -3.0)), ('r1', 900, (0.0, 0.0, 0.0)))
    stamps = [ms * MS for ms in (50, 100, 117, 200, 280, 300, 500, 900, 901)]

    known, poses = truth.find_all('r1', stamps)

    alone = [truth.find('r1', stamp) for stamp in stamps]
    assert known.tolist() == [k for k, pose in enumerate(alone) if pose is not None]
    np.testing.assert_allclose(poses, [x for x in alone if x is not None], atol=ROUNDING)
    assert truth.find_all('r2', stamps)[1].shape == (0, 3)


def test_the_order_of_arrival_of_truth_does_not_matter():
    late = truth_of(QUARTER[1], ('r1', 300, (0.0, 0.0, 0.0)), QUARTER[0])

    np.testing.assert_allclose(late.pose('r1', 150 * MS), (1.0, 2.0, 0.75 * pi), atol=ROUNDING)


def test_of_two_true_poses_at_one_stamp_the_first_counts_and_the_second_is_rejected():
    truth = truth_of(*QUARTER)

    reasons = [truth.add(TruePose('r1', 100 * MS, np.array(pose)))
               for pose in ((9.0, 9.0, 0.0), (1.0, 1.0, pi / 2))]

    assert reasons == [RejectionReason.CONFLICTING, None]
    np.testing.assert_array_equal(truth.pose('r1', 100 * MS), [1.0, 1.0, pi / 2])


def test_truth_that_was_dropped_is_not_used_again_when_it_is_sent_again():
    truth = truth_of(*QUARTER)
    truth.forget_before('r1', 250 * MS)

    for ms in 100, 300:
        truth.add(TruePose('r1', ms * MS, np.zeros(3)))

    assert truth.find('r1', 100 * MS) is None
    assert truth.find('r1', 300 * MS) is not None


@pytest.mark.parametrize(('ms', 'covered'), [
    (99, False), (100, True), (150, True), (200, True), (201, False)])
def test_truth_covers_stamps_between_its_first_and_last(ms, covered):
    assert truth_of(*QUARTER).covers('r1', ms * MS) is covered


@pytest.mark.parametrize(('robot', 'ms'), [('r1', 99), ('r1', 201), ('r2', 150)])
def test_a_missing_true_pose_is_reported_in_one_sentence(robot, ms):
    with pytest.raises(MissingTruthError) as raised:
        truth_of(*QUARTER).pose(robot, ms * MS)

    sentence = str(raised.value)
    assert isinstance(raised.value, UserError)
    assert f'{robot}/ground_truth' in sentence
    assert str(ms * MS) in sentence
    assert '\n' not in sentence
    assert '. ' not in sentence


def test_a_missing_true_landmark_is_reported_in_one_sentence():
    with pytest.raises(MissingTruthError, match=r'^[^.\n]*landmark 7\b[^.\n]*$'):
        truth_of(landmarks=[(1, (2.0, 3.0))]).landmark(('', 7))


def test_a_true_landmark_is_found_by_its_id():
    truth = truth_of(landmarks=[(1, (2.0, 3.0)), (2, (4.0, 5.0))])

    np.testing.assert_array_equal(truth.landmark(('', 2)), [4.0, 5.0])


def test_the_newest_truth_is_the_latest_stamp():
    truth = truth_of(*reversed(QUARTER))

    assert truth.newest('r1') == 200 * MS
    assert truth.newest('r2') is None


@pytest.mark.parametrize(('ms', 'oldest'), [(0, 0), (50, 0), (100, 100), (250, 200), (900, 300)])
def test_forgetting_keeps_poses_that_later_interpolation_needs(ms, oldest):
    truth = truth_of(*(('r1', stamp, (0.0, 0.0, 0.0)) for stamp in (0, 100, 200, 300)))

    truth.forget_before('r1', ms * MS)

    assert truth.covers('r1', oldest * MS)
    assert not truth.covers('r1', oldest * MS - 1)
    assert truth.newest('r1') == 300 * MS


def test_local_truth_is_relative_to_the_start_of_the_robot():
    truth = truth_of(*QUARTER, landmarks=[(1, (0.0, 1.0))])

    local = LocalTruth(truth, 'r1', 100 * MS)

    np.testing.assert_array_equal(local.pose('r1', 100 * MS), np.zeros(3))
    np.testing.assert_allclose(local.pose('r1', 200 * MS), [2.0, 0.0, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(local.landmark(('', 1)), [0.0, 1.0], atol=ROUNDING)


def test_local_truth_keeps_its_origin_when_old_truth_is_forgotten():
    truth = truth_of(*QUARTER)
    local = LocalTruth(truth, 'r1', 100 * MS)
    local.pose('r1', 100 * MS)

    truth.forget_before('r1', 200 * MS)

    np.testing.assert_allclose(local.pose('r1', 200 * MS), [2.0, 0.0, pi / 2], atol=ROUNDING)
