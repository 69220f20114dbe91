# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of lasers anywhere on a robot become landmarks; bad ones are counted and named."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.geometry import transform
from fej_slam_ros.detection.records import RobotLaserScan
from fej_slam_ros.ros.messages import laser, outgoing
from fej_slam_ros.ros.parameters.detector_settings import parse_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.session.front_end import report
from fej_slam_ros.sim.lidar import true_ranges
from helpers.lasers import NO_WALLS, scan_of
from helpers.ros import drive, mounts, odometry_message, raw, reports, seen

POSTS = np.array([[3.0, 0.5, 0.2], [-1.0, 2.0, 0.15]])
UPRIGHT, UPSIDE_DOWN, SIDEWAYS = (0.0, 0.0, 0.5), (np.pi, 0.0, 0.5), (np.pi / 2, 0.0, 0.0)
#: Of a laser ahead and to the left of the base, turned to the left.
PLACE = np.array([0.3, 0.1, 0.5])


def session_of(**values):
    return DetectorSession(parse_detector({
        'robots': ['r1'], 'range_sigma': 0.01, 'static_time': 0.0, **values}))


def scan_message(ms=0, frame='r1/laser', scan=None, **changes):
    record = RobotLaserScan('r1', ms * 10**6, scan or scan_of(POSTS, beams=1440, sigma=0.005))
    message = outgoing.laser_scan(record)
    message.header.frame_id = frame
    return raw('r1/scan', replace(message, **changes), ms)


def run(session, *messages):
    """Return the clouds that a session publishes for messages, and at the end."""
    return [message for topic, message in drive(session, messages) if topic == 'r1/landmarks']


def columns_of(message):
    return np.frombuffer(message.data.tobytes(), dtype=[
        (field.name, {8: 'f8', 5: 'i4'}[field.datatype]) for field in message.fields])


def points(message):
    columns = columns_of(message)
    assert set(columns['id'].tolist()) == {-1}
    return np.column_stack([columns['x'], columns['y']])


def distances(one, other):
    return np.hypot(*(one[:, None] - other).transpose(2, 0, 1)).min(axis=1)


@pytest.mark.parametrize('angles', [UPRIGHT, UPSIDE_DOWN])
def test_landmarks_are_in_the_base_frame_wherever_the_laser_is(angles):
    link = mounts(('r1/base_link', 'r1/laser', (0.3, 0.1, 0.5), angles))
    # Seen from above, a laser upside down turns the other way.
    mirrored = POSTS * ([1.0, 1.0, 1.0] if angles is UPRIGHT else [1.0, -1.0, 1.0])
    turn = scan_of(mirrored, beams=1440, sigma=0.005)
    # Of a laser that begins at -135 degrees, and does not end at 135.
    scan = replace(
        turn, ranges=turn.ranges[180:], angle_min=turn.angle_min + 180 * turn.angle_increment)

    message, = run(
        session_of(), link, raw('r1/odom', odometry_message(0)), scan_message(scan=scan))

    assert message.header.frame_id == 'r1/base_link'
    assert distances(points(message), transform(PLACE, POSTS[:, :2])) == pytest.approx(
        [0.0, 0.0], abs=0.03)


def test_covariances_are_turned_with_the_laser():
    to_the_left = mounts(('r1/base_link', 'r1/laser', (0.3, 0.1, 0.5), (0.0, 0.0, np.pi / 2)))
    odometry = raw('r1/odom', odometry_message(0))

    of_laser, of_base = (
        columns_of(*run(session_of(range_sigma=0.1), *link, odometry, scan_message()))
        for link in ([], [to_the_left]))

    for x, y in ('x', 'y'), ('y', 'x'):
        np.testing.assert_allclose(of_base[f'var_{x}'], of_laser[f'var_{y}'], rtol=1e-9)
    np.testing.assert_allclose(of_base['cov_xy'], -of_laser['cov_xy'], rtol=1e-9)
    assert (np.abs(of_laser['var_x'] / of_laser['var_y'] - 1.0) > 0.1).all()


