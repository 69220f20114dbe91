# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of other packages become observations in the base frame; bad ones are counted."""

from dataclasses import replace
import json
import struct

import numpy as np
import pytest

from fej_slam_ros.ros.parameters.adapter_settings import parse_adapter
from fej_slam_ros.ros.session.adapter_session import AdapterSession
from helpers import foreign
from helpers.core import moments
from helpers.ros import drive, feed, mounts, odometry_message, raw, reports, TYPES

#: A camera 0.2 m ahead of the base and 0.5 m above it that looks to the left: z of its optical
#: frame is to the left, x backwards along the robot seen from the image, that is ahead.
OPTICAL = (-np.pi / 2, 0.0, 0.0)
CAMERA = mounts(
    ('r1/base_link', 'r1/mast', (0.2, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ('r1/mast', 'r1/camera', (0.0, 0.0, 0.5), OPTICAL))
ODOMETRY = raw('r1/odom', odometry_message(0))
#: A point 3 m in front of this camera, 1 m to its right, 0.4 m below it, in the base frame.
SEEN, IN_BASE = (1.0, 0.4, 3.0), (1.2, 3.0)


def session_of(save=lambda names: None, ids=(), robots=('r1',), **values):
    return AdapterSession(parse_adapter({'robots': list(robots), **values}), dict(ids), save)


def run(session, *messages):
    """Return the publications of a session for messages, and at the end."""
    return drive(session, messages)


def clouds(publications, topic='r1/landmarks'):
    """Return IDs, points and covariances (n, 2, 2) of each published cloud."""
    return [_columns(message) for name, message in publications if name == topic]


def _columns(cloud):
    copy = TYPES.deserialize_cdr(TYPES.serialize_cdr(cloud, cloud.__msgtype__), cloud.__msgtype__)
    columns = np.frombuffer(copy.data.tobytes(), dtype=[
        (field.name, {8: 'f8', 5: 'i4'}[field.datatype]) for field in copy.fields])
    xx, xy, yy = columns['var_x'], columns['cov_xy'], columns['var_y']
    return (
        columns['id'].tolist(), np.column_stack([columns['x'], columns['y']]),
        np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1))


@pytest.mark.parametrize(
    ('name', 'message', 'id_'),
    [
        ('apriltag', foreign.april_tags(5, 'r1/camera', {'tag36h11:4': SEEN}), 4),
        ('aruco', foreign.aruco(5, 'r1/camera', {7: SEEN}), 7),
        ('aruco_ros', foreign.aruco_ros(5, 'r1/camera', {8: SEEN}), 8),
        ('detection3d', foreign.detections3d(5, 'r1/camera', [('12', '3', SEEN, None)]), 12),
        ('detection3d_track', foreign.detections3d(5, 'r1/camera', [('12', '3', SEEN, None)]), 3),
        ('detection3d_anonymous',
         foreign.detections3d(5, 'r1/camera', [('12', '3', SEEN, None)]), -1),
        ('landmark_list', foreign.landmark_list(5, 'r1/camera', {'9': (SEEN, 1e4)}), 9),
        ('marker_array', foreign.marker_array(5, 'r1/camera', {('tags', 6): SEEN}), 6),
    ],
)
def test_an_object_of_an_optical_frame_is_observed_in_the_base_frame(name, message, id_):
    session = session_of(formats=[name])

    (found, points, _), = clouds(run(session, ODOMETRY, CAMERA, message))

    assert found == [id_]
    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


@pytest.mark.parametrize('name', ['detection3d_track', 'detection3d_anonymous'])
def test_a_detection_that_is_a_box_without_hypothesis_is_at_its_centre(name):
    message = foreign.detections3d(5, 'r1/camera', [None], box=SEEN)

    (ids, points, _), = clouds(run(session_of(formats=[name]), ODOMETRY, CAMERA, message))

    assert ids == [-1]
    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


@pytest.mark.parametrize(
    ('frame', 'sentence'),
    [('map', "the frame 'map' is that of a map or of odometry"),
     ('r1/odom', "the frame 'r1/odom' is that of a map or of odometry")])
def test_objects_in_the_world_are_not_taken_for_detections_of_a_camera(frame, sentence):
    session = session_of(
        formats=['marker_array'], **{'r1.sensor_pose': [0.2, 0.0, 0.5, -1.57, 0.0, 0.0]})

    found = run(session, ODOMETRY, foreign.marker_array(5, frame, {('tags', 6): SEEN}))

    assert clouds(found) == []
    assert [warning.partition(':')[0] for _, warning, _ in reports(session)] == [sentence]


def test_a_camera_without_frame_needs_a_pose_and_is_not_the_base():
    message = foreign.marker_array(5, '', {('tags', 6): SEEN})
    session = session_of(formats=['marker_array'])
    known = session_of(
        formats=['marker_array'], **{'r1.sensor_pose': [0.2, 0.0, 0.5, -np.pi / 2, 0.0, 0.0]})

    assert clouds(run(session, ODOMETRY, message)) == []
    assert [warning for _, warning, _ in reports(session)] == [
        'the messages have no frame_id: set it in the detector, or set r1.sensor_pose']
    (_, points, _), = clouds(run(known, ODOMETRY, message))
    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


@pytest.mark.parametrize(
    ('detections', 'reason', 'cure'),
    [([('chair', '1', SEEN, None), ('chair', '2', (2, 0, 3), None)], 'duplicate_id',
      'detection3d_track'),
     ([('4', '', SEEN, -np.eye(6))], 'bad_covariance', 'all zero if they are unknown'),
     ([None], 'no_identity', 'detection3d_anonymous')])
def test_why_all_detections_are_rejected_is_told_with_a_cure(detections, reason, cure):
    session = session_of(formats=['detection3d'])

    run(session, ODOMETRY, CAMERA, foreign.detections3d(5, 'r1/camera', detections))

    (_, warning, _), = reports(session)
    assert f'rejected, most as {reason}: ' in warning
    assert cure in warning


def test_range_yaw_and_pitch_are_seen_from_the_sensor_of_the_message():
    # The laser is turned to the left by 90 degrees, 0.5 m ahead.
    laser = foreign.pose((0.5, 0.0, 0.3), foreign.turned(w=np.sqrt(0.5), z=np.sqrt(0.5)))
    observations = [(4, 2.0, 0.0, 0.0), (-1, 2.0, np.pi / 2, np.pi / 3)]
    message = foreign.range_bearing(5, 'r1/base_link', observations, (0.1, 0.02, 0.03), laser)

    (ids, points, R), = clouds(run(session_of(formats=['range_bearing']), ODOMETRY, message))

    assert ids == [4, -1]
    np.testing.assert_allclose(points, [(0.5, 2.0), (-0.5, 0.0)], atol=1e-9)
    # Ahead of the laser: 0.1 m along the beam (y of the base), 2 m * 0.02 across.
    np.testing.assert_allclose(R[0], np.diag([0.04**2, 0.1**2]), rtol=5e-3, atol=1e-12)
    # Up by 60 degrees: range and pitch move the point on the plane along the beam.
    along = (0.1 * np.cos(np.pi / 3))**2 + (2.0 * np.sin(np.pi / 3) * 0.03)**2
    across = (2.0 * 0.5 * 0.02)**2
    # Terms of second order are below half a percent.
    np.testing.assert_allclose(R[1], np.diag([along, across]), rtol=5e-3, atol=1e-12)


@pytest.mark.parametrize('sigma', [(0.1, 0.02, 0.03), (0.1, 0.3, 0.4)])
def test_the_covariance_of_range_yaw_and_pitch_is_the_mean_squared_error_of_the_point(sigma):
    def seen_at(r, yaw, pitch):
        return np.array([r * np.cos(pitch) * np.cos(yaw), r * np.cos(pitch) * np.sin(yaw)])

    message = foreign.range_bearing(5, 'r1/base_link', [(4, 2.0, 0.7, -0.4)], sigma)

    (_, points, R), = clouds(run(session_of(formats=['range_bearing']), ODOMETRY, message))

    mean, P = moments(seen_at, (2.0, 0.7, -0.4), sigma)
    z = seen_at(2.0, 0.7, -0.4)
    np.testing.assert_allclose(points, [z], atol=1e-12)
    np.testing.assert_allclose(R, [P + np.outer(mean - z, mean - z)], atol=1e-12)


def test_covariances_of_messages_are_turned_into_the_base_frame():
    full = np.zeros((6, 6))
    full[:3, :3] = np.diag([0.01, 0.02, 0.09])  # right, down, ahead of the camera
    message = foreign.detections3d(5, 'r1/camera', [('4', '', SEEN, full)])

    (_, _, R), = clouds(run(session_of(formats=['detection3d']), ODOMETRY, CAMERA, message))

    np.testing.assert_allclose(R, [np.diag([0.01, 0.09])], atol=1e-12)


@pytest.mark.parametrize('weight', [1e4, 1e5, 1e8])
def test_usual_weights_of_cartographer_are_no_variances(weight):
    session = session_of(
        formats=['landmark_list'], range_sigma=0.3, range_sigma_growth=0.0, bearing_sigma=0.1)
    message = foreign.landmark_list(5, 'r1/base_link', {'4': ((2.0, 0.0, 0.0), weight)})

    (_, _, R), = clouds(run(session, ODOMETRY, message))

    # Of a point 2 m ahead: 0.3 m along, and 0.1 rad across the line of sight.
    np.testing.assert_allclose(R, [np.diag([0.09, 0.04])], rtol=1e-9)


def test_the_weight_of_a_landmark_is_the_inverse_of_its_variance():
    message = foreign.landmark_list(5, 'r1/camera', {'4': (SEEN, 400.0)})

    (_, _, R), = clouds(run(session_of(formats=['landmark_list']), ODOMETRY, CAMERA, message))

    np.testing.assert_allclose(R, [np.eye(2) / 400.0], rtol=1e-9)


def test_without_covariance_the_distance_is_less_exact_than_the_direction():
    session = session_of(range_sigma=0.01, range_sigma_growth=0.02, bearing_sigma=0.004)
    # 3 m ahead of the camera, on its axis: along y of the base.
    message = foreign.april_tags(5, 'r1/camera', {'tag36h11:4': (0.0, 0.0, 3.0)})

    (_, _, R), = clouds(run(session, ODOMETRY, CAMERA, message))

    np.testing.assert_allclose(
        R, [np.diag([(3.0 * 0.004)**2, 0.01**2 + (0.02 * 9.0)**2])], atol=1e-12)


@pytest.mark.parametrize(
    ('name', 'nanoseconds'),
    [('detection3d_anonymous', [5e6, 5e6 + 1]), ('detection3d', [5e6, 5e6])])
def test_objects_without_id_of_two_cameras_at_one_time_are_of_two_steps(name, nanoseconds):
    other = mounts(('r1/base_link', 'r1/rear', (0.0, 0.0, 0.5), OPTICAL))
    images = [
        foreign.detections3d(5, frame, [('12', '', SEEN, None)])
        for frame in ('r1/camera', 'r1/rear')]

    found = run(session_of(formats=[name]), ODOMETRY, CAMERA, other, *images)

    assert [
        message.header.stamp.nanosec for topic, message in found
        if topic == 'r1/landmarks'] == nanoseconds


def test_objects_wait_for_odometry_and_for_transforms_that_come_late():
    session = session_of()
    early = [foreign.april_tags(ms, 'r1/camera', {'tag36h11:4': SEEN}) for ms in (5, 15)]

    before = feed(session, early)
    (_, warning, counts), = reports(session)
    after = run(session, CAMERA, ODOMETRY)

    assert clouds(before) == []
    assert ("'r1/camera'" in warning, counts['waiting']) == (True, 2)
    assert [points.tolist() for _, points, _ in clouds(after)] == [
        [pytest.approx(IN_BASE)], [pytest.approx(IN_BASE)]]
    assert [m.header.stamp.nanosec for t, m in after if t == 'r1/landmarks'] == [5e6, 15e6]


def test_objects_without_a_transform_are_bounded_counted_and_named():
    session = session_of()
    feed(session, (
        foreign.april_tags(ms, 'r1/camera', {'tag36h11:4': SEEN}) for ms in range(1_200)))

    assert next(reports(session))[2]['waiting'] == 1_000
    run(session)

    (_, _, counts), = reports(session)
    assert (counts['waiting'], counts['rejected_wrong_frame']) == (0, 1_200)


def test_a_transform_that_has_come_is_no_longer_reported_as_missing():
    session = session_of()
    feed(session, (
        foreign.april_tags(ms, 'r1/camera', {'tag36h11:4': SEEN}) for ms in range(1_200)))
    feed(session, [CAMERA, ODOMETRY])

    (_, warning, counts), = reports(session)
    assert (warning, counts['messages'], counts['rejected_wrong_frame']) == ('', 1_000, 200)


def test_the_pose_of_a_sensor_may_be_a_parameter():
    session = session_of(**{'r1.sensor_pose': [0.2, 0.0, 0.5, *OPTICAL]})

    (_, points, _), = clouds(run(
        session, foreign.april_tags(5, 'any', {'tag36h11:4': SEEN})))

    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


def test_a_left_handed_frame_is_turned_round():
    session = session_of(mirrored_axis='x')
    x, y, z = SEEN

    (_, points, _), = clouds(run(
        session, ODOMETRY, CAMERA,
        foreign.april_tags(5, 'r1/camera', {'tag36h11:4': (-x, y, z)})))

    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


def test_on_the_tf_of_the_team_the_frame_of_the_camera_says_whose_tag_it_is():
    session = session_of(robots=('r1', 'r2'))
    other = mounts(('r2/base_link', 'front_camera', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    odometry = raw('r2/odom', odometry_message(0, child='r2/base_link'))

    found = run(
        session, ODOMETRY, odometry, CAMERA, other,
        foreign.april_tags(5, 'r1/camera', {'tag36h11:4': SEEN}, '/tf'),
        foreign.april_tags(6, 'front_camera', {'tag36h11:5': (2.0, 1.0, 0.0)}, '/tf'),
        foreign.april_tags(7, 'kitchen_camera', {'tag36h11:6': SEEN}, '/tf'),
        foreign.april_tags(8, 'r3/camera', {'tag36h11:7': SEEN}, '/tf'))

    assert [ids for ids, _, _ in clouds(found)] == [[4]]
    assert [(ids, points.tolist()) for ids, points, _ in clouds(found, 'r2/landmarks')] == [
        ([5], [[2.0, 1.0]])]
    *_, (name, _, counts) = reports(session)
    assert (name, counts['rejected_wrong_frame']) == ('unknown robot', 2)


def test_other_transforms_on_tf_are_no_scans():
    session = session_of()

    found = run(session, ODOMETRY, CAMERA, foreign.april_tags(
        5, 'r1/camera', {'r1/lens': (1.0, 2.0, 0.0)}))

    assert clouds(found) == []
    (_, warning, counts), = reports(session)
    assert (counts['ignored'], "'names'" in warning) == (1, True)


def test_the_name_of_a_tag_may_begin_with_that_of_the_robot_that_sees_it():
    # In a tree of transforms, a tag cannot be below two cameras.
    session = session_of(robots=['r1', 'r2'])

    found = run(session, ODOMETRY, raw('r2/odom', odometry_message(child='r2/base_link')), *[
        foreign.april_tags(5, f'{robot}/base_link', {f'{robot}/tag36h11:4': SEEN}, '/tf')
        for robot in ('r1', 'r2')])

    assert [[ids for ids, _, _ in clouds(found, f'{robot}/landmarks')]
            for robot in ('r1', 'r2')] == [[[4]], [[4]]]


def test_tags_of_other_names_on_tf_are_named_at_each_robot():
    session = session_of(robots=['r1', 'r2'])
    links = foreign.april_tags(5, 'r1/base_link', {'r1/wheel_left': SEEN}, '/tf')
    tag = foreign.april_tags(5, 'r1/camera', {'tag_7': SEEN}, '/tf')

    run(session, ODOMETRY, links, tag, links)

    assert ["for example 'tag_7'" in warning
            for name, warning, _ in reports(session) if name != 'unknown robot'] == [True, True]


@pytest.mark.parametrize(('parent', 'child'), [
    ('r1/base_link', 'wheel_left'), ('r1/odom', 'base_footprint'), ('map', 'r1_odom')])
def test_links_and_odometry_of_a_robot_on_tf_are_no_tags_of_other_names(parent, child):
    session = session_of()

    run(session, ODOMETRY, foreign.april_tags(5, parent, {child: SEEN}, '/tf'))

    (_, warning, _), = reports(session)
    assert warning.startswith('no detections: publish them on')


def test_tags_with_names_of_their_own_are_chosen_by_a_pattern():
    saved = {}
    session = session_of(saved.update, names='dock|gate_.*')
    tags = {'dock': SEEN, 'gate_left': SEEN, 'tag36h11:4': SEEN}

    (ids, _, _), = clouds(run(
        session, ODOMETRY, CAMERA, foreign.april_tags(5, 'r1/camera', tags)))

    assert saved == dict(zip(['dock', 'gate_left'], ids))
    assert min(ids) >= 2**30


def test_names_that_begin_with_no_robot_are_different_as_a_whole():
    saved = {}
    doors = {f'{room}/door': (SEEN, 1.0) for room in ('kitchen', 'hall')}

    run(session_of(saved.update, formats=['landmark_list']), ODOMETRY,
        foreign.landmark_list(5, 'r1/base_link', doors))

    assert saved.keys() == doors.keys()


def test_names_have_the_same_ids_at_all_robots_whatever_they_see_first():
    names = ['dock', 'gate', 'tag36h11:4', '17', 'café']

    def ids(order):
        saved = {}
        messages = [foreign.landmark_list(
            k, 'r1/base_link', {name: (SEEN, 1.0)}) for k, name in enumerate(order)]
        run(session_of(saved.update, formats=['landmark_list']), ODOMETRY, *messages)
        return saved

    assert ids(names) == ids(names[::-1])
    assert ids(names)['tag36h11:4'] == 4
    assert ids(names)['17'] == 17
    assert len({*ids(names).values()}) == len(names)


def test_new_ids_are_published_and_saved_after_stamps_have_gone_back():
    saved = []
    session = session_of(lambda ids: saved.append(dict(ids)))
    messages = [foreign.april_tags(ms, 'r1/base_link', {f'tag36h11:{tag}': SEEN})
                for ms, tag in ((900_000, 8), (2000, 9))]

    feed(session, (ODOMETRY, *messages))

    assert saved[-1] == {'tag36h11:8': 8, 'tag36h11:9': 9}


def test_new_ids_are_published_and_saved_once_a_second_and_at_the_end():
    saved = []
    session = session_of(lambda ids: saved.append(dict(ids)), ids={'dock': 3})
    messages = [foreign.april_tags(ms, 'r1/base_link', {f'tag36h11:{tag}': SEEN})
                for ms, tag in ((5, 8), (6, 8), (900, 9), (1005, 9), (1500, 10))]

    found = run(session, ODOMETRY, *messages)

    published = [json.loads(message.data) for topic, message in found if topic == 'landmark_ids']
    first = {'dock': 3, 'tag36h11:8': 8}
    assert published == saved == [
        first, {**first, 'tag36h11:9': 9}, {**first, 'tag36h11:9': 9, 'tag36h11:10': 10}]


def test_an_id_that_two_names_would_have_is_taken_back():
    session = session_of(formats=['landmark_list'])

    found = run(session, ODOMETRY, *(
        foreign.landmark_list(ms, 'r1/base_link', dict.fromkeys(names, (SEEN, 1.0)))
        for ms, names in ((5, ['tag36h11:4']), (2000, ['tag25h9:4', 'tag36h11:5']))))

    published = [json.loads(message.data) for topic, message in found if topic == 'landmark_ids']
    assert published == [{'tag36h11:4': 4}, {'tag36h11:5': 5}]


def test_names_with_the_same_id_are_refused_unless_they_are_given_others():
    both = {'tag36h11:4': (SEEN, 1.0), 'tag25h9:4': (SEEN, 1.0)}
    message = foreign.landmark_list(5, 'r1/base_link', both)
    session = session_of(formats=['landmark_list'])

    (ids, _, _), = clouds(run(session, ODOMETRY, message))
    (given, _, _), = clouds(run(
        session_of(ids={'tag25h9:4': 104}, formats=['landmark_list']), ODOMETRY, message))

    assert (ids, given) == ([], [4, 104])
    (_, warning, counts), = reports(session)
    assert ('ids_file' in warning, counts['rejected_bad_id']) == (True, 2)


def test_a_tag_of_a_robot_is_an_observation_of_the_robot_behind_it():
    session = session_of(robots=('r1', 'r2', 'r3'), **{
        'r3.tags': ['tag36h11:30', '31'], 'r3.tag_depth': 0.25, 'r1.tags': ['own'], 'r3.id': 7})
    # Both are 3 m and 4 m ahead of the camera, which looks to the left; normals along its axis.
    tags = {'tag36h11:30': (0.0, 0.0, 3.0), 'tag36h11:31': (0.0, 0.0, 4.0), 'own': SEEN,
            'tag36h11:4': SEEN}

    found = run(session, ODOMETRY, CAMERA, foreign.april_tags(5, 'r1/camera', tags))

    (ids, points, R), = clouds(found, 'r1/robots')
    assert ids == [7]
    # The nearer tag is the more exact one.
    np.testing.assert_allclose(points, [(0.2, 3.25)], atol=1e-9)
    assert R[0, 0, 0] == pytest.approx((3.0 * 0.005)**2 + (0.25 * 0.1)**2)
    assert [ids for ids, _, _ in clouds(found)] == [[4]]
    counts = next(reports(session))[2]
    assert (counts['rejected_self_sighting'], counts['further_tags']) == (1, 1)


def test_a_tag_of_a_robot_may_be_listed_with_the_name_of_another_one():
    session = session_of(robots=('r1', 'r2'), **{'r2.tags': ['r1/box']})

    found = run(session, ODOMETRY, foreign.april_tags(5, 'r1/base_link', {'r1/box': SEEN}))

    assert [ids for ids, _, _ in clouds(found, 'r1/robots')] == [[2]]


def polar(*observations, sigmas=(0.1, 0.02, 0.03)):
    return foreign.range_bearing(5, 'r1/base_link', observations, sigmas)


def weighted(weight):
    return foreign.landmark_list(5, 'r1/base_link', {'4': (SEEN, weight)})


@pytest.mark.parametrize(
    ('name', 'message', 'count'),
    [
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {'tag36h11:4': (np.nan, 0.0, 1.0)}), 'not_finite'),
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {'tag36h11:4': (200.0, 0.0, 1.0)}), 'out_of_range'),
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {'tag36h11:4': (2e6, 0.0, 1.0)}), 'out_of_range'),
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {'tag36h11:4': (0.0, 0.0, 0.0)}), 'out_of_range'),
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {'tag36h11:4000000000': SEEN}), 'bad_id'),
        ('marker_array', foreign.marker_array(
            5, 'r1/base_link', {('n' * 300, 4): SEEN}), 'bad_id'),
        ('apriltag', raw('r1/tf', odometry_message(0)), 'bad_message'),
        ('apriltag', foreign.april_tags(
            5, 'r1/base_link', {f'tag36h11:{k}': SEEN for k in range(2_001)}), 'too_large'),
        ('range_bearing', polar((4, 2.0, np.inf, 0.0)), 'not_finite'),
        ('range_bearing', polar((4, 2.0, 0.0, 0.0), sigmas=(np.nan, 0.1, 0.1)), 'not_finite'),
        ('range_bearing', polar((4, -2.0, 0.0, 0.0)), 'out_of_range'),
        ('range_bearing', polar((4, 2.0, 0.0, 0.0), sigmas=(0.1, 1e200, 0.1)), 'out_of_range'),
        ('range_bearing', polar((-2, 2.0, 0.0, 0.0)), 'bad_id'),
        ('range_bearing', polar((4, 2.0, 0.0, 0.0), sigmas=(0.1, 0.0, 0.0)), 'bad_covariance'),
        ('landmark_list', weighted(0.0), 'bad_covariance'),
        ('landmark_list', weighted(-1.0), 'bad_covariance'),
        ('landmark_list', weighted(np.nan), 'bad_covariance'),
        ('landmark_list', weighted(np.inf), 'bad_covariance'),
        ('landmark_list', weighted(1e30), 'out_of_range'),
        ('landmark_list', weighted(1e-320), 'out_of_range'),
        ('detection3d', foreign.detections3d(
            5, 'r1/base_link', [('4', '', SEEN, -np.eye(6))]), 'bad_covariance'),
        ('detection3d', foreign.detections3d(5, 'r1/base_link', [None]), 'no_identity'),
    ],
)
@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_what_cannot_be_used_is_counted_by_reason(name, message, count):
    session = session_of(formats=[name])

    found = run(session, ODOMETRY, message)

    assert [ids for ids, _, _ in clouds(found)] in ([], [[]])
    assert next(reports(session))[2][f'rejected_{count}'] == 1


