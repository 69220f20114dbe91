# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publications of the estimator: which, when and in which frame."""

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.ros.session.estimator_outputs import ThinnedPath
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.outputs import MAX_PATH
from helpers.records import MS, odometry, scan
from helpers.ros import drive, LANDMARKS, meeting, R2_START, raw_record, run_settings, through_cdr

PER_STEP = {'r1/pose', 'r2/pose', '~/joint_covariance', '/tf'}


def driven(records, **options):
    """Return a run that was given records, and what it published, by topic."""
    run = EstimatorSession(run_settings(**options), None)
    published = {}
    for topic, message in drive(run, map(raw_record, records)):
        published.setdefault(topic, []).append(through_cdr(message))
    return run, published


def overview(run):
    """Return the overview of a run, one message a topic."""
    published = list(run.outputs.maps_and_paths())
    assert max(Counter(topic for topic, _ in published).values()) == 1
    return {topic: through_cdr(message) for topic, message in published}


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def as_matrix(translation, quaternion):
    turn = Rotation.from_quat([quaternion.x, quaternion.y, quaternion.z, quaternion.w])
    matrix = np.eye(4)
    matrix[:3, :3] = turn.as_matrix()
    matrix[:3, 3] = translation.x, translation.y, translation.z
    return matrix


def ids_of(cloud):
    return np.frombuffer(cloud.data.tobytes(), '<i4').reshape(cloud.width, -1)[:, 3].tolist()