def test_landmarks_of_a_laser_at_an_unknown_place_are_in_its_frame_and_the_cure_is_named():
    session = session_of()

    message, = run(session, raw('r1/odom', odometry_message(0)), scan_message())

    assert message.header.frame_id == 'r1/laser'
    assert distances(points(message), POSTS[:, :2]) == pytest.approx([0.0, 0.0], abs=0.03)
    (_, warning, _), = reports(session)
    assert "'r1/laser'" in warning
    assert '/tf_static' in warning


def test_posts_seen_by_a_turned_laser_stand_still_if_a_parameter_says_where_it_is():
    # The robot drives ahead; its laser looks to the left, so that posts pass by in its frame.
    session = session_of(static_time=0.8, **{'r1.sensor_pose': [0.0, 0.0, np.pi / 2]})
    messages = []
    for ms in range(0, 2000, 100):
        x = 0.5 * ms * 1e-3
        seen_now = scan_of(POSTS, beams=1440, sigma=0.005, seed=ms, pose=(x, 0.0, np.pi / 2))
        messages += [
            raw('r1/odom', odometry_message(ms, (x, 0.0, 0.0))), scan_message(ms, scan=seen_now)]

    *_, last = run(session, *messages)

    # In the frame of the laser, where an estimator with the same parameter expects them.
    assert last.header.frame_id == 'r1/laser'
    assert distances(transform(np.array([x, 0.0, np.pi / 2]), points(last)), POSTS[:, :2]) == (
        pytest.approx([0.0, 0.0], abs=0.03))
    (_, warning, _), = reports(session)
    assert warning == ''


def scan_angles(beams):
    return -np.pi + 2.0 * np.pi / beams * np.arange(beams)


def turning_odometry(rate):
    """Return odometry of a robot that turns on the spot [rad/s]."""
    return [
        raw('r1/odom', odometry_message(
            ms, quaternion=(0.0, 0.0, np.sin(rate * ms / 2e3), np.cos(rate * ms / 2e3))))
        for ms in range(0, 200, 10)]


def turning_scan(rate, times, **changes):
    """Return a scan of a robot that turns on the spot [rad/s], of beams at some times [s]."""
    beams = len(times)
    poses = np.column_stack([np.zeros(beams), np.zeros(beams), rate * times])
    return replace(
        scan_of(POSTS, beams=beams),
        ranges=true_ranges(poses, scan_angles(beams), POSTS, NO_WALLS), **changes)


def test_beams_in_the_reverse_order_of_time_are_corrected_for_the_motion_of_the_robot():
    # As of RPLIDAR, of a robot that turns by 1 rad/s: the last beam is measured first.
    beams, duration, rate = 720, 0.1, 1.0
    times = duration * np.arange(beams)[::-1] / (beams - 1)
    scan = turning_scan(rate, times, time_increment=duration / (beams - 1))

    message, = run(
        session_of(reversed_beams=True), *turning_odometry(rate),
        scan_message(frame='r1/base_link', scan=scan))

    # As seen at the end of the scan.
    expected = transform(np.array([0.0, 0.0, -rate * duration]), POSTS[:, :2])
    assert distances(points(message), expected) == pytest.approx([0.0, 0.0], abs=0.03)


@pytest.mark.parametrize('time_increment', [0.0, 2.98e-5, float('nan'), 153_333.3])
def test_scans_without_right_times_are_corrected_by_a_given_duration(time_increment):
    # Of a robot that turns by 1 rad/s; the times are those of drivers (ROBOTIS-GIT/turtlebot3,
    # issue 634; EAIBOT/ydlidar, issue 31).
    beams, duration, rate = 720, 0.1, 1.0
    times = duration / beams * np.arange(beams)
    scan = turning_scan(rate, times)
    session = session_of(scan_duration=duration)

    message, = run(
        session, *turning_odometry(rate), scan_message(
            frame='r1/base_link', scan=scan, time_increment=time_increment,
            scan_time=110_400_000.0))

    expected = transform(np.array([0.0, 0.0, -rate * times[-1]]), POSTS[:, :2])
    assert distances(points(message), expected) == pytest.approx([0.0, 0.0], abs=0.03)
    (_, warning, _), = reports(session)
    assert warning == ''