def test_a_message_of_many_bytes_is_rejected_before_it_is_decoded():
    session, message = session_of(), foreign.april_tags(5, 'r1/base_link', {'tag36h11:4': SEEN})

    found = run(session, ODOMETRY, replace(message, raw=message.raw + bytes(4_000_000)))

    assert not clouds(found)
    assert next(reports(session))[2]['rejected_too_large'] == 1


def test_a_bad_stamp_is_rejected():
    session, message = session_of(), foreign.april_tags(5, 'r1/base_link', {'tag36h11:4': SEEN})
    bad = bytearray(message.raw)
    # After the encapsulation, the number of transforms and the seconds.
    bad[12:16] = (2**31).to_bytes(4, 'little')

    run(session, ODOMETRY, replace(message, raw=bytes(bad)))

    assert next(reports(session))[2]['rejected_bad_stamp'] == 1


def test_a_stamp_after_which_no_other_fits_into_a_message_is_rejected():
    session = session_of(formats=['detection3d_anonymous'])
    # After the encapsulation, the seconds and nanoseconds.
    stamp = struct.pack('<iI', 2**31 - 1, 10**9 - 1)
    detected = [
        replace(message, raw=message.raw[:4] + stamp + message.raw[12:]) for message in (
            foreign.detections3d(5, frame, [('12', '3', SEEN, None)])
            for frame in ('r1/base_link', 'r1/camera'))]

    published = clouds(run(session, ODOMETRY, CAMERA, *detected))

    assert published == []
    assert next(reports(session))[2]['rejected_bad_stamp'] == 2