def test_every_step_of_a_robot_is_one_pose_with_its_stamp_and_frame():
    _, published = driven(meeting())

    assert set(published) == PER_STEP
    assert [(stamp_of(m) // MS, m.header.frame_id) for m in published['r2/pose']] == [
        (0, 'r2/map'), (100, 'map'), (200, 'map'), (300, 'map'), (400, 'map')]
    last = published['r2/pose'][-1].pose.pose.position
    # The meeting is exact but for rounding.
    np.testing.assert_allclose([last.x, last.y], [R2_START[0] + 0.4, R2_START[1]], atol=1e-12)


def test_a_relative_pose_is_published_as_soon_as_both_robots_are_in_map():
    run, published = driven(meeting(), relative_poses=('r1:r2',))

    seen = published['r1/relative_pose/r2']

    assert 'r1/relative_pose/r2' in run.outputs.topics
    assert [(stamp_of(m) // MS, m.header.frame_id) for m in seen] == [
        (ms, 'r1/base_link') for ms in (100, 200, 300, 400)]
    at = seen[-1].pose.pose.position
    # The meeting is exact but for rounding.
    np.testing.assert_allclose([at.x, at.y], R2_START, atol=1e-12)


def test_the_joint_covariance_grows_with_the_team():
    _, published = driven(meeting())

    labels = [m.layout.dim[0].label for m in published['~/joint_covariance']]
    assert labels[:2] == ['r1@0', 'r1@100000000,r2@100000000']
    assert [len(m.data) for m in published['~/joint_covariance']] == [9, 36, 36, 36, 36]


def test_the_blocks_of_the_joint_covariance_are_those_of_the_poses():
    _, published = driven(meeting())

    joint = published['~/joint_covariance'][-1].data.reshape(6, 6)
    for k, robot in enumerate(('r1', 'r2')):
        P = published[f'{robot}/pose'][-1].pose.covariance.reshape(6, 6)
        own = slice(3 * k, 3 * k + 3)
        np.testing.assert_array_equal(P[np.ix_([0, 1, 5], [0, 1, 5])], joint[own, own])


@pytest.mark.parametrize('unused', [0.0, 1e6])
def test_the_unused_variance_is_taken_from_the_parameters(unused):
    _, published = driven(meeting(), unused_variance=unused)

    assert {m.pose.covariance[14] for m in published['r1/pose']} == {unused}


def test_transforms_connect_odometry_to_the_poses():
    # A quarter turn to the left in each 200 ms, with a scan at its half.
    turns = [(0.0, 0.0, 0.0), (2.0, 0.0, np.pi / 2), (2.0, 2.0, np.pi)]
    by_odometry = {0: turns[0], 100: (1.0, 0.0, np.pi / 4), 200: turns[1], 400: turns[2]}
    records = [
        *(odometry('r1', 200 * k, pose) for k, pose in enumerate(turns)),
        *(scan('r1', ms, [(1, (5.0, 1.0 + ms / 1000.0))]) for ms in by_odometry)]

    _, published = driven(records, anchor_pose=(7.0, -3.0, 2.0), gate_probability=1.0)

    assert len(published['/tf']) == len(by_odometry)
    for (transform,), pose in zip((m.transforms for m in published['/tf']), published['r1/pose']):
        found = as_matrix(transform.transform.translation, transform.transform.rotation)
        x, y, phi = by_odometry[stamp_of(transform) // MS]
        moved = np.array([
            [np.cos(phi), -np.sin(phi), 0.0, x], [np.sin(phi), np.cos(phi), 0.0, y],
            [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        expected = as_matrix(pose.pose.pose.position, pose.pose.pose.orientation)
        np.testing.assert_allclose(found @ moved, expected, atol=1e-12)
        assert stamp_of(transform) == stamp_of(pose)


def test_a_transform_starts_at_the_frame_of_the_robots_pose():
    _, published = driven(meeting(3))

    assert [
        [(t.header.frame_id, t.child_frame_id) for t in message.transforms]
        for message in published['/tf']
    ] == [
        [('map', 'r1/odom'), (frame, 'r2/odom')] for frame in ('r2/map', 'map', 'map')]


def test_without_publish_tf_there_are_no_transforms():
    run, published = driven(meeting(), publish_tf=False)

    assert '/tf' not in run.outputs.topics
    assert '/tf' not in published


def test_maps_and_paths_are_published_with_markers():
    run, _ = driven(meeting())

    shown = overview(run)

    assert set(shown) == {'r1/path', 'r2/path', '~/landmarks', '~/markers'}
    assert ids_of(shown['~/landmarks']) == sorted(LANDMARKS)
    assert (stamp_of(shown['~/landmarks']), shown['~/landmarks'].header.frame_id) == (
        400 * MS, 'map')


def test_a_path_is_in_the_present_frame():
    run, _ = driven(meeting())

    shown = overview(run)

    assert [stamp_of(p) // MS for p in shown['r1/path'].poses] == [0, 100, 200, 300, 400]
    assert [stamp_of(p) // MS for p in shown['r2/path'].poses] == [100, 200, 300, 400]
    assert shown['r2/path'].header.frame_id == 'map'


def test_a_robot_that_has_not_joined_publishes_its_own_map():
    alone = [
        odometry('r1', 0), odometry('r2', 0), scan('r2', 100, [(7, (1.0, 0.0))]),
        odometry('r1', 200), odometry('r2', 200)]

    run, _ = driven(alone)

    own = overview(run)['r2/map_landmarks']
    assert (own.header.frame_id, ids_of(own)) == ('r2/map', [7])


def test_the_own_map_of_a_robot_that_has_joined_is_emptied_once_for_late_subscribers():
    run = EstimatorSession(run_settings(), None)

    def send(*records):
        for record in records:
            run.receive(raw_record(record))
        list(run.release())

    send(odometry('r1', 0), odometry('r2', 0), scan('r2', 100, [(7, (1.0, 0.0))]),
         odometry('r1', 200), odometry('r2', 200), odometry('r1', 300), odometry('r2', 300))
    assert ids_of(overview(run)['r2/map_landmarks']) == [7]

    send(PosePrior('r2', 350 * MS, np.zeros(3), 1e-4 * np.eye(3)), odometry('r1', 400),
         odometry('r2', 400), odometry('r1', 500), odometry('r2', 500))
    own = overview(run)['r2/map_landmarks']

    assert (own.header.frame_id, own.width, stamp_of(own)) == ('r2/map', 0, 500 * MS)
    assert 'r2/map_landmarks' not in overview(run)


def test_only_large_messages_without_subscribers_are_left_out():
    run, _ = driven(meeting())
    run.outputs.is_wanted = lambda topic: topic == 'r2/path'

    assert set(overview(run)) == {'r2/path', '~/landmarks'}


def test_maps_have_the_stamp_of_the_newest_pose():
    run, _ = driven([*meeting(), odometry('r1', 500), odometry('r2', 700), odometry('r1', 600)])

    assert stamp_of(overview(run)['~/landmarks']) == 700 * MS


def test_before_the_first_step_no_map_is_published():
    outputs = EstimatorSession(run_settings(), None).outputs

    assert list(outputs.maps_and_paths()) == []


def test_every_publication_is_listed_in_topics_with_its_type():
    run = EstimatorSession(run_settings(), None)
    published = drive(run, map(raw_record, [*meeting(), scan('r1', 400, [(1, (-9.0, 3.0))])]))

    for topic, message in [*published, *run.outputs.maps_and_paths()]:
        assert run.outputs.topics[topic] == message.__msgtype__


def test_landmarks_are_published_in_the_order_of_their_ids():
    backwards = [
        odometry('r1', 0), scan('r1', 0, [(9, (1.0, 0.0))]),
        scan('r1', 100, [(8, (1.0, 1.0)), (2, (2.0, 0.0))]), odometry('r1', 300)]

    run, _ = driven([*backwards, odometry('r2', 0), odometry('r2', 300)])

    assert ids_of(overview(run)['~/landmarks']) == [2, 8, 9]


@pytest.mark.parametrize('length', [1, MAX_PATH, MAX_PATH + 1, 2 * MAX_PATH + 1, 5000, 20_001])
def test_a_path_is_thinned_evenly_to_a_thousand_poses(length):
    path = ThinnedPath('map')

    for k in range(length):
        path.add(k, np.zeros(3))

    stamps = [stamp for stamp, _ in path.poses]
    assert min(length, MAX_PATH // 2) <= len(stamps) <= MAX_PATH == 1000
    assert stamps[0] == 0
    strides = set(np.diff(stamps))
    assert len(strides) <= 1
    assert length - stamps[-1] <= max(strides, default=1)


def test_landmarks_without_ids_are_published_once_confirmed():
    unnamed = [(-1, (4.0, 3.0)), (-1, (6.0, -5.0)), (-1, (3.0, 1.0))]
    seen = [unnamed[:2]] * 4 + [unnamed]
    records = [
        record for k, observations in enumerate(seen)
        for record in (
            odometry('r1', 100 * k, (0.0, 0.0, 0.0)), scan('r1', 100 * k, observations))]
    run, _ = driven(records)

    published = overview(run)

    assert ids_of(published['~/landmarks']) == [-3, -2]
    ellipses = [m for m in published['~/markers'].markers if m.ns == 'landmark_ellipses']
    assert len(ellipses) == 2
    assert len(run.estimator.groups.team.state.landmarks) == 3


def test_a_robot_has_the_same_colour_whether_those_before_it_have_sent_odometry_or_not():
    def colours(*records):
        run, _ = driven(records, known=[('r2', (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))])
        return [
            (m.color.r, m.color.g, m.color.b) for m in overview(run)['~/markers'].markers
            if m.ns.startswith('paths') and m.id == 1]

    of_r2 = odometry('r2', 0), odometry('r2', 100)

    assert colours(*of_r2) == colours(odometry('r1', 0), odometry('r1', 100), *of_r2)
    assert len(colours(*of_r2)) == 1


def test_the_map_that_a_robot_outside_map_leaves_behind_has_no_topic():
    run, _ = driven([
        odometry('r1', 0), odometry('r2', 0), scan('r2', 100, [(7, (1.0, 0.0))]),
        odometry('r1', 200), odometry('r2', 200)])

    run.change_team(['r1'])

    assert [estimate.frame for estimate in run.estimator.maps()] == ['map', 'r2/map']
    assert set(overview(run)) == {'r1/path', '~/landmarks', '~/markers'}


def test_a_team_without_poses_clears_no_map():
    run, _ = driven(meeting())
    overview(run)

    run.change_team(['r3'])

    assert list(run.outputs.cleared_maps()) == []