def test_landmarks_of_scans_that_are_stamped_at_their_ends_are_seen_at_their_stamps():
    # Of a robot that turns by 1 rad/s, in the time up to the stamp of 0.1 s.
    beams, duration, rate = 720, 0.1, 1.0
    times = duration * np.arange(beams) / (beams - 1)
    scan = turning_scan(rate, times, time_increment=duration / (beams - 1))

    message, = run(
        session_of(stamped_at_end=True), *turning_odometry(rate),
        scan_message(100, frame='r1/base_link', scan=scan))

    assert message.header.stamp.nanosec == pytest.approx(100_000_000, abs=1000)
    expected = transform(np.array([0.0, 0.0, -rate * duration]), POSTS[:, :2])
    assert distances(points(message), expected) == pytest.approx([0.0, 0.0], abs=0.03)


def test_a_place_given_by_a_parameter_overrides_the_static_transforms():
    link = mounts(('r1/base_link', 'r1/laser', (0.3, 0.1, 0.5), UPRIGHT))

    message, = run(
        session_of(**{'r1.sensor_pose': PLACE.tolist()}), link,
        raw('r1/odom', odometry_message(0)), scan_message())

    assert message.header.frame_id == 'r1/laser'


def test_one_of_two_lasers_at_an_unknown_place_is_named():
    session = session_of()
    front = mounts(('r1/base_link', 'r1/front', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))

    run(
        session, front, raw('r1/odom', odometry_message(0)), scan_message(0, 'r1/rear'),
        scan_message(5, 'r1/front'))

    (_, warning, _), = reports(session)
    assert warning.startswith(
        "no static transform from the frame 'r1/rear' of the scans to the base frame"
        " 'r1/base_link'")


def test_a_transform_that_has_come_is_no_longer_reported_as_missing():
    session, odometry = session_of(), raw('r1/odom', odometry_message(0))
    link = mounts(('r1/base_link', 'r1/laser', (0.3, 0.1, 0.5), UPRIGHT))

    run(session, odometry, scan_message(0), link, scan_message(5))

    (_, warning, _), = reports(session)
    assert warning == ''


@pytest.mark.parametrize(
    ('messages', 'count', 'warning'),
    [
        ([], 'scans', 'no scans: publish them on r1/scan'),
        ([scan_message(ranges=np.empty(0, np.float32))], 'scans_no_beams', 'no_beams'),
        ([scan_message(time_increment=-1e-4)], 'scans_bad_times', 'in seconds, at least 0'),
        ([raw('r1/odom', odometry_message(0)), scan_message(frame='')], 'scans', 'no frame_id'),
        ([raw('r1/odom', odometry_message(twist_covariance=-np.eye(6)))],
         'odometry_bad_covariance', 'no scans'),
        ([scan_message(angle_increment=0.0)], 'scans_bad_angles', 'bad_angles'),
        ([scan_message(ranges=np.zeros(100_000, np.float32))], 'scans_too_many_beams',
         'too_many_beams'),
        ([raw('r1/scan', seen((1, 2.0, 0.0)))], 'scans_bad_message', 'bad_message'),
        ([scan_message(5), scan_message(5)], 'scans_late', 'no odometry around the scans'),
        ([mounts(('r1/base_link', 'r1/laser', (0.0, 0.0, 0.0), SIDEWAYS)), scan_message()],
         'scans_tilted', 'tilted'),
        ([scan_message(frame='r1/base_link')], 'scans_without_odometry',
         'no odometry around the scans: publish it on r1/odom'),
    ],
)
def test_what_cannot_be_used_is_counted_and_named(messages, count, warning):
    session = session_of()

    run(session, *messages)

    (_, message, counts), = reports(session)
    assert warning in message
    assert counts[count] == (1 if messages else 0)


@pytest.mark.parametrize(('roll', 'rejected'), [
    (0.19, 0), (0.21, 1), (np.pi - 0.19, 0), (np.pi - 0.21, 1)])
