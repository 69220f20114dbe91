# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each condition of the input of a robot has a level and a sentence with its cause."""

from collections import Counter

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.ros.session.input_faults import faults, RobotInput, TopicPublishers
from fej_slam_ros.ros.session.input_health import InputHealth
from fej_slam_ros.ros.session.topic_flow import LargeScan
from helpers.records import MS, scan, team

WARN, ERROR, STALE = 1, 2, 3
S = 1000
ODOMETRY, CLOUD = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/PointCloud2'


class Case:
    """The input of r2 beside r1, at a time in ms."""

    def __init__(self):
        self.estimator = Estimator(team('r1', 'r2'))
        self.health = InputHealth(self.estimator)
        self.publishers = {}

    def messages(self, kind, times, reason=None, observations=0):
        for ms in times:
            self.health.receive('r2', kind, ms * MS)
            self.health.settle('r2', kind, ms * MS, reason and RejectionReason(reason))
            self.health.flow('r2', kind).observations += observations
        return self

    def publish(self, **types):
        """Set the types of the publishers on each topic."""
        for kind in ('odom', 'landmarks', 'robots'):
            self.publishers[f'r2/{kind}'] = TopicPublishers(
                f'/fleet/r2/{kind}', types.get(kind, ()))
        return self

    def at(self, ms, needs_observations=False):
        """Return level and sentence of each condition."""
        robot_input = RobotInput('r2', ms * MS, self.health, needs_observations, self.publishers)
        return [(level, message) for level, message in faults(robot_input)]


def flowing(until=10 * S):
    """Return a robot whose odometry comes at 10 Hz, from publishers of the right types."""
    case = Case().publish(odom=(ODOMETRY,), landmarks=(CLOUD,), robots=(CLOUD,))
    return case.messages('odom', range(0, until, 100))


def test_input_that_flows_has_no_fault():
    case = flowing().messages('landmarks', range(0, 10 * S, 100))

    assert case.at(10 * S, needs_observations=True) == []


def test_a_topic_that_never_had_a_publisher_is_a_warning():
    case = Case().publish(landmarks=(CLOUD,))

    assert case.at(10 * S) == [(WARN, '/fleet/r2/odom has no publisher')]


def test_a_publisher_that_sends_nothing_is_a_warning():
    case = Case().publish(odom=(ODOMETRY,))

    assert case.at(10 * S) == [(WARN, 'no message on /fleet/r2/odom yet')]


def test_a_publisher_of_another_type_is_an_error():
    case = Case().publish(odom=('geometry_msgs/msg/Twist',))

    assert case.at(10 * S) == [(ERROR, (
        '/fleet/r2/odom is published as geometry_msgs/msg/Twist, this node needs'
        ' nav_msgs/msg/Odometry'))]


def test_a_publisher_of_incompatible_qos_is_an_error_with_its_remedy():
    case = Case()
    case.publishers['r2/odom'] = TopicPublishers('/r2/odom', (ODOMETRY,), 'set that parameter')

    assert case.at(10 * S) == [(ERROR, 'set that parameter')]


@pytest.mark.parametrize(('types', 'message'), [
    ((ODOMETRY,), 'odometry stopped 3.2 s ago'),
    ((), 'odometry stopped 3.2 s ago: /fleet/r2/odom has no publisher')])
def test_odometry_that_stopped_is_stale(types, message):
    case = Case().publish(odom=types).messages('odom', range(0, 1100, 100))

    assert case.at(1000 + 1000) == []
    assert case.at(1000 + 3200) == [(STALE, message)]


def test_a_robot_may_send_odometry_only():
    case = flowing().publish(odom=(ODOMETRY,))

    assert case.at(10 * S) == []


def test_a_robot_that_needs_observations_to_join_is_warned_without_them():
    case = flowing().publish(odom=(ODOMETRY,))
    assert case.at(10 * S, needs_observations=True) == [
        (WARN, '/fleet/r2/landmarks and /fleet/r2/robots have no publisher')]

    case.publish(odom=(ODOMETRY,), landmarks=(CLOUD,))
    assert case.at(10 * S, needs_observations=True) == [
        (WARN, 'no message on /fleet/r2/landmarks and /fleet/r2/robots yet')]


