# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lines of graph files: those of g2o, which are also written, and those of TORO, iSAM and GTSAM.

The error of a relative pose u in g2o is u^-1 o (x_begin^-1 o x_end), in the frame at its end; that
of an `Edge` is in the frame at its begin. So the information matrix is turned by the heading of u.
Robots, stamps and landmark IDs, for which these formats have no place, are comments that begin
with `NAMES`.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import (
    Array, pose_rotation, rotation, symmetric, upper_triangular)
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.datasets.file_checks import checked_landmark_id, checked_stamp
from fej_slam_ros.datasets.g2o.graph import Edge, Graph, PoseName
from fej_slam_ros.errors import UserError

#: First words of the comments with names.
NAMES = '# fej_slam'
#: Information of the heading of a pose of which only the position is known [rad^-2]; GTSAM accepts
#: no zero.
UNKNOWN_HEADING = 1e-12
#: Robot of a landmark whose ID is that of all robots.
ANY = '*'
#: Positions of (xx, xy, xyaw, yy, yyaw, yawyaw) among the six numbers of a relative pose of TORO.
TORO = [0, 1, 4, 2, 5, 3]


def read(path: Path, noise: str) -> tuple[Graph, Counter[str]]:
    """
    Return the graph in a file, and the numbers of lines that are not used by their first words.

    Parameters
    ----------
    noise : one of `NOISES`, for the lines of iSAM

    Raises
    ------
    UserError
        The file cannot be read or a line is damaged.

    """
    try:
        text = path.read_text(encoding='utf-8-sig', errors='replace')
    except OSError as error:
        raise UserError(
            f'cannot read {path}: {error.strerror}; give the path of a graph file') from None
    if '\0' in text:
        raise UserError(f'{path} is no text in UTF-8: give the path of a graph file')
    lines, reader = text.splitlines(), _Reader(NOISES[noise])
    try:
        for line in lines:
            reader.read(line)
    except (ValueError, IndexError, UserError) as error:
        raise UserError(
            f'{path}: line {reader.lines} is damaged ({error}): {line[:80].strip()!r}; correct or'
            ' remove it') from None
    return reader.graph, reader.unused


def written(graph: Graph) -> Iterator[str]:
    """Yield the lines of a graph; the numbers read back are the same bits."""
    for vertex, pose in graph.poses.items():
        yield _line('VERTEX_SE2', [vertex], pose)
    for vertex, point in graph.points.items():
        yield _line('VERTEX_XY', [vertex], point)
    for edge in (*graph.increments, *(_as_increment(graph, e) for e in graph.robot_observations)):
        back = pose_rotation(edge.z[2])
        yield _edge('EDGE_SE2', edge, _inverse(back.T @ edge.R @ back))
    for edge in graph.observations:
        yield _edge('EDGE_SE2_XY', edge, _inverse(edge.R))
    # GTSAM reads no edges behind a line that does not begin with a word and two numbers.
    for vertex in graph.fixed:
        yield f'FIX {vertex}'
    for vertex, name in graph.names.items():
        yield f'{NAMES} POSE {vertex} {name.robot} {name.stamp}'
    for vertex, keys in graph.keys.items():
        yield f'{NAMES} LANDMARK {vertex} ' + ' '.join(f'{robot or ANY} {k}' for robot, k in keys)


