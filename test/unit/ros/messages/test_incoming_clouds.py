# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Valid clouds become scans and maps; invalid data is rejected with its reason."""

from contextlib import suppress
from math import inf, nan, pi

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages import incoming, incoming_clouds
from helpers.optional import given, settings, strategies as st
from helpers.records import MS
from helpers.ros import cloud, empty_cloud, R1, refusal_of, seen


def refused_observations(message):
    """Return what a scan refuses as (id, reason), and the ids that it uses."""
    scan, rejected = incoming_clouds.scan(message, R1)
    return [(r.id, r.reason) for r in rejected], [s.id for s in scan.observations]


def with_covariances(*points):
    """Return a scan of landmarks 1, 2, ... at given (x, y, var_x, cov_xy, var_y)."""
    names = 'x', 'y', 'var_x', 'cov_xy', 'var_y'
    columns = {name: ('f8', values) for name, values in zip(names, zip(*points))}
    return cloud(columns | {'id': ('i4', range(1, len(points) + 1))})


@pytest.mark.parametrize('code', ['f4', 'f8'])
@pytest.mark.parametrize('order', '<>')
def test_a_scan_is_read_in_either_precision_with_its_covariances(code, order):
    message = cloud({
        'var_y': (code, [0.5, 0.25]), 'id': ('i4', [2, 1]), 'x': (code, [1.0, 2.0]),
        'z': (code, [nan, 9.0]), 'cov_xy': (code, [0.125, -0.125]), 'y': (code, [-1.0, 4.0]),
        'var_x': (code, [1.0, 2.0])}, ms=20, order=order, pad=1, rows=2, row_pad=3)

    scan, rejected = incoming_clouds.scan(message, R1)

    assert (scan.robot, scan.stamp, rejected) == ('r1', 20 * MS, [])
    assert [s.id for s in scan.observations] == [2, 1]
    np.testing.assert_array_equal([s.z for s in scan.observations], [[1, -1], [2, 4]])
    np.testing.assert_array_equal(
        [s.R for s in scan.observations],
        [[[1, 0.125], [0.125, 0.5]], [[2, -0.125], [-0.125, 0.25]]])


@pytest.mark.parametrize(
    'given_covariances',
    [
        {}, {'var_x': ('f8', [4.0])}, {'cov_xy': ('f8', [0.5]), 'var_y': ('f8', [4.0])},
        {name: ('f8', [0.0]) for name in ('var_x', 'cov_xy', 'var_y')},
        {name: ('f4', [-0.0]) for name in ('var_x', 'var_y')}])
def test_an_observation_without_covariance_has_the_one_of_the_parameters(given_covariances):
    robot = RobotSettings('r1', 1, landmark_sigma=(0.3, 0.2))
    message = cloud({'x': ('f8', [1.0]), 'y': ('f8', [0.0]), 'id': ('i4', [1])}
                    | given_covariances)

    (observation,) = incoming_clouds.scan(message, robot)[0].observations

    np.testing.assert_allclose(observation.R, [[0.09, 0.0], [0.0, 0.04]], rtol=1e-15)


def test_observations_of_a_sensor_whose_stamps_are_late_are_earlier():
    robot = RobotSettings('r1', 1, sensor_delay=0.3)
    message = seen((2, 1.0, 0.0), (-7, 1.0, 0.0), ms=400)

    scan, (rejection,) = incoming_clouds.scan(message, robot)
    robots, _ = incoming_clouds.robot_scan(message, robot, {2: 'r2'})

    assert {scan.stamp, rejection.stamp, robots.stamp} == {100 * MS}


def test_an_unknown_covariance_affects_one_point_only():
    scan, _ = incoming_clouds.scan(with_covariances((1, 0, 4, 1, 9), (1, 0, 0, 0, 0)), R1)

    np.testing.assert_array_equal(scan.observations[0].R, [[4, 1], [1, 9]])
    np.testing.assert_allclose(scan.observations[1].R, 0.01 * np.eye(2), rtol=1e-15)


