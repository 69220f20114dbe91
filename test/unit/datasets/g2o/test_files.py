# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of graph files: what each kind of them means, and that written ones are read back."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.datasets.g2o import files
from fej_slam_ros.datasets.g2o.graph import Edge, Graph, PoseName
from fej_slam_ros.errors import UserError

#: Covariance at the end of a relative pose, and its information matrix, with entries of any sign.
R = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
I = np.linalg.inv(R)  # noqa: E741
QUARTER = np.pi / 2


def read(folder, *lines, noise='covariance'):
    path = folder / 'graph.g2o'
    path.write_text('\n'.join(lines), encoding='utf-8')
    return files.read(path, noise)


def numbers(*values):
    return ' '.join(map(repr, map(float, values)))


@pytest.mark.parametrize(('line', 'noise'), [
    (f'EDGE_SE2 3 7 2 1 0 {numbers(*I[np.triu_indices(3)])}', 'covariance'),
    (f'EDGE2 3 7 2 1 0 {numbers(I[0, 0], I[0, 1], I[1, 1], I[2, 2], I[0, 2], I[1, 2])}',
     'covariance'),
    (f'ODOMETRY 3 7 2 1 0 {numbers(*R[np.triu_indices(3)])}', 'covariance'),
    (f'ODOMETRY 3 7 2 1 0 {numbers(*I[np.triu_indices(3)])}', 'information'),
    (f'ODOMETRY 3 7 2 1 0 {numbers(*np.linalg.cholesky(I).T[np.triu_indices(3)])}',
     'square_root')])
def test_every_kind_of_relative_pose_has_the_same_covariance(tmp_path, line, noise):
    graph, unused = read(tmp_path, line, noise=noise)

    edge, = graph.increments
    assert (edge.begin, edge.end, edge.z.tolist(), +unused) == (3, 7, [2.0, 1.0, 0.0], {})
    # Two inverses of a matrix with a condition number of 10.
    assert_allclose(edge.R, R, rtol=1e-12)


@pytest.mark.parametrize(('line', 'noise'), [
    ('EDGE_SE2_XY 3 7 2 0 25 0 4', 'covariance'),
    ('LANDMARK 3 7 2 0 0.04 0 0.25', 'covariance'), ('LANDMARK 3 7 2 0 25 0 4', 'information'),
    ('LANDMARK 3 7 2 0 5 0 2', 'square_root')])
def test_every_kind_of_observation_is_cartesian_with_the_same_covariance(tmp_path, line, noise):
    graph, _ = read(tmp_path, line, noise=noise)

    edge, = graph.observations
    assert (edge.begin, edge.end) == (3, 7)
    assert_allclose(edge.z, [2.0, 0.0], atol=1e-12)
    assert_allclose(edge.R, np.diag([0.04, 0.25]), atol=1e-12)


def test_a_bearing_and_a_range_are_a_polar_observation(tmp_path):
    graph, _ = read(tmp_path, 'BR 3 7 0.7 2 0.25 0.2')

    edge, = graph.observations
    z, R = polar(r=2.0, beta=0.7, sigma_r=0.2, sigma_beta=0.25)
    assert (edge.begin, edge.end) == (3, 7)
    assert_allclose(edge.z, z, rtol=1e-15)
    assert_allclose(edge.R, R, rtol=1e-15)


def test_the_noise_of_a_relative_pose_is_in_the_frame_at_its_end(tmp_path):
    information = numbers(1 / 0.04, 0, 0, 1 / 0.25, 0, 1)

    graph, _ = read(tmp_path, f'EDGE_SE2 0 1 1 0 {QUARTER!r} {information}')

    # Ahead at the end is to the left at the begin.
    assert_allclose(graph.increments[0].R, np.diag([0.25, 0.04, 1.0]), atol=1e-12)


def test_isam_states_the_noise_of_a_relative_pose_in_the_frame_at_its_begin(tmp_path):
    # Standard deviations of 0.2 m ahead and 0.5 m to the left, as square roots of information.
    line = f'ODOMETRY 0 1 1 0 {QUARTER!r} {numbers(5, 0, 0, 2, 0, 1)}'

    graph, _ = read(tmp_path, line, noise='square_root')

    assert_allclose(graph.increments[0].R, np.diag([0.04, 0.25, 1.0]), atol=1e-12)