def test_a_detection_of_a_box_only_is_where_the_box_is():
    session = session_of(formats=['detection3d'])
    message = foreign.detections3d(
        5, 'r1/base_link', [('4', '', (0.0, 0.0, 0.0), None)], box=(2.0, 1.0, 0.3))

    (_, points, _), = clouds(run(session, ODOMETRY, message))

    np.testing.assert_allclose(points, [(2.0, 1.0)])


def test_detections_with_frames_of_their_own_are_in_these():
    session = session_of(formats=['detection3d'])
    message = foreign.detections3d(
        5, 'elsewhere', [('4', '', SEEN, None)], frame_of_each='r1/camera')

    (_, points, _), = clouds(run(session, ODOMETRY, CAMERA, message))

    np.testing.assert_allclose(points, [IN_BASE], atol=1e-9)


def test_two_objects_that_nothing_tells_apart_are_both_observed():
    session = session_of(formats=['detection3d_anonymous'])
    message = foreign.detections3d(
        5, 'r1/base_link', [('4', '', SEEN, None), ('4', '', (2.0, 2.0, 0.0), None)])

    (ids, _, _), = clouds(run(session, ODOMETRY, message))

    assert ids == [-1, -1]


def test_only_added_markers_are_observed():
    message = foreign.marker_array(
        5, 'r1/base_link', {('tags', 6): SEEN, ('tags', 7): SEEN}, deleted=[7])

    (ids, _, _), = clouds(run(session_of(formats=['marker_array']), ODOMETRY, message))

    assert ids == [6]