def test_the_sensor_pose_transforms_its_observations():
    robot = RobotSettings('r1', 1, sensor_pose=(1.0, 2.0, pi / 6))

    (observation,) = incoming_clouds.scan(with_covariances((2, 0, 4, 0, 1)), robot)[0].observations

    # Cosine sqrt(3) / 2 and sine 1 / 2, by hand.
    np.testing.assert_allclose(observation.z, [1.0 + 3**0.5, 3.0], rtol=1e-14)
    off = 0.75 * 3**0.5
    np.testing.assert_allclose(observation.R, [[3.25, off], [off, 1.75]], rtol=1e-14)


@pytest.mark.parametrize('message', [empty_cloud(7), seen(ms=7)])
def test_an_empty_scan_is_a_scan(message):
    scan, rejected = incoming_clouds.scan(message, R1)

    assert (scan.stamp, scan.observations, rejected) == (7 * MS, (), [])


@pytest.mark.parametrize(
    'columns',
    [
        {'x': ('f8', [1.0]), 'id': ('i4', [1])},
        {'y': ('f8', [1.0]), 'id': ('i4', [1])},
        {'id': ('i4', [])},
        {'x': ('i4', [1]), 'y': ('f8', [1.0]), 'id': ('i4', [1])},
        {'x': ('f8', [1.0]), 'y': ('f8', [1.0]), 'id': ('f4', [1.0])},
        {'x': ('f8', [1.0]), 'y': ('f8', [1.0]), 'id': ('i4', [1]), 'var_x': ('u1', [1])},
    ])
def test_a_cloud_that_is_no_scan_is_rejected_as_a_whole(columns):
    assert refusal_of(incoming_clouds.scan, cloud(columns), R1) is RejectionReason.BAD_CLOUD


def test_a_contradicting_cloud_is_rejected_as_a_whole():
    message = seen((1, 2.0, 0.0))
    message.row_step += 1

    assert refusal_of(incoming_clouds.scan, message, R1) is RejectionReason.BAD_CLOUD


@pytest.mark.parametrize('position', [
    (nan, 0.0), (0.0, nan), (inf, 0.0), (0.0, -inf)])
def test_a_position_that_is_not_finite_is_rejected_alone(position):
    rejected, used = refused_observations(seen((1, 1.0, 0.0), (2, *position), (3, 2.0, 0.0)))

    assert (rejected, used) == ([(2, RejectionReason.NOT_FINITE)], [1, 3])


@pytest.mark.parametrize(
    ('covariance', 'reason'),
    [
        ((nan, 0, 1), RejectionReason.NOT_FINITE), ((1, inf, 1), RejectionReason.NOT_FINITE),
        ((1, 0, nan), RejectionReason.NOT_FINITE), ((0, nan, 0), RejectionReason.NOT_FINITE),
        ((-1, 0, 1), RejectionReason.BAD_COVARIANCE), ((1, 0, -1), RejectionReason.BAD_COVARIANCE),
        ((-1, 0, -1), RejectionReason.BAD_COVARIANCE), ((1, 2, 1), RejectionReason.BAD_COVARIANCE),
        ((1, -2, 1), RejectionReason.BAD_COVARIANCE), ((1, 0, 0), RejectionReason.BAD_COVARIANCE),
        ((0, 0, 1), RejectionReason.BAD_COVARIANCE), ((1, 1, 1), RejectionReason.BAD_COVARIANCE),
        ((0, 1, 0), RejectionReason.BAD_COVARIANCE), ((1e300, 0, 1), RejectionReason.OUT_OF_RANGE),
        ((1, -1e300, 1), RejectionReason.OUT_OF_RANGE)])
def test_an_observation_with_an_invalid_covariance_is_rejected_alone(covariance, reason):
    rejected, used = refused_observations(with_covariances(
        (1, 0, 4, 1, 9), (1, 0, *covariance), (1, 0, 4, 1, 9)))

    assert (rejected, used) == ([(2, reason)], [1, 3])


def test_an_observation_beyond_the_maximum_distance_is_rejected_alone():
    rejected, used = refused_observations(seen((1, 1e10, 0.0), (2, 2.0, 0.0)))

    assert (rejected, used) == ([(1, RejectionReason.OUT_OF_RANGE)], [2])


