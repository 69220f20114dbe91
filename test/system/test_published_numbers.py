# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages keep the precision of the estimates, also far from the origin."""

import csv

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from fej_slam_ros.core.records import TrueLandmarks
from fej_slam_ros.ros.session import simulation
from helpers.ros import raw_record, run_verb, TYPES, write_bag, write_parameters

#: Start of the anchor in UTM coordinates [m, m, rad].
UTM = (451_234.567, 5_411_876.123, 0.3)
#: Noise of observations [m]: small beside half a unit of float32 at that northing, 0.25 m.
SIGMA = 0.01
#: Numpy types by PointField's type codes, as its definition lists them.
FORMATS = {5: '<i4', 7: '<f4', 8: '<f8'}


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """Return the folder of a replay at UTM coordinates, with its bag and its true landmarks."""
    folder = tmp_path_factory.mktemp('utm')
    records = [*simulation.parse({
        'start': list(UTM), 'loops': 1, 'steps_per_loop': 40, 'landmarks': 60, 'seed': 5,
        'odometry_sigma': [0.01, 0.01, 0.002], 'landmark_sigma': [SIGMA, SIGMA]}).records()]
    bag = write_bag(folder / 'bag', [raw_record(record) for record in records])
    params = write_parameters(
        folder / 'p.yaml', robots=['r1', 'r2'], anchor_pose=list(UTM), relative_poses=['r1:r2'])
    assert run_verb(
        'replay', bag, '--params', params, '--output', folder / 'results', '--bag') == 0
    (truth,) = (record.positions for record in records if isinstance(record, TrueLandmarks))
    return folder / 'results', truth


def messages(folder):
    """Return the messages in the output bag by topic."""
    found = {}
    with Reader(folder / 'bag') as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(
                TYPES.deserialize_cdr(raw, connection.msgtype))
    return found


def points_of(cloud):
    """Return the points of a cloud by field, as its fields state them."""
    layout = np.dtype({
        'names': [field.name for field in cloud.fields],
        'formats': [FORMATS[field.datatype] for field in cloud.fields],
        'offsets': [field.offset for field in cloud.fields], 'itemsize': cloud.point_step})
    return np.frombuffer(cloud.data.tobytes(), layout)


def table(path):
    with path.open(encoding='utf-8') as file:
        return [*csv.DictReader(file)]


def test_the_published_map_is_that_of_the_file(run):
    folder, _ = run
    rows = {int(row['id']): row for row in table(folder / 'landmarks.csv')}

    points = points_of(messages(folder)['/estimator/landmarks'][-1])

    assert len(points) == len(rows) > 40
    for point in points:
        row = rows[point['id']]
        for field, column in {
            'x_f64': 'x', 'y_f64': 'y', 'var_x': 'var_x', 'cov_xy': 'cov_xy', 'var_y': 'var_y',
        }.items():
            assert point[field] == float(row[column])
        assert point['x'] == np.float32(row['x'])


def test_the_published_map_has_the_published_covariance(run):
    folder, truth = run
    squared = []

    for point in points_of(messages(folder)['/estimator/landmarks'][-1]):
        P = np.array([[point['var_x'], point['cov_xy']], [point['cov_xy'], point['var_y']]])
        error = np.array([point['x_f64'], point['y_f64']]) - truth[point['id']]
        squared.append(error @ np.linalg.solve(P, error) / 2.0)

    # 0.8 for this run; errors of a map are correlated. With x and y in float32 it is 249.
    assert 0.3 < np.mean(squared) < 2.0


@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_published_poses_are_those_of_the_file(run, robot):
    folder, _ = run
    rows = table(folder / f'trajectory_{robot}.csv')
    poses = messages(folder)[f'/{robot}/pose']

    assert len(poses) == len(rows) > 30
    for message, row in zip(poses, rows):
        stamp, pose = message.header.stamp, message.pose.pose
        assert stamp.sec * 10**9 + stamp.nanosec == int(row['stamp_ns'])
        assert (pose.position.x, pose.position.y) == (float(row['x']), float(row['y']))
        q = pose.orientation
        assert 2.0 * np.arctan2(q.z, q.w) == pytest.approx(float(row['yaw']), abs=1e-15)
        block = message.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
        assert block[np.triu_indices(3)].tolist() == [
            float(row[f'cov_{name}']) for name in ('xx', 'xy', 'xyaw', 'yy', 'yyaw', 'yawyaw')]


def test_published_covariances_are_symmetric_and_positive(run):
    found = messages(run[0])
    covariances = [
        m.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
        for topic in ('/r1/pose', '/r2/pose', '/r1/relative_pose/r2') for m in found[topic]]
    covariances += [
        m.data.reshape(m.layout.dim[0].size, -1) for m in found['/estimator/joint_covariance']]

    for P in covariances:
        assert (P == P.T).all()
        # The anchor starts exactly at its pose.
        assert np.linalg.eigvalsh(P)[0] >= -1e-15 * np.abs(P).max()
    assert len(covariances) > 100


def test_published_quaternions_are_of_unit_length(run):
    found = messages(run[0])
    poses = [*found['/r1/pose'], *found['/r2/pose']]
    rotations = [message.pose.pose.orientation for message in poses]
    rotations += [pose.pose.orientation for m in found['/r1/path'] for pose in m.poses]
    rotations += [t.transform.rotation for m in found['/tf'] for t in m.transforms]

    assert {
        bool(abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) < 1e-15) for q in rotations} == {True}