def test_a_written_graph_is_read_back(tmp_path):
    graph = Graph(
        {0: np.array([1 / 3, 0.0, -3.0]), 1: np.array([1.0, 1e-300, 1.0])},
        {2: np.array([0.1, 0.2])},
        [Edge(0, 1, np.array([0.1, 0.2, 2.5]), R)],
        [Edge(1, 2, np.array([5.0, -1.0]), R[:2, :2])],
        [Edge(1, 0, np.array([0.3, 0.4]), R[:2, :2])],
        [0], {0: PoseName('r1', 5), 1: PoseName('r2', 5)}, {2: (('', 4), ('r2', 9))})

    got, unused = read(tmp_path, *files.written(graph))

    assert +unused == {}
    assert (got.fixed, got.names, got.keys) == (graph.fixed, graph.names, graph.keys)
    for name in 'poses', 'points':
        expected = getattr(graph, name)
        assert getattr(got, name).keys() == expected.keys()
        for vertex, estimate in getattr(got, name).items():
            assert_array_equal(estimate, expected[vertex])
    for name in 'increments', 'observations', 'robot_observations':
        (edge,), (expected,) = getattr(got, name), getattr(graph, name)
        assert (edge.begin, edge.end) == (expected.begin, expected.end)
        assert_array_equal(edge.z, expected.z)
        # Two inverses of a matrix with a condition number of 10.
        assert_allclose(edge.R, expected.R, rtol=1e-12)


def test_comments_and_empty_lines_are_skipped_and_other_lines_counted(tmp_path):
    graph, unused = read(
        tmp_path, '# a comment', '', '  ', 'VERTEX2 0 1 2 3  # its estimate', 'EDGE_SE3:QUAT 1 2',
        'EDGE_SE3:QUAT 1 2', 'VERTEX_XY 5 1 2', 'FIX 0 1')

    assert unused == {'EDGE_SE3:QUAT': 2}
    assert graph.poses[0].tolist() == [1.0, 2.0, 3.0]
    assert (graph.points[5].tolist(), graph.fixed) == ([1.0, 2.0], [0, 1])


@pytest.mark.parametrize('line', [
    'EDGE_SE2 0 1 1 0 0 1 0 0 1 0', 'EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1', 'VERTEX_SE2 0 x 0 0',
    'EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1', 'EDGE_SE2 0 1 1 0 0 0 0 0 0 0 1', 'EDGE_SE2_XY 0',
    'EDGE_SE2 0 1 1 0 0 1 0 0 1 0 -1', 'BR 0 1 0 2 -0.1 0.2', 'LANDMARK 0 1 1 1 0 0 0',
    'VERTEX_SE2', 'VERTEX_SE2 0 0 0 1', 'FIX x', '# fej_slam POSE x', '# fej_slam POSE 1 r1 -5',
    '# fej_slam LANDMARK 7 * 4294967301', '# fej_slam LANDMARK 7 * -1'])
def test_a_damaged_line_is_named_with_its_number(tmp_path, line):
    with pytest.raises(UserError, match=r'graph\.g2o: line 2 is damaged .*; correct or remove it'):
        read(tmp_path, 'VERTEX_SE2 0 0 0 0', line)


def test_information_that_has_no_inverse_is_called_singular(tmp_path):
    with pytest.raises(UserError, match=r'line 1 .* \(its information matrix is singular\)'):
        read(tmp_path, 'EDGE_SE2 0 1 1 0 0 0 0 0 0 0 1')


def test_a_file_of_another_encoding_is_one_sentence(tmp_path):
    path = tmp_path / 'graph.g2o'
    path.write_text('EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1', encoding='utf-16')

    with pytest.raises(UserError, match=r'graph\.g2o is no text in UTF-8: give the path'):
        files.read(path, 'covariance')


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match=r'cannot read .*graph\.g2o: No such file or directory'):
        files.read(tmp_path / 'graph.g2o', 'covariance')