def test_an_observation_beyond_the_maximum_distance_from_the_base_is_rejected_alone():
    # The sensor is 1 m closer than the limit of 1000 km.
    robot = RobotSettings('r1', 1, sensor_pose=(1e6 - 1.0, 0.0, 0.0))

    scan, rejected = incoming_clouds.scan(seen((1, 2.0, 0.0), (2, 0.5, 0.0)), robot)

    assert [(r.id, r.reason) for r in rejected] == [(1, RejectionReason.OUT_OF_RANGE)]
    assert [observation.id for observation in scan.observations] == [2]


@pytest.mark.parametrize('ids', [('i4', [1, -2]), ('i4', [1, -2**31]), ('u4', [1, 2**32 - 1])])
def test_an_invalid_landmark_id_is_rejected_alone(ids):
    message = cloud({'x': ('f8', [1.0, 2.0]), 'y': ('f8', [0.0, 0.0]), 'id': ids})

    assert refused_observations(message) == ([(ids[1][1], RejectionReason.BAD_ID)], [1])


def test_a_duplicate_id_rejects_both_and_nothing_else():
    rejected, used = refused_observations(seen((5, 1.0, 0.0), (6, 1.0, 2.0), (5, 3.0, 0.0)))

    assert (rejected, used) == ([(5, RejectionReason.DUPLICATE_ID)] * 2, [6])


def test_several_observations_of_a_scan_may_be_without_id():
    rejected, used = refused_observations(seen((-1, 1.0, 0.0), (6, 1.0, 2.0), (-1, 3.0, 0.0)))

    assert (rejected, used) == ([], [-1, 6, -1])


def test_where_ids_are_needed_observations_without_are_rejected_one_by_one():
    message = seen((-1, 1.0, 0.0), (6, 1.0, 2.0), (-1, 3.0, 0.0))

    scan, rejected = incoming_clouds.scan(message, R1, needs_ids=True)

    assert [s.id for s in scan.observations] == [6]
    assert [(r.id, r.reason) for r in rejected] == [(-1, RejectionReason.NO_IDENTITY)] * 2


def test_a_cloud_without_id_field_has_observations_without_ids():
    message = cloud({'x': ('f4', [1.0, 2.0]), 'y': ('f4', [0.0, 0.0])})

    assert refused_observations(message) == ([], [-1, -1])


def test_a_rejection_has_robot_and_stamp_of_the_observation():
    (rejection,) = incoming_clouds.scan(seen((-7, 1.0, 0.0), ms=30), R1)[1]

    assert (rejection.robot, rejection.stamp, rejection.id) == ('r1', 30 * MS, -7)


ROBOTS = {1: 'r1', 2: 'r2', 30: 'r3'}


def test_observed_robots_have_names_and_positions_like_landmarks():
    robot = RobotSettings('r1', 1, sensor_pose=(1.0, 2.0, pi / 6), landmark_sigma=(0.3, 0.3))

    scan, rejected = incoming_clouds.robot_scan(
        seen((30, 2.0, 0.0), (2, 0.0, 0.0), ms=30), robot, ROBOTS)

    assert (scan.robot, scan.stamp, rejected) == ('r1', 30 * MS, [])
    assert [s.observed for s in scan.observations] == ['r3', 'r2']
    np.testing.assert_allclose(scan.observations[0].z, [1.0 + 3**0.5, 3.0], rtol=1e-14)
    np.testing.assert_allclose(scan.observations[1].z, [1.0, 2.0], rtol=1e-14)
    # A round covariance stays as it is when it is turned.
    np.testing.assert_allclose(scan.observations[0].R, 0.09 * np.eye(2), atol=1e-15)


@pytest.mark.parametrize(
    ('points', 'reason'),
    [
        ([(1, 2.0, 3.0)], RejectionReason.SELF_OBSERVATION),
        ([(1, 2.0, 3.0), (1, nan, 3.0)], RejectionReason.SELF_OBSERVATION),
        ([(3, 2.0, 3.0)], RejectionReason.UNKNOWN_ROBOT),
        ([(-1, 2.0, 3.0)], RejectionReason.UNKNOWN_ROBOT),
        ([(-2, 2.0, 3.0)], RejectionReason.BAD_ID), ([(2, nan, 3.0)], RejectionReason.NOT_FINITE),
        ([(2, 1e10, 3.0)], RejectionReason.OUT_OF_RANGE),
        ([(2, 1.0, 3.0), (2, 2.0, 3.0)], RejectionReason.DUPLICATE_ID)])
