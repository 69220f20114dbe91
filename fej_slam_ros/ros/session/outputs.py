# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates to messages on topics, for live topics and bags."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from fej_slam_ros.core.estimates import PoseEstimate, StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.inputs import Inputs

#: Maximum number of poses of a published path, which limits its message to 100 kB; beyond it every
#: second pose is dropped.
MAX_PATH = 1000
#: Maximum number of poses of a path in the markers, where details are too small to see.
MAX_DRAWN_PATH = 250

#: Topics of the node; ``~`` stands for its name.
LANDMARKS_TOPIC = '~/landmarks'
MARKERS_TOPIC = '~/markers'
JOINT_COVARIANCE_TOPIC = '~/joint_covariance'
REJECTIONS_TOPIC = '~/rejections'
DIAGNOSTICS_TOPIC = '/diagnostics'
TF_TOPIC = '/tf'

TF_TYPE = 'tf2_msgs/msg/TFMessage'
TYPES = {
    LANDMARKS_TOPIC: 'sensor_msgs/msg/PointCloud2',
    MARKERS_TOPIC: 'visualization_msgs/msg/MarkerArray',
    JOINT_COVARIANCE_TOPIC: 'std_msgs/msg/Float64MultiArray',
    REJECTIONS_TOPIC: 'diagnostic_msgs/msg/DiagnosticStatus',
    DIAGNOSTICS_TOPIC: 'diagnostic_msgs/msg/DiagnosticArray',
}
ROBOT_TYPES = {
    'pose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'path': 'nav_msgs/msg/Path',
    'map_landmarks': 'sensor_msgs/msg/PointCloud2',
}

Publication = tuple[str, Message]


@dataclass(slots=True)
class ThinnedPath:
    """The trajectory of one robot in one frame, thinned evenly to at most `MAX_PATH` poses."""

    frame: str
    poses: list[tuple[int, Array]] = field(default_factory=list)
    _stride: int = 1
    _skipped: int = 0

    def add(self, stamp: int, pose: Array) -> None:
        """Append a pose."""
        self._skipped += 1
        if self.poses and self._skipped < self._stride:
            return
        self._skipped = 0
        self.poses.append((stamp, pose))
        if len(self.poses) > MAX_PATH:
            del self.poses[1::2]
            self._stride *= 2


@dataclass(frozen=True, slots=True, eq=False)
class MapEstimate:
    """The landmarks of one frame."""

    frame: str  #: its name
    ids: list[int]  #: published ID of each landmark
    #: robots and their IDs for each landmark; with shared IDs the robot is ''
    keys: list[tuple[LandmarkKey, ...]]
    points: Array  #: (n, 2) array, positions [m]
    P: Array  #: (n, 2, 2) array, their covariances [m^2]


def map_estimates(estimator: Estimator) -> Iterator[MapEstimate]:
    """Yield the map of each frame, ``map`` first; IDs are counted unless robots share them."""
    own_ids = count(1)
    shared = estimator.settings.shared_landmark_ids
    for of_frame in estimator.maps():
        ids = [id_ if shared else next(own_ids) for _, id_ in of_frame.keys]
        yield MapEstimate(
            of_frame.frame, ids, [(key,) for key in of_frame.keys], of_frame.points, of_frame.P)


def relative_topic(observer: str, observed: str) -> str:
    """Return the topic of the pose of one robot in the base frame of another."""
    return f'{observer}/relative_pose/{observed}'