@pytest.mark.parametrize(('times', 'types', 'message'), [
    (range(0, 7 * S, 100), (CLOUD,), 'landmark scans stopped 3.1 s ago'),
    (range(0, 7 * S, 100), (),
     'landmark scans stopped 3.1 s ago: /fleet/r2/landmarks has no publisher'),
    # A detector that only sends what it detects, which may be nothing for long.
    ((0, 100, 5 * S, 5100, 5200, 6900), (CLOUD,), None),
    ((0, 100, 5 * S, 5100, 5200, 6900), (),
     'landmark scans stopped 3.1 s ago: /fleet/r2/landmarks has no publisher'),
    # Two scans on request.
    ((0, 6900), (CLOUD,), None)])
def test_landmark_scans_that_stopped_are_a_warning_if_they_were_regular(times, types, message):
    case = flowing().publish(odom=(ODOMETRY,), landmarks=types).messages('landmarks', times)

    assert case.at(10 * S) == ([(WARN, message)] if message else [])


def test_other_robots_may_be_out_of_view():
    case = flowing().messages('robots', range(0, 2 * S, 100))

    assert case.at(10 * S) == []


def test_a_topic_whose_messages_are_all_rejected_is_an_error_with_the_reasons():
    case = flowing().messages('landmarks', range(5 * S, 9900, 100), 'wrong_frame')
    case.messages('landmarks', [9900], 'bad_cloud')

    assert case.at(10 * S) == [(ERROR, (
        'the last 50 messages on /fleet/r2/landmarks were all rejected: 49 wrong_frame,'
        ' 1 bad_cloud'))]


@pytest.mark.parametrize('times', [[9900], [9700, 9800, 9900], [8000, 9900]])
def test_a_few_rejected_messages_are_no_condition(times):
    assert flowing().messages('landmarks', times, 'late').at(10 * S) == []


def test_input_that_is_sent_again_after_a_restart_is_a_warning_only():
    case = flowing().messages('odom', range(10 * S, 12 * S, 100), 'duplicate')

    (level, message), = case.at(12 * S)
    assert level == WARN
    assert message.endswith('rejected: 20 duplicate')


@pytest.mark.parametrize(('scans', 'size', 'gated', 'level'), [
    (10, 1, 5, None), (10, 1, 6, WARN), (10, 1, 9, WARN), (10, 1, 10, ERROR), (1, 20, 18, WARN),
    (1, 20, 19, ERROR)])