def test_an_observation_of_an_unknown_robot_is_rejected_alone(points, reason):
    scan, rejected = incoming_clouds.robot_scan(seen((30, 4.0, 5.0), *points), R1, ROBOTS)

    assert [s.observed for s in scan.observations] == ['r3']
    assert [(r.robot, r.id, r.reason) for r in rejected] == [
        ('r1', number, reason) for number, _, _ in points]


def test_a_contradicting_cloud_of_robots_is_rejected_as_a_whole():
    without_points = cloud({'id': ('i4', [2])})

    reason = refusal_of(incoming_clouds.robot_scan, without_points, R1, ROBOTS)

    assert reason is RejectionReason.BAD_CLOUD


def test_the_true_map_has_positions_by_id():
    landmarks = incoming_clouds.true_landmarks(seen((3, 1.0, 2.0), (1, -1.0, 0.5)))

    assert {n: xy.tolist() for n, xy in landmarks.positions.items()} == {3: [1, 2], 1: [-1, 0.5]}


@pytest.mark.parametrize(('landmarks', 'reason'), [
    ([(3, 1.0, nan)], RejectionReason.NOT_FINITE),
    ([(3, 1.0, 1e300)], RejectionReason.OUT_OF_RANGE),
    ([(-1, 1.0, 1.0)], RejectionReason.BAD_ID),
    ([(3, 1.0, 1.0), (3, 1.0, 2.0)], RejectionReason.DUPLICATE_ID)])
def test_an_invalid_true_map_is_rejected(landmarks, reason):
    assert refusal_of(incoming_clouds.true_landmarks, seen(*landmarks)) is reason


SIZES = st.sampled_from([0, 1, 2, 4, 8, 16, 40, 2**31, 2**32 - 1])
FIELDS = st.builds(
    ros.sensor_msgs__msg__PointField,
    name=st.sampled_from(['x', 'y', 'z', 'id', 'var_x', 'cov_xy', 'var_y', '']),
    offset=SIZES | st.integers(0, 40), datatype=st.integers(0, 10), count=SIZES)


NUMBERS = st.floats() | st.floats(-1.0, 1.0)


def packed_numbers(size):
    length = size // 8 + 1
    numbers = st.lists(NUMBERS, min_size=length, max_size=length)
    return numbers.map(lambda values: np.array(values).tobytes()[:size])


@st.composite
def clouds(draw):
    """Return any cloud: fields and bytes at random, the sizes at random or so that they fit."""
    message = empty_cloud()
    message.fields = draw(st.lists(FIELDS, max_size=8))
    message.is_bigendian = draw(st.booleans())
    if draw(st.booleans()):
        message.height, message.width = draw(st.tuples(st.integers(0, 2), st.integers(0, 3)))
        message.point_step = draw(st.integers(0, 56))
        message.row_step = message.width * message.point_step + draw(st.integers(0, 3))
        size = message.height * message.row_step
    else:
        message.height, message.width = draw(SIZES), draw(SIZES)
        message.point_step, message.row_step = draw(SIZES), draw(SIZES)
        size = draw(st.integers(0, 40))
    data = draw(st.binary(min_size=size, max_size=size) | packed_numbers(size))
    message.data = np.frombuffer(data, np.uint8)
    return message


@given(clouds())
@settings(max_examples=100, deadline=None, derandomize=True)
@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # numbers that are none
def test_any_cloud_is_a_scan_of_valid_observations_or_rejected(message):
    with suppress(incoming.RejectedError):
        scan, rejected = incoming_clouds.scan(message, R1)

        assert len(scan.observations) + len(rejected) == message.height * message.width
        for observation in scan.observations:
            assert np.isfinite(observation.z).all()
            np.linalg.cholesky(observation.R)
    with suppress(incoming.RejectedError):
        incoming_clouds.true_landmarks(message)