def test_tags_of_two_images_in_a_message_are_two_scans():
    one, other = (foreign.april_tags(ms, 'r1/base_link', {'tag36h11:4': SEEN}) for ms in (5, 6))

    found = run(session_of(), ODOMETRY, foreign.joined(one, other))

    assert [ids for ids, _, _ in clouds(found)] == [[4], [4]]


def test_tags_of_two_cameras_at_one_time_in_a_message_are_seen_from_each():
    one, other = (
        foreign.april_tags(5, frame, {tag: SEEN})
        for frame, tag in (('r1/camera', 'tag36h11:4'), ('r1/base_link', 'tag36h11:5')))

    found = run(session_of(), ODOMETRY, CAMERA, foreign.joined(one, other))

    assert [(ids, points.tolist()) for ids, points, _ in clouds(found)] == [
        ([4], [pytest.approx(IN_BASE)]), ([5], [pytest.approx(SEEN[:2])])]


def test_a_pose_of_the_sensor_that_is_not_set_leaves_it_to_the_transforms():
    message = foreign.range_bearing(5, 'r1/camera', [(4, 3.0, 0.0, -np.pi / 2)], (0.1, 0.1, 0.1))

    (_, points, _), = clouds(run(
        session_of(formats=['range_bearing']), ODOMETRY, CAMERA, message))

    # Straight up by its pitch is along z of the optical frame.
    np.testing.assert_allclose(points, [(0.2, 3.0)], atol=1e-9)


