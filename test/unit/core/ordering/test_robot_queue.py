# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Order in time within one robot, and the motions between its events."""

from math import cos, pi, sin, sqrt

import numpy as np
import pytest

from fej_slam_ros.core.ordering import robot_queue
from fej_slam_ros.core.ordering.robot_queue import ReleaseKey, RobotQueue
from fej_slam_ros.core.records import merged, RobotScan, Scan
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from helpers.records import MS, odometry, Q, Q_TURNED, robot_scan, scan

SIGMA = (0.2, 0.1, 0.4)
#: A limit of scans, or of observations at one stamp, that is not reached.
MANY = 1000

ROUNDING = 1e-14


def queue_of(*records):
    """Return a queue of r1 with some records; gaps are longer than 1 s."""
    queue = RobotQueue(RobotSettings('r1', 1, odometry_sigma=SIGMA), longest_gap=1000 * MS)
    for record in records:
        assert queue.accept(record, MANY) is None
    return queue


def advanced(queue):
    """Advance a queue through all its events; return its motions by stamp [ms]."""
    motions = {}
    while (stamp := queue.next_event()) is not None:
        queue.take_scans(stamp)
        motions[stamp // MS] = queue.advance(stamp)
    return motions


def test_motions_lead_from_one_odometry_stamp_to_the_next_in_any_order_of_arrival():
    queue = queue_of(
        odometry('r1', 300, (1.0, 5.0, pi)), odometry('r1', 0, (1.0, 0.0, 0.0)),
        odometry('r1', 100, (1.0, 2.0, pi / 2)))

    motions = advanced(queue)

    assert motions[0] is None
    np.testing.assert_allclose(motions[100].u, [0.0, 2.0, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(motions[300].u, [3.0, 0.0, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(motions[300].Q, np.diag([0.008, 0.002, 0.032]), rtol=1e-12)


@pytest.mark.parametrize('stops', [[250], [250, 500], [100, 500, 750], [500, 999]])
def test_scans_inside_an_increment_divide_it_by_time(stops):
    # u = (4, 0, pi) over 1 s: at time a the robot has turned by a pi, and the rest of u is given
    # in that frame.
    whole = odometry('r1', 1000, (4.0, 0.0, pi), twist_covariance=Q)
    queue = queue_of(
        odometry('r1', 0, (0.0, 0.0, 0.0)), whole, *(scan('r1', ms) for ms in stops))

    motions = advanced(queue)

    assert list(motions) == [0, *stops, 1000]
    for began, ended in zip([0, *stops], [*stops, 1000]):
        a, share = began / 1000, (ended - began) / 1000
        turned = [4.0 * share * cos(a * pi), -4.0 * share * sin(a * pi), share * pi]
        np.testing.assert_allclose(motions[ended].u, turned, atol=1e-12)


def test_the_covariances_of_the_parts_of_an_increment_add_up_to_that_of_the_increment():
    # Scans at a quarter and a half of u = (4, 0, pi): turned by an eighth and by a quarter turn.
    whole = odometry('r1', 1000, (4.0, 0.0, pi), twist_covariance=Q)
    c = sqrt(0.5)
    eighth = np.array([[c, c, 0.0], [-c, c, 0.0], [0.0, 0.0, 1.0]])

    motions = advanced(
        queue_of(odometry('r1', 0), whole, scan('r1', 500), scan('r1', 250)))

    np.testing.assert_allclose(motions[250].Q, 0.25 * Q, atol=ROUNDING)
    np.testing.assert_allclose(motions[500].Q, 0.25 * eighth @ Q @ eighth.T, atol=ROUNDING)
    np.testing.assert_allclose(motions[1000].Q, 0.5 * Q_TURNED, atol=ROUNDING)


def test_the_odometry_pose_between_stamps_is_where_the_motions_lead():
    start, end = odometry('r1', 0, (1.0, 2.0, pi / 2)), odometry('r1', 1000, (1.0, 6.0, -pi / 2))
    queue = queue_of(start, end, scan('r1', 250), scan('r1', 500))
    poses = []

    while (stamp := queue.next_event()) is not None:
        queue.take_scans(stamp)
        queue.advance(stamp)
        poses.append(queue.odometry.pose)

    np.testing.assert_allclose(
        poses[1:3], [(1.0, 3.0, 3 * pi / 4), (1.0, 4.0, pi)], atol=ROUNDING)
    np.testing.assert_array_equal(poses[::3], [start.pose, end.pose])


@pytest.mark.parametrize(('ms', 'can'), [
    (0, False), (30, False), (31, True), (100, True), (101, False), (300, False)])
def test_a_robot_can_be_anywhere_in_its_next_increment_after_its_last_event(ms, can):
    queue = queue_of(*(odometry('r1', ms) for ms in (0, 100, 300)), scan('r1', 30))
    for stamp in (0, 30 * MS):
        queue.take_scans(stamp)
        queue.advance(stamp)

    assert queue.can_be_at(ReleaseKey(ms * MS, ms * MS)) is can


@pytest.mark.parametrize(('ms', 'can'), [(199, False), (200, True), (201, False)])
def test_before_its_first_event_a_robot_can_only_be_at_its_first_odometry(ms, can):
    queue = queue_of(odometry('r1', 200), odometry('r1', 300))

    assert queue.can_be_at(ReleaseKey(ms * MS, ms * MS)) is can


def test_events_within_a_gap_are_due_at_its_end():
    queue = queue_of(odometry('r1', 0), odometry('r1', 1001))
    queue.advance(0)

    assert not queue.can_be_at(ReleaseKey(500 * MS, 500 * MS))
    assert queue.can_be_at(ReleaseKey(1001 * MS, 500 * MS))


def test_a_robot_without_odometry_can_be_at_no_stamp():
    assert not queue_of().can_be_at(ReleaseKey(0, 0))


def test_a_scan_at_an_odometry_stamp_divides_nothing():
    queue = queue_of(odometry('r1', 0), odometry('r1', 100), scan('r1', 100))

    motions = advanced(queue)

    assert list(motions) == [0, 100]
    np.testing.assert_array_equal(motions[100].u, [0.1, 0.0, 0.0])


def test_a_scan_waits_until_odometry_has_reached_it():
    queue = queue_of(odometry('r1', 0), scan('r1', 50))
    assert list(advanced(queue)) == [0]

    queue.accept(odometry('r1', 50), MANY)

    assert list(advanced(queue)) == [50]


def test_odometry_that_arrives_after_newer_odometry_is_inserted_by_its_stamp():
    queue = queue_of(
        odometry('r1', 0), odometry('r1', 300), scan('r1', 280), odometry('r1', 250))

    assert list(advanced(queue)) == [0, 250, 280, 300]


@pytest.mark.parametrize('used', [False, True])
@pytest.mark.parametrize('record', [
    odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(1, (2.0, 0.0))]), scan('r1', 50)])
def test_the_same_content_again_is_a_duplicate(record, used):
    queue = queue_of(
        odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(1, (2.0, 0.0))]),
        scan('r1', 50))
    if used:
        advanced(queue)

    assert queue.accept(record, MANY) is RejectionReason.DUPLICATE


@pytest.mark.parametrize('used', [False, True])
@pytest.mark.parametrize('other', [
    odometry('r1', 100, (0.1, 0.0, 1e-15)), odometry('r1', 100, twist_covariance=np.eye(3))])
def test_other_odometry_at_the_same_stamp_is_conflicting(other, used):
    queue = queue_of(odometry('r1', 0), odometry('r1', 100))
    if used:
        advanced(queue)

    assert queue.accept(other, MANY) is RejectionReason.CONFLICTING


@pytest.mark.parametrize('record', [
    odometry('r1', 50), scan('r1', 50), scan('r1', 100, [(1, (2.0, 0.0))])])
def test_a_record_before_the_last_event_is_late(record):
    queue = queue_of(odometry('r1', 0), odometry('r1', 100))
    advanced(queue)

    assert queue.accept(record, MANY) is RejectionReason.LATE


def test_odometry_inside_an_increment_that_has_been_divided_is_late():
    queue = queue_of(odometry('r1', 0), odometry('r1', 100), scan('r1', 30))
    for stamp in (0, 30 * MS):
        queue.take_scans(stamp)
        queue.advance(stamp)

    assert queue.accept(odometry('r1', 60), MANY) is RejectionReason.LATE
    assert queue.accept(scan('r1', 60), MANY) is None


def test_two_scans_of_one_stamp_become_one_in_the_order_of_ids():
    one = scan('r1', 0, [(5, (1.0, 0.0)), (2, (2.0, 0.0))])
    two = scan('r1', 0, [(3, (3.0, 0.0)), (2, (1.0, 9.0))])

    for scans in ([one, two], [two, one]):
        seen = [(s.id, *s.z) for s in merged(scans).observations]
        assert seen == [(2, 1.0, 9.0), (2, 2.0, 0.0), (3, 3.0, 0.0), (5, 1.0, 0.0)]


def test_observations_have_the_noise_scale_of_their_kind():
    queue = RobotQueue(
        RobotSettings('r1', 1, landmark_noise_scale=2.0, robot_noise_scale=3.0), 1000 * MS)
    for record in (scan('r1', 0, [(1, (1.0, 0.0))]), robot_scan('r1', 0, [('r2', (1.0, 0.0))])):
        queue.accept(record, MANY)

    variances = {type(s): s.observations[0].R[0, 0] for s in queue.take_scans(0)}

    # 0.1 m, times 2 and times 3.
    assert variances == pytest.approx({Scan: 0.04, RobotScan: 0.09})


def crowd(ms, count, first=0):
    """Return a scan of `count` landmarks."""
    return scan('r1', ms, [(first + k, (1.0, 0.0)) for k in range(count)])


def test_a_scan_has_a_limited_number_of_observations():
    queue = queue_of(odometry('r1', 0))

    assert [queue.accept(crowd(50 + k, k), 10) for k in (9, 10, 11)] == [
        None, None, RejectionReason.TOO_LARGE]


def test_the_oldest_scans_beyond_the_limit_of_observations_are_taken(monkeypatch):
    monkeypatch.setattr(robot_queue, 'MAX_QUEUED_OBSERVATIONS', 10)
    queue = queue_of(*(crowd(ms, 4) for ms in (0, 1, 2, 3)))

    assert [surplus.stamp for surplus in queue.take_surplus_scans(MANY)] == [0, MS]
    assert queue.take_surplus_scans(MANY) == []
    assert queue.accept(crowd(0, 4), MANY) is None


def test_a_single_scan_may_be_above_the_limit_of_observations(monkeypatch):
    monkeypatch.setattr(robot_queue, 'MAX_QUEUED_OBSERVATIONS', 10)
    queue = queue_of(crowd(0, 4), crowd(1, 12))

    assert [surplus.stamp for surplus in queue.take_surplus_scans(MANY)] == [0]
    assert queue.waiting() == 1


def test_of_large_scans_the_newest_stays():
    queue = queue_of(crowd(0, 8), crowd(1, 2), crowd(2, 8), crowd(3, 8), crowd(4, 2))

    assert [surplus.stamp for surplus in queue.take_surplus_scans(1, size=5)] == [0, 2 * MS]
    assert queue.take_surplus_scans(1, size=5) == []
    assert queue.waiting() == 3