class _Reader:
    """Collects the lines of a file, and their number."""

    def __init__(self, noise: 'IsamNoise') -> None:
        self.lines = 0
        self.graph = Graph()
        self.unused: Counter[str] = Counter()
        self._noise = noise
        self._readers: dict[str, Callable[[list[str]], None]] = {
            'VERTEX_SE2': self._pose, 'VERTEX2': self._pose, 'VERTEX_XY': self._point,
            'FIX': self._fix,
            'EDGE_SE2': self._relative_pose, 'EDGE2': self._toro_edge,
            'ODOMETRY': self._isam_odometry,
            'EDGE_SE2_XY': partial(self._observation, _of_information),
            'LANDMARK': partial(self._observation, noise.covariance),
            'BR': self._bearing_range}

    def read(self, line: str) -> None:
        self.lines += 1
        if line.startswith(NAMES):
            self._names(line[len(NAMES):].split())
            return
        words = line.partition('#')[0].split()
        if not words:
            return
        if words[0] in self._readers:
            self._readers[words[0]](words[1:])
        else:
            self.unused[words[0]] += 1

    def _names(self, words: list[str]) -> None:
        kind, vertex, *names = words
        if kind == 'POSE':
            self.graph.names[int(vertex)] = PoseName(names[0], checked_stamp(int(names[1])))
        else:
            self.graph.keys[int(vertex)] = tuple(
                ('' if robot == ANY else robot, checked_landmark_id(int(k)))
                for robot, k in zip(names[::2], names[1::2]))

    def _pose(self, words: list[str]) -> None:
        self._add_vertex(self.graph.poses, words, 3)

    def _point(self, words: list[str]) -> None:
        self._add_vertex(self.graph.points, words, 2)

    def _add_vertex(self, vertices: dict[int, Array], words: list[str], count: int) -> None:
        values = _numbers(words[1:], count)
        if not np.array_equal(vertices.setdefault(int(words[0]), values), values):
            raise ValueError(f'vertex {words[0]} has other values in a line before')

    def _fix(self, words: list[str]) -> None:
        self.graph.fixed.extend(map(int, words))

    def _relative_pose(self, words: list[str]) -> None:
        numbers = _numbers(words[2:], 9)
        z, information = numbers[:3], symmetric(numbers[3:])
        if not information[2, :2].any() and 0.0 <= information[2, 2] < 2.0 * UNKNOWN_HEADING:
            turn = rotation(z[2])
            R = turn @ _inverse(information[:2, :2]) @ turn.T
            self._add(self.graph.robot_observations, words, z[:2], R)
        else:
            self._add_increment(words, z, _inverse(information))

    def _toro_edge(self, words: list[str]) -> None:
        numbers = _numbers(words[2:], 9)
        information = symmetric(numbers[3:][TORO])
        self._add_increment(words, numbers[:3], _inverse(information))

    def _isam_odometry(self, words: list[str]) -> None:
        numbers = _numbers(words[2:], 9)
        u, R = numbers[:3], self._noise.covariance(numbers[3:])
        if self._noise.is_at_begin:
            self._add(self.graph.increments, words, u, R)
        else:
            self._add_increment(words, u, R)

    def _observation(self, covariance: Callable[[Array], Array], words: list[str]) -> None:
        numbers = _numbers(words[2:], 5)
        self._add(self.graph.observations, words, numbers[:2], covariance(numbers[2:]))

    def _bearing_range(self, words: list[str]) -> None:
        beta, r, sigma_beta, sigma_r = _numbers(words[2:], 4).tolist()
        self._add(self.graph.observations, words, *polar(r, beta, sigma_r, sigma_beta))

    def _add_increment(self, words: list[str], u: Array, at_end: Array) -> None:
        """Add a relative pose, whose covariance is in the frame at its end."""
        back = pose_rotation(u[2])
        self._add(self.graph.increments, words, u, back @ at_end @ back.T)

    def _add(self, edges: list[Edge], words: list[str], z: Array, R: Array) -> None:
        edges.append(Edge(int(words[0]), int(words[1]), z, _checked(R)))


def _numbers(words: list[str], count: int) -> Array:
    values = [float(word) for word in words]
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f'needs {count} finite numbers behind its vertices')
    return np.array(values)


def _of_information(upper: Array) -> Array:
    """Return the covariance of an information matrix, given by its upper triangle."""
    return _inverse(symmetric(upper))


def _inverse(matrix: Array) -> Array:
    """Return an inverse; raise ValueError if there is none."""
    try:
        return np.linalg.inv(matrix).astype(float, copy=False)
    except np.linalg.LinAlgError:
        raise ValueError('its information matrix is singular') from None


def _checked(R: Array) -> Array:
    """Return a covariance as a symmetric matrix; raise ValueError if it is none."""
    symmetric: Array = (R + R.T) / 2.0
    if not np.linalg.eigvalsh(symmetric)[0] > 0.0:
        raise ValueError('its covariance is not positive definite')
    return symmetric


def _as_increment(graph: Graph, edge: Edge) -> Edge:
    """
    Return the position of a pose as a relative pose with a heading of no weight.

    The heading is that of the estimates: where it differs, GTSAM, whose error is the logarithm of
    a pose, turns the error of the position.
    """
    heading = graph.poses[edge.end][2] - graph.poses[edge.begin][2]
    R = np.diag([0.0, 0.0, 1.0 / UNKNOWN_HEADING])
    R[:2, :2] = edge.R
    return edge._replace(z=np.append(edge.z, heading), R=R)


def _edge(tag: str, edge: Edge, information: Array) -> str:
    upper = information[np.triu_indices(len(information))]
    return _line(tag, [edge.begin, edge.end], [*edge.z, *upper])


def _line(tag: str, vertices: list[int], numbers: Iterable[float]) -> str:
    return ' '.join([tag, *map(str, vertices), *(repr(float(x)) for x in numbers)])


class IsamNoise(NamedTuple):
    """Meaning of the noise numbers of the records ODOMETRY and LANDMARK."""

    covariance: Callable[[Array], Array]  #: returns the covariance of these numbers
    #: whether the error of a relative pose is in the frame at its begin, as iSAM takes it
    is_at_begin: bool = False


NOISES: Mapping[str, IsamNoise] = {
    'covariance': IsamNoise(symmetric),
    'information': IsamNoise(_of_information),
    'square_root': IsamNoise(lambda upper: _inverse(
        upper_triangular(upper).T @ upper_triangular(upper)), is_at_begin=True),
}