def test_the_parameter_is_used_instead_of_the_pose_in_the_message():
    laser = foreign.pose((0.5, 0.0, 0.3))
    message = foreign.range_bearing(5, 'laser', [(4, 2.0, 0.0, 0.0)], (0.1, 0.1, 0.1), laser)
    session = session_of(
        formats=['range_bearing'], **{'r1.sensor_pose': [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]})

    (_, points, _), = clouds(run(session, ODOMETRY, message))

    np.testing.assert_allclose(points, [(3.0, 0.0)], atol=1e-12)


def test_deviations_that_are_all_zero_are_unknown():
    session = session_of(formats=['range_bearing'], range_sigma=0.3, range_sigma_growth=0.0)

    (_, _, R), = clouds(run(session, ODOMETRY, polar((4, 2.0, 0.0, 0.0), sigmas=(0.0, 0.0, 0.0))))

    assert R[0, 0, 0] == pytest.approx(0.09)


def test_a_tag_on_a_robot_that_is_only_a_point_is_deeper_along_the_line_of_sight():
    session = session_of(
        robots=('r1', 'r2'), formats=['range_bearing'], **{
            'r2.tags': ['30'], 'r2.tag_depth': 0.5})

    found = run(session, ODOMETRY, polar((30, 2.0, 0.7, 0.3)))

    (_, points, _), = clouds(found, 'r1/robots')
    level = 2.5 * np.cos(0.3)
    np.testing.assert_allclose(
        points, [(level * np.cos(0.7), level * np.sin(0.7))], atol=1e-9)


