# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Order in time within one robot, and the increments between its events."""

from math import cos, pi, sin, sqrt

import numpy as np
import pytest

from fej_slam_ros.core.ordering.robot_queue import increment, RobotQueue, split
from fej_slam_ros.core.records import merged
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from helpers.records import MS, odometry, scan

SIGMA = (0.2, 0.1, 0.4)

#: A covariance in which no two entries are alike, and C^T Q C for a quarter turn to the left,
#: which takes (x, y) to (y, -x).
Q = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.25], [0.5, 0.25, 1.0]])
Q_TURNED = np.array([[2.0, -1.0, 0.25], [-1.0, 4.0, -0.5], [0.25, -0.5, 1.0]])

ROUNDING = 1e-14


def track_with(*records):
    track = RobotQueue(RobotSettings('r1', 1, odometry_sigma=SIGMA))
    for record in records:
        assert track.accept(record) is None
    return track


def advanced(track):
    """Move a track as far as its records reach; return its motions by stamp [ms]."""
    motions = {}
    while (stamp := track.next_event()) is not None:
        track.take_scans(stamp)
        motions[stamp // MS] = track.advance(stamp)
    return motions


@pytest.mark.parametrize(('p0', 'p1', 'u'), [
    ((1.0, 2.0, pi / 2), (1.0, 5.0, pi), (3.0, 0.0, pi / 2)),
    ((0.0, 0.0, pi), (2.0, 1.0, pi / 2), (-2.0, -1.0, -pi / 2)),
    ((0.0, 0.0, 3.0), (0.0, 0.0, -3.0), (0.0, 0.0, 2.0 * pi - 6.0)),
    ((5.0, 0.0, -3.0), (6.0, 0.0, 3.0), (cos(3.0), sin(3.0), 6.0 - 2.0 * pi)),
])
def test_an_increment_is_given_in_the_frame_of_its_beginning(p0, p1, u):
    found, _ = increment(odometry('r1', 0, p0), odometry('r1', 100, p1), SIGMA)

    np.testing.assert_allclose(found, u, atol=ROUNDING)


def test_an_increment_has_the_covariance_of_the_later_twist_times_its_duration_squared():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))
    later = odometry('r1', 1500, twist_covariance=4.0 * Q)

    _, found = increment(earlier, later, SIGMA)

    np.testing.assert_allclose(found, Q, rtol=ROUNDING)


def test_an_increment_of_unknown_covariance_has_sigma_per_square_root_of_a_second():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))

    _, found = increment(earlier, odometry('r1', 1250), SIGMA)

    np.testing.assert_allclose(found, np.diag([0.01, 0.0025, 0.04]), rtol=1e-12, atol=0.0)