def test_mostly_gated_observations_are_a_warning_or_an_error(scans, size, gated, level):
    case = flowing()
    # One scan per report.
    for k in range(size, size * scans + 1, size):
        case.health.robots['r2'].observations.sample(
            k * S // size, k, max(k - gated, 0), Counter({RejectionReason.GATED: min(k, gated)}))

    expected = (
        f'{gated} of the last {size * scans} observations gated: check pose and frame of the'
        ' sensor, and the covariances')
    assert case.at(10 * S) == ([] if level is None else [(level, expected)])


def test_observations_of_which_none_is_used_are_a_warning_with_the_reason():
    case = flowing()
    case.health.sample(10 * S * MS)
    for k in range(1, 5):
        case.messages('landmarks', [10 * S + k * S], observations=1)
        case.estimator.add(scan('r2', 10 * S + k * S, [(1, (1.0, 2.0))]))
        case.health.sample((10 + k) * S * MS)
    case.messages('odom', range(10 * S, 15 * S, 100))

    assert case.at(12 * S) == []
    assert case.at(14 * S) == [(WARN, (
        'none of 4 observations used for 4.0 s: 4 messages wait for later odometry'))]


def test_a_robot_that_delays_the_others_is_a_warning_with_the_delay():
    case = Case()
    # r1 at 20 Hz, r2 at 1.25 Hz.
    for ms in range(0, 20050, 50):
        case.health.receive('r1', 'odom', ms * MS)
        case.health.receive_odometry('r1', ms * MS)
        if ms % 800 == 0:
            case.messages('odom', [ms])
            case.health.receive_odometry('r2', ms * MS)
        if ms % S == 0:
            case.health.sample(ms * MS)

    assert case.at(20 * S) == [(WARN, (
        'delays the other robots by up to 0.80 s: its odometry, every 0.80 s, is that much'
        ' older than theirs'))]


def test_in_a_slow_team_no_robot_delays_the_others():
    case = flowing(20 * S)
    for ms in range(0, 20 * S, 1000):
        case.health.receive('r1', 'odom', ms * MS)
        case.health.receive_odometry('r2', (ms - 900) * MS)
        case.health.receive_odometry('r1', ms * MS)
        case.health.sample(ms * MS)

    assert case.health.robots['r2'].lag() == 900 * MS
    assert case.at(20 * S) == []


def test_scans_rejected_by_their_size_are_an_error_for_some_seconds():
    case = flowing(20 * S)
    case.messages('landmarks', range(0, 10 * S, 100), 'too_large')
    case.health.flow('r2', 'landmarks').largest = LargeScan(20_000, 640_112, 9900 * MS)

    error = (ERROR, (
        'r2 publishes 20,000 points a scan (640,112 bytes) on /fleet/r2/landmarks, rejected as'
        ' too_large: is this a raw cloud? Publish landmarks, or raise max_observations'))
    assert error in case.at(14 * S)
    assert error not in case.at(15 * S)
    assert not [message for _, message in case.at(10 * S) if 'all rejected' in message]


@pytest.mark.parametrize(('rate', 'is_told'), [(2000, True), (900, False)])
@pytest.mark.parametrize('kind', ['odom', 'landmarks'])
def test_a_topic_that_takes_the_time_of_the_node_is_an_error(kind, rate, is_told):
    case = flowing(0)
    for second in range(3):
        case.health.sample(second * S * MS)
        case.messages(kind, (1000 * second + 1000 * k / rate for k in range(rate)))

    expected = (ERROR, (
        f'r2 publishes at least 2,000 messages a second on /fleet/r2/{kind}: what is too much for'
        ' this node is lost; publish at most 100'))
    assert (expected in case.at(3 * S)) is is_told


@pytest.mark.parametrize(('reason', 'sentence'), [
    ('too_many_new', '7 observations without ID matched no landmark, more than a scan may start'),
    ('map_full', '7 new landmarks were not started, the map is full: raise max_landmarks'),
    ('overload', '7 scans were dropped, their observations take longer to process than they')])
def test_input_beyond_a_limit_is_an_error_for_some_seconds(reason, sentence):
    case = flowing(20 * S)
    case.health.sample(9 * S * MS)
    for stamp in range(7):
        case.estimator.statistics.reject(Rejection('r2', stamp, RejectionReason(reason), id=3))
    case.health.sample(10 * S * MS)

    assert any(
        level == ERROR and message.startswith(sentence) for level, message in case.at(10 * S))
    case.health.sample(16 * S * MS)
    assert not any(sentence in message for _, message in case.at(16 * S))


@pytest.mark.parametrize(('publishers', 'reason', 'is_told'), [
    (2, 'impossible_motion', True), (2, 'conflicting', True),
    # A driver that jumps, and one that has replaced another.
    (1, 'impossible_motion', False), (2, 'late', False)])
def test_drivers_that_publish_odometry_of_one_robot_are_an_error(publishers, reason, is_told):
    case = flowing(20 * S).publish(odom=(ODOMETRY,) * publishers)
    case.health.sample(9 * S * MS)
    case.estimator.statistics.reject(Rejection('r2', 0, RejectionReason(reason)))
    case.health.sample(10 * S * MS)

    assert is_told == ((ERROR, (
        '/fleet/r2/odom has 2 publishers that contradict each other: stop all but one, or remap'
        ' their topics')) in case.at(10 * S))


def test_faults_end_when_the_clock_is_set_back():
    case = flowing(20 * S)
    case.health.sample(99 * S * MS)
    case.estimator.statistics.reject(Rejection('r2', 7, RejectionReason.MAP_FULL, id=3))
    case.health.flow('r2', 'landmarks').largest = LargeScan(20_000, 640_112, 100 * S * MS)
    case.health.sample(100 * S * MS)
    assert len([level for level, _ in case.at(100 * S) if level == ERROR]) == 2

    case.messages('odom', range(0, 10 * S, 100))
    case.health.sample(10 * S * MS)

    assert case.at(10 * S) == []


def test_faults_that_go_on_are_reported_after_the_clock_was_set_back():
    case = flowing(0).messages('landmarks', range(100 * S, 101 * S, 100), 'wrong_frame', 1)
    case.health.sample(100 * S * MS)

    case.messages('landmarks', range(0, 10 * S, 100), 'wrong_frame', 1)
    for second in range(1, 10):
        case.messages('odom', [second * S])
        case.health.sample(second * S * MS)

    sentences = [message for _, message in case.at(10 * S)]
    assert any(
        'messages on /fleet/r2/landmarks were all rejected' in sentence
        for sentence in sentences)
    assert any('observations used for 9.0 s' in sentence for sentence in sentences)


@pytest.mark.parametrize(('odometry', 'scans', 'side'), [
    (0, 1_700_000_000, 'behind'), (1_700_000_000, 0, 'ahead of'), (3600, 3600, None),
    (0, 1, None)])
def test_observations_with_another_clock_than_odometry_are_an_error(odometry, scans, side):
    case = flowing().messages('landmarks', range(0, 10 * S, 100))
    for kind, delay in ('odom', odometry), ('landmarks', scans):
        case.health.flow('r2', kind).delay = delay * S * MS

    assert case.at(10 * S) == ([] if side is None else [(ERROR, (
        f'the stamps on /fleet/r2/landmarks are 1700000000.0 s {side} those of its odometry: stamp'
        ' both with the time of measurement by one clock'))])


@pytest.mark.parametrize(('poses', 'speed', 'is_fault'), [
    # A pose that never changes, one that is sent five times in a row, and a robot at rest.
    (lambda k: 0.0, 0.5, True), (lambda k: 0.1 * (k // 5), 0.5, False),
    (lambda k: 0.0, 0.0, False)])
def test_velocities_without_motion_of_the_pose_are_an_error(poses, speed, is_fault):
    case = flowing()
    for k in range(200):
        case.health.robots['r2'].receive_velocity(
            np.array([poses(k), 0.0, 0.0]), (speed, 0.0), None)

    assert case.at(10 * S) == ([(ERROR, (
        '/fleet/r2/odom has velocities, but its pose never changes: integrate them into pose.pose,'
        ' only poses are used'))] if is_fault else [])


@pytest.mark.parametrize(('variances', 'speed', 'is_fault'), [
    # Of vx only, of neither, of all that a wheeled robot has, and of one at rest.
    ((1e-3, 0.0, 0.0), 0.5, True), ((1e-9, 1e-9, 1e-9), 0.5, True),
    ((1e-3, 0.0, 1e-3), 0.5, False), ((1e-9, 0.0, 1e-9), 0.0, False)])
def test_odometry_that_claims_to_be_exact_is_named(variances, speed, is_fault):
    case = flowing()
    for k in range(200):
        case.health.robots['r2'].receive_velocity(
            np.array([0.1 * k, 0.0, 0.0]), (speed, 0.0), np.diag(variances))

    assert case.at(10 * S) == ([(WARN, (
        '/fleet/r2/odom has almost no variance of vx or wz in twist.covariance, so that'
        ' observations hardly correct it: fill in vx, vy and wz, leave them zero, or set'
        ' r2.use_odometry_covariance to false'))]
        if is_fault else [])


@pytest.mark.parametrize(('variances', 'is_fault'), [
    # Of vy by a driver that does not know it, of wz by that of ROS 1, and of a coarse one.
    ((1e-3, 1e6, 1e-2), True), ((1e-3, 1e-3, 1e3), True), ((100.0, 100.0, 10.0), False)])
def test_variances_as_of_unknown_velocities_are_an_error(variances, is_fault):
    case = flowing()
    for k in range(200):
        case.health.robots['r2'].receive_velocity(
            np.array([0.1 * k, 0.0, 0.0]), (0.5, 0.0), np.diag(variances))

    assert case.at(10 * S) == ([(ERROR, (
        '/fleet/r2/odom has variances of vx, vy or wz above 900 in twist.covariance, as if they'
        ' were unknown: fill in all three, leave them zero, or set r2.use_odometry_covariance to'
        ' false'))] if is_fault else [])