def test_a_frame_without_name_of_a_robot_waits_until_all_bases_are_known():
    session = session_of(robots=('r1', 'r2'))
    both = mounts(('base_link', 'camera', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    tag = foreign.april_tags(5, 'camera', {'tag36h11:4': SEEN}, '/tf')
    first, second = (
        raw(f'{robot}/odom', odometry_message(0, child='base_link')) for robot in ('r1', 'r2'))

    found = run(session, first, both, tag, second)

    assert clouds(found) == clouds(found, 'r2/landmarks') == []
    *_, (name, warning, _) = reports(session)
    assert (name, "'camera'" in warning) == ('unknown robot', True)


def test_the_detections_of_another_robot_on_tf_are_not_used():
    session = session_of(**{'r1.sensor_pose': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]})

    found = run(session, ODOMETRY, foreign.april_tags(
        5, 'r2/camera', {'tag36h11:4': SEEN}, '/tf'))

    assert clouds(found) == []


def test_the_missing_transform_of_a_frame_on_tf_is_a_matter_of_its_robot():
    session = session_of(robots=('r1', 'r2'))

    run(session, ODOMETRY, foreign.april_tags(5, 'r1/camera', {'tag36h11:4': SEEN}, '/tf'))

    name, warning, counts = next(reports(session))
    assert (name, counts['rejected_wrong_frame']) == ('r1', 1)
    assert "from the frame 'r1/camera' to the base frame 'r1/base_link'" in warning


def test_many_unknown_frames_do_not_silence_a_known_one():
    session = session_of()
    strays = [foreign.april_tags(k, f'stray_{k}', {'tag36h11:4': SEEN}) for k in range(150)]
    good = [foreign.april_tags(k, 'r1/camera', {'tag36h11:4': SEEN}) for k in range(200, 205)]

    found = feed(session, [ODOMETRY, CAMERA, *strays, *good])

    assert len(clouds(found)) == 5
    # Of 100 places for frames, the known one needs one for a moment.
    assert next(reports(session))[2]['rejected_wrong_frame'] == 51


@pytest.mark.parametrize(
    ('tf_topics', 'topics'),
    [('shared', ['tf']), ('robot', ['r1/tf']), ('both', ['r1/tf', 'tf'])])
def test_tags_come_on_the_topics_of_the_parameter(tf_topics, topics):
    assert session_of(tf_topics=tf_topics).object_topics == topics


def test_two_tags_with_one_id_in_view_are_rejected():
    twice = foreign.detections3d(5, 'r1/base_link', [('4', '', SEEN, None), ('4', '', SEEN, None)])
    session = session_of(formats=['detection3d'])

    (ids, _, _), = clouds(run(session, ODOMETRY, twice))

    assert ids == []
    assert next(reports(session))[2]['rejected_duplicate_id'] == 2


def test_objects_of_one_class_are_named_also_if_some_are_seen_alone():
    session = session_of(formats=['detection3d'])
    chair = '4', '', SEEN, None

    run(session, ODOMETRY, foreign.detections3d(5, 'r1/base_link', [chair]), *[
        foreign.detections3d(ms, 'r1/base_link', [chair, chair]) for ms in (6, 7)])

    assert next(reports(session))[1].startswith(
        'most detections are rejected, most as duplicate_id: objects of one class')


def test_half_of_the_detections_are_not_most_of_them():
    session = session_of(formats=['landmark_list'])

    run(session, ODOMETRY, foreign.landmark_list(
        5, 'r1/base_link', {'4': (SEEN, 1.0), '5': (SEEN, -1.0)}))

    assert next(reports(session))[1] == ''


def test_tags_beyond_the_range_are_not_named_if_others_are_used():
    session = session_of(max_range=5.0)

    run(session, ODOMETRY, foreign.april_tags(5, 'r1/base_link', {
        'tag36h11:4': SEEN, 'tag36h11:5': (9.0, 0.0, 0.0), 'tag36h11:6': (8.0, 0.0, 0.0)}))

    assert next(reports(session))[1] == ''


@pytest.mark.parametrize(
    ('place', 'weight', 'warning'),
    [(SEEN, -1.0, 'all detections are rejected, most as bad_covariance'),
     ((200.0, 0.0, 0.0), 1.0, ''), (SEEN, 1.0, '')])
def test_detections_that_are_rejected_for_seconds_are_named_while_they_are(place, weight, warning):
    session, reported = session_of(formats=['landmark_list']), []
    session.receive(ODOMETRY)

    for second in range(30):
        seen = (place, weight) if 10 <= second < 20 else (SEEN, 1.0)
        session.receive(foreign.landmark_list(second * 1000, 'r1/base_link', {'4': seen}))
        list(session.take())
        reported.append(next(reports(session))[1].partition(':')[0])

    assert (reported[9], reported[19], reported[29]) == ('', warning, '')


@pytest.mark.parametrize(('name', 'message'), [
    ('aruco', foreign.aruco(5, 'r1/base_link', {})),
    ('detection3d', foreign.detections3d(5, 'r1/base_link', []))])
def test_a_message_without_objects_is_an_empty_scan(name, message):
    (ids, _, _), = clouds(run(session_of(formats=[name]), ODOMETRY, message))

    assert ids == []


def test_boards_are_landmarks_too():
    session = session_of(formats=['aruco'])

    (ids, _, _), = clouds(run(
        session, ODOMETRY, foreign.aruco(5, 'r1/base_link', {3: SEEN}, {'board': SEEN})))

    assert len(ids) == 2
    assert ids[0] == 3


@pytest.mark.parametrize(
    ('messages', 'warning'),
    [
        ([], 'no detections: publish them on r1/tf'),
        ([foreign.april_tags(5, 'r1/base_link', {'tag36h11:4': (200.0, 0.0, 1.0)})],
         'all detections are rejected, most as out_of_range: give metres and m^2, see max_range'),
        ([foreign.april_tags(5, 'r1/base_link', {'tag36h11:4': SEEN})], ''),
    ],
)
def test_warnings_say_what_is_missing(messages, warning):
    session = session_of()

    run(session, ODOMETRY, *messages)

    assert next(reports(session))[1] == warning


def test_an_object_exactly_at_the_largest_range_is_in_range():
    session = session_of(max_range=5.0)

    (found, _, _), = clouds(run(session, ODOMETRY, foreign.april_tags(
        5, 'r1/base_link', {'tag36h11:4': (3.0, 4.0, 0.0), 'tag36h11:5': (3.0, 4.001, 0.0)})))

    assert found == [4]


@pytest.mark.parametrize('order', [1, -1])
def test_robots_are_observed_in_the_order_of_the_team_whatever_that_of_their_tags(order):
    session = session_of(
        robots=('r1', 'r2', 'r3'), **{'r2.tags': ['20'], 'r3.tags': ['30']})
    tags = {'tag36h11:20': SEEN, 'tag36h11:30': (0.0, 0.0, 4.0)}

    found = run(session, ODOMETRY, CAMERA, foreign.april_tags(
        5, 'r1/camera', dict([*tags.items()][::order])))

    (ids, _, _), = clouds(found, 'r1/robots')
    assert ids == [2, 3]