def test_the_parts_of_an_increment_share_its_displacement_and_its_covariance():
    first, rest = split(np.array([4.0, 2.0, 2.0 * pi / 3.0]), Q, 0.75)

    np.testing.assert_allclose(first[0], [3.0, 1.5, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(first[1], 0.75 * Q, atol=ROUNDING)
    np.testing.assert_allclose(rest[0], [0.5, -1.0, pi / 6], atol=ROUNDING)
    np.testing.assert_allclose(rest[1], 0.25 * Q_TURNED, atol=ROUNDING)


def test_motions_lead_from_each_odometry_stamp_to_the_next_whatever_order_they_came_in():
    track = track_with(
        odometry('r1', 300, (1.0, 5.0, pi)), odometry('r1', 0, (1.0, 0.0, 0.0)),
        odometry('r1', 100, (1.0, 2.0, pi / 2)))

    motions = advanced(track)

    assert motions[0] is None
    np.testing.assert_allclose(motions[100].u, [0.0, 2.0, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(motions[300].u, [3.0, 0.0, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(motions[300].Q, np.diag([0.008, 0.002, 0.032]), rtol=1e-12)


@pytest.mark.parametrize('stops', [[250], [250, 500], [100, 500, 750], [500, 999]])
def test_scans_inside_an_increment_divide_it_by_time(stops):
    # u = (4, 0, pi) over 1 s: at the time a the robot has turned by a pi, and what is left of u
    # is seen from there.
    whole = odometry('r1', 1000, (4.0, 0.0, pi), twist_covariance=Q)
    track = track_with(
        odometry('r1', 0, (0.0, 0.0, 0.0)), whole, *(scan('r1', ms) for ms in stops))

    motions = advanced(track)

    assert list(motions) == [0, *stops, 1000]
    for began, ended in zip([0, *stops], [*stops, 1000]):
        a, share = began / 1000, (ended - began) / 1000
        turned = [4.0 * share * cos(a * pi), -4.0 * share * sin(a * pi), share * pi]
        np.testing.assert_allclose(motions[ended].u, turned, atol=1e-12)


def test_the_covariance_of_two_scans_in_an_increment_adds_up_to_that_of_the_increment():
    # Scans at a quarter and a half of u = (4, 0, pi): turned by an eighth and by a quarter turn.
    whole = odometry('r1', 1000, (4.0, 0.0, pi), twist_covariance=Q)
    c = sqrt(0.5)
    eighth = np.array([[c, c, 0.0], [-c, c, 0.0], [0.0, 0.0, 1.0]])

    motions = advanced(
        track_with(odometry('r1', 0), whole, scan('r1', 500), scan('r1', 250)))

    np.testing.assert_allclose(motions[250].Q, 0.25 * Q, atol=ROUNDING)
    np.testing.assert_allclose(motions[500].Q, 0.25 * eighth @ Q @ eighth.T, atol=ROUNDING)
    np.testing.assert_allclose(motions[1000].Q, 0.5 * Q_TURNED, atol=ROUNDING)


def test_odometry_has_the_robot_between_its_stamps_where_the_motions_lead():
    start, end = odometry('r1', 0, (1.0, 2.0, pi / 2)), odometry('r1', 1000, (1.0, 6.0, -pi / 2))
    track = track_with(start, end, scan('r1', 250), scan('r1', 500))
    poses = []

    while (stamp := track.next_event()) is not None:
        track.take_scans(stamp)
        track.advance(stamp)
        poses.append(track.pose)

    np.testing.assert_allclose(
        poses[1:3], [(1.0, 3.0, 3 * pi / 4), (1.0, 4.0, pi)], atol=ROUNDING)
    np.testing.assert_array_equal(poses[::3], [start.pose, end.pose])


@pytest.mark.parametrize(('ms', 'can'), [
    (0, False), (30, False), (31, True), (100, True), (101, False), (300, False)])
def test_a_robot_can_be_where_its_next_increment_leads_after_its_last_event(ms, can):
    track = track_with(*(odometry('r1', ms) for ms in (0, 100, 300)), scan('r1', 30))
    for stamp in (0, 30 * MS):
        track.take_scans(stamp)
        track.advance(stamp)

    assert track.can_be_at((ms * MS, ms * MS), longest_gap=1000 * MS) is can


@pytest.mark.parametrize(('ms', 'can'), [(199, False), (200, True), (201, False)])
def test_a_robot_that_has_not_begun_can_be_at_its_first_odometry_only(ms, can):
    track = track_with(odometry('r1', 200), odometry('r1', 300))

    assert track.can_be_at((ms * MS, ms * MS), longest_gap=1000 * MS) is can


def test_within_a_gap_a_robot_can_be_at_the_end_only():
    track = track_with(odometry('r1', 0), odometry('r1', 1001))
    track.advance(0)

    assert not track.can_be_at((500 * MS, 500 * MS), longest_gap=1000 * MS)
    assert track.can_be_at((1001 * MS, 500 * MS), longest_gap=1000 * MS)


def test_a_robot_without_odometry_can_be_nowhere():
    assert not track_with().can_be_at((0, 0), longest_gap=1000 * MS)


def test_a_scan_at_an_odometry_stamp_divides_nothing():
    track = track_with(odometry('r1', 0), odometry('r1', 100), scan('r1', 100))

    motions = advanced(track)

    assert list(motions) == [0, 100]
    np.testing.assert_array_equal(motions[100].u, [0.1, 0.0, 0.0])


def test_a_scan_is_no_event_before_odometry_has_reached_it():
    track = track_with(odometry('r1', 0), scan('r1', 50))
    assert list(advanced(track)) == [0]

    track.accept(odometry('r1', 50))

    assert list(advanced(track)) == [50]


def test_odometry_that_comes_later_than_newer_odometry_finds_its_place():
    track = track_with(
        odometry('r1', 0), odometry('r1', 300), scan('r1', 280), odometry('r1', 250))

    assert list(advanced(track)) == [0, 250, 280, 300]


@pytest.mark.parametrize('used', [False, True])
@pytest.mark.parametrize('record', [
    odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(1, (2.0, 0.0))]), scan('r1', 50)])
def test_the_same_content_again_is_a_duplicate(record, used):
    track = track_with(
        odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(1, (2.0, 0.0))]),
        scan('r1', 50))
    if used:
        advanced(track)

    assert track.accept(record) is RejectionReason.DUPLICATE


@pytest.mark.parametrize('used', [False, True])
@pytest.mark.parametrize('other', [
    odometry('r1', 100, (0.1, 0.0, 1e-15)), odometry('r1', 100, twist_covariance=np.eye(3))])
def test_other_odometry_at_the_same_stamp_is_conflicting(other, used):
    track = track_with(odometry('r1', 0), odometry('r1', 100))
    if used:
        advanced(track)

    assert track.accept(other) is RejectionReason.CONFLICTING


@pytest.mark.parametrize('record', [
    odometry('r1', 50), scan('r1', 50), scan('r1', 100, [(1, (2.0, 0.0))])])
def test_what_comes_after_its_time_was_used_is_late(record):
    track = track_with(odometry('r1', 0), odometry('r1', 100))
    advanced(track)

    assert track.accept(record) is RejectionReason.LATE


def test_odometry_inside_an_increment_that_has_been_divided_is_late():
    track = track_with(odometry('r1', 0), odometry('r1', 100), scan('r1', 30))
    for stamp in (0, 30 * MS):
        track.take_scans(stamp)
        track.advance(stamp)

    assert track.accept(odometry('r1', 60)) is RejectionReason.LATE
    assert track.accept(scan('r1', 60)) is None


def test_two_scans_of_one_stamp_become_one_in_the_order_of_ids():
    one = scan('r1', 0, [(5, (1.0, 0.0)), (2, (2.0, 0.0))])
    two = scan('r1', 0, [(3, (3.0, 0.0)), (2, (1.0, 9.0))])

    for scans in ([one, two], [two, one]):
        seen = [(s.id, *s.z) for s in merged(scans).observations]
        assert seen == [(2, 1.0, 9.0), (2, 2.0, 0.0), (3, 3.0, 0.0), (5, 1.0, 0.0)]