def test_a_laser_may_be_tilted_by_up_to_two_tenths_of_a_radian(roll, rejected):
    session = session_of()
    link = mounts(('r1/base_link', 'r1/laser', (0.0, 0.0, 0.0), (roll, 0.0, 0.0)))

    run(session, raw('r1/odom', odometry_message(0)), link, scan_message())

    (_, _, counts), = reports(session)
    assert (counts.get('scans_tilted', 0), counts['scans']) == (rejected, 1 - rejected)


def test_ranges_outside_of_the_limits_of_the_laser_are_named():
    session = session_of()
    millimetres = scan_message(frame='r1/base_link', range_min=50.0, range_max=12_000.0)

    run(session, raw('r1/odom', odometry_message(0)), millimetres)

    (_, warning, _), = reports(session)
    assert warning.endswith('in metres, and look at intensity_threshold')


@pytest.mark.parametrize('fault', laser.ScanFault)
def test_each_fault_of_a_scan_has_a_cure(fault):
    assert laser.CURES[fault]


def test_odometry_that_is_rejected_is_not_taken_for_scans():
    session = session_of()
    bad = odometry_message(twist_covariance=-np.eye(6))

    run(session, *[raw('r1/odom', bad)] * 3, scan_message(frame='r1/base_link'))

    (_, warning, counts), = reports(session)
    assert warning.startswith('most odometry on r1/odom is rejected as bad_covariance')
    assert (counts['odometry_bad_covariance'], counts['scans']) == (3, 1)


def test_mostly_rejected_scans_are_named_with_their_cure():
    session = session_of()
    run(session, raw('r1/odom', odometry_message(0)), *[scan_message(frame='r1/base_link')] * 5)

    (_, warning, _), = reports(session)
    assert warning.startswith('most scans are rejected, most as late: stamp each scan')


def test_without_scans_nothing_else_is_named():
    conditions = session_of().detectors['r1'].conditions()

    assert [condition.name for condition in conditions] == ['no_scans']


def test_of_scans_with_several_faults_those_with_the_usual_one_are_counted():
    session = session_of()
    empty = scan_message(ranges=np.empty(0, np.float32))

    run(session, empty, scan_message(time_increment=-1e-4), empty)

    (_, warning, _), = reports(session)
    assert warning.startswith('all scans are rejected, most as no_beams')


EMPTY, NOT_POSITIVE = {'ranges': np.empty(0, np.float32)}, {'twist_covariance': -np.eye(6)}


@pytest.mark.parametrize(
    ('scans', 'odometry', 'named'),
    [
        ({}, {}, []),
        ({}, None, ['the odometry has stopped']),
        ({}, NOT_POSITIVE, ['most odometry on r1/odom is rejected as bad_covariance']),
        (None, {}, ['the scans have stopped']),
        (EMPTY, {}, ['all scans are rejected, most as no_beams']),
        (EMPTY, None, ['all scans are rejected, most as no_beams', 'the odometry has stopped']),
        (None, NOT_POSITIVE, ['the scans have stopped',
                              'most odometry on r1/odom is rejected as bad_covariance']),
    ])
def test_input_that_fails_is_named_while_it_does(scans, odometry, named):
    session, reported = session_of(), []
    for second in range(30):
        of_scan, of_odometry = (scans, odometry) if 10 <= second < 20 else ({}, {})
        for ms in range(second * 1000, (second + 1) * 1000, 200):
            if of_odometry is not None:
                session.receive(raw('r1/odom', odometry_message(ms, **of_odometry)))
            if of_scan is not None:
                session.receive(scan_message(ms, 'r1/base_link', **of_scan))
            list(session.take())
        (_, warnings, _), = session.counts()
        reported.append([warning.partition(':')[0] for warning in warnings])

    assert reported[9] == reported[29] == []
    assert reported[19] == named


def test_scans_that_wait_for_odometry_count_as_good_ones():
    session = session_of()
    for ms in (10, 20, 30, 10, 20):
        session.receive(scan_message(ms, 'r1/base_link'))

    (_, warning, counts), = reports(session)
    assert (counts['scans_late'], 'rejected' in warning) == (2, False)