class EstimatorOutputs:
    """
    Converts results of an estimator to messages.

    Parameters
    ----------
    estimator : whose results are published
    inputs : provides the names of the odometry frames
    settings : of the node

    """

    def __init__(self, estimator: Estimator, inputs: Inputs, settings: NodeSettings) -> None:
        self._estimator = estimator
        self._inputs = inputs
        self._settings = settings
        self._paths: dict[str, ThinnedPath] = {}
        self._latest: dict[str, PoseEstimate] = {}

    @property
    def topics(self) -> dict[str, str]:
        """Return the types of the topics published for the present team, by topic."""
        of_robots = {
            f'{name}/{kind}': type_name
            for name in self._estimator.robots for kind, type_name in ROBOT_TYPES.items()}
        of_pairs = {
            relative_topic(*pair): ROBOT_TYPES['pose']
            for pair in self._settings.relative_pairs()}
        transforms = {TF_TOPIC: TF_TYPE} if self._settings.publish_tf else {}
        return TYPES | of_robots | of_pairs | transforms

    def remove_robot(self, robot: str) -> None:
        """Publish no more paths and markers of a robot that was removed."""
        self._paths.pop(robot, None)
        self._latest.pop(robot, None)

    def of_step(
        self, result: StepResult, is_wanted: Callable[[str], bool]
    ) -> Iterator[Publication]:
        """Yield the messages of a step: the poses always, others if their topics are wanted."""
        for estimate in result.poses:
            self._append(estimate)
            yield (
                f'{estimate.robot}/pose',
                outgoing.pose(estimate, self._settings.unused_variance))
        for pair in self._settings.relative_pairs():
            if not result.odometry.keys().isdisjoint(pair):
                relative = self._estimator.relative_pose(*pair)
                if relative is not None:
                    yield (
                        relative_topic(*pair),
                        outgoing.relative_pose(relative, self._settings.unused_variance))
        if self._settings.publish_tf and is_wanted(TF_TOPIC):
            frames = {robot: self._inputs.odometry_frame(robot) for robot in result.odometry}
            yield TF_TOPIC, outgoing.transforms(result, frames)
        if result.joined and is_wanted(JOINT_COVARIANCE_TOPIC):
            yield JOINT_COVARIANCE_TOPIC, outgoing.joint_covariance(
                result.joined, self._estimator.joint_covariance())

    def maps_and_paths(self, is_wanted: Callable[[str], bool]) -> Iterator[Publication]:
        """Yield maps, and paths and markers if their topics are wanted; not for every step."""
        if not self._latest:
            return
        # The caller may process steps between two messages.
        for name, path in [*self._paths.items()]:
            if is_wanted(f'{name}/path'):
                yield f'{name}/path', outgoing.path(path.frame, path.poses)
        stamp = max(estimate.stamp for estimate in self._latest.values())
        maps = [*map_estimates(self._estimator)]
        team, *others = maps
        yield LANDMARKS_TOPIC, cloud(stamp, team)
        owners = {own_frame(name): name for name in self._estimator.robots}
        for own in others:
            if own.frame in owners:
                yield f'{owners[own.frame]}/map_landmarks', cloud(stamp, own)
        if is_wanted(MARKERS_TOPIC):
            yield MARKERS_TOPIC, markers(stamp, [
                (index, self._latest[name], self._paths[name].poses)
                for index, name in enumerate(self._estimator.robots) if name in self._latest
            ], maps)

    def _append(self, estimate: PoseEstimate) -> None:
        path = self._paths.get(estimate.robot)
        if path is None or path.frame != estimate.frame:
            path = self._paths[estimate.robot] = ThinnedPath(estimate.frame)
        path.add(estimate.stamp, estimate.pose)
        self._latest[estimate.robot] = estimate


def rejections(statistics: InputStatistics) -> Iterator[Publication]:
    """Yield each rejected message and observation once."""
    while statistics.rejections:
        yield REJECTIONS_TOPIC, outgoing.rejection(statistics.rejections.popleft())


def cloud(stamp: int, estimate: MapEstimate) -> Message:
    """Return the landmarks of a frame as a message."""
    return outgoing.landmarks(
        stamp, estimate.frame, estimate.ids, estimate.points, estimate.P)


def markers(
    stamp: int, robots: Iterable[tuple[int, PoseEstimate, Sequence[tuple[int, Array]]]],
    maps: Iterable[MapEstimate],
) -> Message:
    """
    Return markers of robots and maps.

    Parameters
    ----------
    robots : index, newest pose and stamped path of each robot
    maps : of all frames

    """
    return outgoing.markers(
        stamp,
        [(index, newest, _drawn_path(poses)) for index, newest, poses in robots],
        [(estimate.frame, estimate.points, estimate.P) for estimate in maps])


def thinned(poses: Sequence[tuple[int, Array]], most: int) -> Sequence[tuple[int, Array]]:
    """Return at most `most` poses of a path, evenly spaced and including the newest."""
    return poses[::-max(1, -(-len(poses) // most))][::-1]


def _drawn_path(poses: Sequence[tuple[int, Array]]) -> Array:
    return np.array([pose for _, pose in thinned(poses, MAX_DRAWN_PATH)])