def test_single_messages_that_cannot_be_used_are_counted_but_not_named():
    session = session_of()
    bad = raw('r1/odom', odometry_message(twist_covariance=-np.eye(6)))
    odometry = [raw('r1/odom', odometry_message(ms)) for ms in range(5000, 6000, 100)]

    run(session, scan_message(0, 'r1/base_link'), bad, *odometry, *[
        scan_message(ms, 'r1/base_link') for ms in (5500, 5600, 5500)])

    (_, warning, counts), = reports(session)
    assert warning == ''
    assert (counts['scans_without_odometry'], counts['odometry_bad_covariance'],
            counts['scans_late']) == (1, 1, 1)


def test_lasers_with_the_same_stamps_are_both_used():
    session = session_of()
    both = mounts(
        ('r1/base_link', 'r1/front', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ('r1/base_link', 'r1/rear', (0.0, 0.0, 0.0), (0.0, 0.0, np.pi)))
    scans = [
        scan_message(frame='r1/front'),
        scan_message(frame='r1/rear', scan=scan_of(-POSTS * [1, 1, -1], beams=1440, sigma=0.005))]

    found = run(session, both, raw('r1/odom', odometry_message(0)), *scans)

    assert [distances(points(message), POSTS[:, :2]).max() < 0.03 for message in found] == [
        True, True]
    # In one step of the estimator, the observations of a post by both would be of two landmarks.
    assert [message.header.stamp.nanosec for message in found] == [0, 1]


#: Fields of scans of 360 degrees at 5 Hz: those of TurtleBot 3 in 2020 (ROBOTIS-GIT/turtlebot3,
#: issue 634), of a converted cloud, of a simulator without motion, and right ones.
TURNING = {
    'increment too small by 20': (2.98e-5, 0.0, True), 'a converted cloud': (0.0, 1 / 30, True),
    'all beams at once': (0.0, 0.0, False), 'right': (0.2 / 360, 0.0, False),
    'right with the time of a scan': (0.2 / 360, 0.2, False)}


@pytest.mark.parametrize('times', TURNING)
def test_scans_that_last_shorter_than_the_laser_turns_are_named(times):
    time_increment, scan_time, is_named = TURNING[times]
    session, scan = session_of(), scan_of(POSTS, beams=360, sigma=0.005)

    run(session, *[raw('r1/odom', odometry_message(ms)) for ms in range(0, 4000, 100)], *[
        scan_message(
            ms, 'r1/base_link', scan, time_increment=time_increment, scan_time=scan_time)
        for ms in range(0, 3000, 200)])

    (_, warning, _), = reports(session)
    assert ('cover 360 degrees every' in warning) == is_named


#: First stamp [ms] and field of view of scans without times: of a laser that turns, of a
#: simulator, and of a camera.
WITHOUT_TIMES = {
    'laser': (1_700_000_000_000, 2.0 * np.pi, True), 'simulator': (1_000, 2.0 * np.pi, False),
    'camera': (1_700_000_000_000, 1.5, False)}


@pytest.mark.parametrize('sensor', WITHOUT_TIMES)
def test_scans_of_a_laser_that_turns_without_any_time_are_named(sensor):
    first, fov, is_named = WITHOUT_TIMES[sensor]
    session, scan = session_of(), scan_of(POSTS, beams=360, sigma=0.005, fov=fov)

    run(session, *[raw('r1/odom', odometry_message(first + ms)) for ms in range(0, 1000, 50)], *[
        scan_message(first + ms, 'r1/base_link', scan, time_increment=0.0, scan_time=0.0)
        for ms in range(100, 900, 100)])

    (_, warning, _), = reports(session)
    assert ('set scan_duration of the detector' in warning) == is_named


#: Times [ms] from the stamps of scans of 0.1 s and of odometry to their reception.
DELAYS = {
    'first beam': (105, 4, ''), 'last beam': (5, 4, 'set stamped_at_end of the detector'),
    'first beam, clocks differ': (3105, 3004, ''),
    'last beam, clocks differ': (3005, 3004, 'set stamped_at_end of the detector'),
    'a clock that is 0.3 s ahead': (-195, 4, 'arrive 0.199 s before odometry'),
    'log times are stamps': (0, 0, '')}


@pytest.mark.parametrize('case', DELAYS)
def test_scans_that_arrive_before_they_can_be_complete_are_named(case):
    of_scan, of_odometry, named = DELAYS[case]
    session, scan = session_of(), scan_of(POSTS, beams=360, sigma=0.005)

    run(session, *[
        replace(raw('r1/odom', odometry_message(ms)), received=(ms + of_odometry) * 10**6)
        for ms in range(0, 4000, 100)], *[
        replace(
            scan_message(ms, 'r1/base_link', scan, time_increment=0.1 / 360, scan_time=0.1),
            received=(ms + of_scan) * 10**6)
        for ms in range(0, 3000, 100)])

    (_, warning, _), = reports(session)
    assert named in warning
    assert bool(warning) == bool(named)


def test_scans_of_a_laser_at_a_lower_rate_than_it_turns_are_right():
    # Nine of ten scans are dropped on the way; the message states the time between scans.
    session, scan = session_of(), scan_of(POSTS, beams=360, sigma=0.005)

    run(session, *[raw('r1/odom', odometry_message(ms)) for ms in range(0, 30_000, 500)], *[
        scan_message(ms, 'r1/base_link', scan, time_increment=0.1 / 360, scan_time=0.1)
        for ms in range(0, 20_000, 1000)])

    (_, warning, _), = reports(session)
    assert warning == ''


def test_scans_without_intensities_are_named_where_reflectors_are_wanted():
    session = session_of(intensity_threshold=500.0)

    run(session, scan_message())

    (_, warning, counts), = reports(session)
    assert (counts['scans_no_intensities'], 'no_intensities' in warning) == (1, True)


def test_radius_limits_that_fit_nothing_are_named():
    session = session_of(min_radius=0.4, max_radius=0.5)

    run(session, raw('r1/odom', odometry_message(0)), scan_message(frame='r1/base_link'))

    (_, warning, _), = reports(session)
    assert warning == 'no landmark so far, most segments are rejected as radius'


def test_scans_that_wait_for_odometry_are_bounded_and_named():
    session, few = session_of(), scan_of([], beams=16)
    for k in range(2_500):
        # At 10 kHz, so that no scan is a second old.
        record = RobotLaserScan('r1', k * 10**5, few)
        session.receive(raw('r1/scan', outgoing.laser_scan(record)))

    (_, warning, counts), = reports(session)
    assert (counts['scans'], counts['scans_lost']) == (0, 500)
    assert warning.startswith('more than 500 scans wait: they come faster than they are processed')


def test_many_scans_of_one_robot_do_not_delay_those_of_another():
    session, few = session_of(robots=['r1', 'r2']), scan_of([], beams=16)
    for robot, scans in ('r1', 100), ('r2', 1):
        for k in range(scans):
            record = RobotLaserScan(robot, k * 10**6, few)
            session.receive(raw(f'{robot}/scan', outgoing.laser_scan(record)))
        for ms in 0, 1000:
            session.receive(raw(f'{robot}/odom', odometry_message(ms)))

    topics = [topic for topic, _ in session.take(lambda _: False)]

    assert topics == ['r1/landmarks', 'r2/landmarks', *['r1/landmarks'] * 99]


def test_diagnostics_have_the_counts_of_each_robot():
    session = session_of()
    run(session, raw('r1/odom', odometry_message(0)), scan_message(frame='r1/base_link'))

    counts = [*session.counts(), ('r2', ['no scans', 'no odometry'], {})]
    _, diagnostics = report('detector', counts, 7)

    status, of_r2 = diagnostics.status
    values = {entry.key: entry.value for entry in status.values}
    assert (status.name, status.level, values['landmarks']) == ('detector: r1', 0, '2')
    assert (of_r2.level, of_r2.message) == (1, 'no scans; no odometry')
