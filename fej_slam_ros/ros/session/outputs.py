# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From the estimator to messages on topics, the same way for live topics and bags."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from fej_slam_ros.core.ekf.state import landmark_estimates

from fej_slam_ros.core.estimates import PoseEstimate, StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.inputs import Inputs

#: A path holds so many poses at most; beyond that every other one is dropped.
MAX_PATH = 1000
#: Likewise in the markers, which nobody needs to the last pose.
MAX_DRAWN_PATH = 250

#: Topics of the estimator's own; ``~`` stands for its name.
LANDMARKS = '~/landmarks'
MARKERS = '~/markers'
JOINT_COVARIANCE = '~/joint_covariance'
REJECTIONS = '~/rejections'
DIAGNOSTICS = '/diagnostics'
TF = '/tf'

TF_TYPE = 'tf2_msgs/msg/TFMessage'
TYPES = {
    LANDMARKS: 'sensor_msgs/msg/PointCloud2',
    MARKERS: 'visualization_msgs/msg/MarkerArray',
    JOINT_COVARIANCE: 'std_msgs/msg/Float64MultiArray',
    REJECTIONS: 'diagnostic_msgs/msg/DiagnosticStatus',
    DIAGNOSTICS: 'diagnostic_msgs/msg/DiagnosticArray',
}
ROBOT_TYPES = {
    'pose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'path': 'nav_msgs/msg/Path',
    'map_landmarks': 'sensor_msgs/msg/PointCloud2',
}

Publication = tuple[str, Message]


@dataclass(slots=True)
class ThinnedPath:
    """The way of one robot in one frame, evenly thinned."""

    frame: str
    poses: list[tuple[int, Array]] = field(default_factory=list)
    _stride: int = 1
    _skipped: int = 0

    def add(self, stamp: int, pose: Array) -> None:
        """Take in the next pose."""
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
    """
    The landmarks of one frame.

    Attributes
    ----------
    frame : its name
    ids : number that each landmark is told by
    keys : whose number of it that is or, where ids only count, whose own numbers it has
    points : (n, 2) array, positions [m]
    P : (n, 2, 2) array, their covariances [m^2]

    """

    frame: str
    ids: list[int]
    keys: list[tuple[LandmarkKey, ...]]
    points: Array
    P: Array


def map_estimates(estimator: Estimator) -> Iterator[MapEstimate]:
    """Yield the map of each frame, ``map`` first; where ids are each robot's own, count them."""
    places = count(1)
    shared = estimator.settings.shared_landmark_ids
    for of_frame in estimator.maps():
        ids = [id_ if shared else next(places) for _, id_ in of_frame.keys]
        yield MapEstimate(
            of_frame.frame, ids, [(key,) for key in of_frame.keys], of_frame.points, of_frame.P)


def relative_topic(observer: str, seen: str) -> str:
    """Return where the pose of one robot as seen from another is published."""
    return f'{observer}/relative_pose/{seen}'


class Outputs:
    """
    What is told to the world.

    Parameters
    ----------
    estimator : what is told of
    inputs : what knows the frames of odometry
    settings : of the node

    """

    def __init__(
        self, estimator: Estimator, inputs: Inputs, settings: NodeSettings
    ) -> None:
        self._estimator = estimator
        self._inputs = inputs
        self._settings = settings
        self._paths: dict[str, ThinnedPath] = {}
        self._latest: dict[str, PoseEstimate] = {}

    @property
    def topics(self) -> dict[str, str]:
        """Return what is published of the present team, the type name by topic."""
        of_robots = {
            f'{name}/{kind}': type_name
            for name in self._estimator.robots for kind, type_name in ROBOT_TYPES.items()}
        of_pairs = {
            relative_topic(*pair): ROBOT_TYPES['pose']
            for pair in self._settings.relative_pairs()}
        transforms = {TF: TF_TYPE} if self._settings.publish_tf else {}
        return TYPES | of_robots | of_pairs | transforms

    def forget(self, robot: str) -> None:
        """Tell no more of a robot that has left."""
        self._paths.pop(robot, None)
        self._latest.pop(robot, None)

    def of_step(
        self, result: StepResult, is_wanted: Callable[[str], bool]
    ) -> Iterator[Publication]:
        """Yield what is published after each step, but for poses as far as it is wanted."""
        for estimate in result.poses:
            self._remember(estimate)
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
        if self._settings.publish_tf and is_wanted(TF):
            frames = {robot: self._inputs.odometry_frame(robot) for robot in result.odometry}
            yield TF, outgoing.transforms(result, frames)
        if result.joined and is_wanted(JOINT_COVARIANCE):
            yield JOINT_COVARIANCE, outgoing.joint_covariance(
                result.joined, self._estimator.joint_covariance())

    def overview(self, is_wanted: Callable[[str], bool]) -> Iterator[Publication]:
        """Yield paths and maps, as far as they are wanted; they are published now and then."""
        if not self._latest:
            return
        # Steps may follow before the next one is asked for.
        for name, path in [*self._paths.items()]:
            if is_wanted(f'{name}/path'):
                yield f'{name}/path', outgoing.path(path.frame, path.poses)
        stamp = max(estimate.stamp for estimate in self._latest.values())
        maps = [*map_estimates(self._estimator)]
        team, *others = maps
        yield LANDMARKS, cloud(stamp, team)
        owners = {own_frame(name): name for name in self._estimator.robots}
        for own in others:
            if own.frame in owners:
                yield f'{owners[own.frame]}/map_landmarks', cloud(stamp, own)
        if is_wanted(MARKERS):
            yield MARKERS, markers(stamp, [
                (place, self._latest[name], self._paths[name].poses)
                for place, name in enumerate(self._estimator.robots) if name in self._latest
            ], maps)

    def _remember(self, estimate: PoseEstimate) -> None:
        path = self._paths.get(estimate.robot)
        if path is None or path.frame != estimate.frame:
            path = self._paths[estimate.robot] = ThinnedPath(estimate.frame)
        path.add(estimate.stamp, estimate.pose)
        self._latest[estimate.robot] = estimate


def rejections(statistics: InputStatistics) -> Iterator[Publication]:
    """Yield each refused message and observation once."""
    while statistics.rejections:
        yield REJECTIONS, outgoing.rejection(statistics.rejections.popleft())


def cloud(stamp: int, estimate: MapEstimate) -> Message:
    """Return the landmarks of a frame as a message."""
    return outgoing.landmarks(
        stamp, estimate.frame, estimate.ids, estimate.points, estimate.P)


def markers(
    stamp: int, robots: Iterable[tuple[int, PoseEstimate, Sequence[tuple[int, Array]]]],
    maps: Iterable[MapEstimate],
) -> Message:
    """
    Return what draws robots and maps.

    Parameters
    ----------
    robots : place in the order of robots, newest pose and stamped path of each
    maps : of all frames

    """
    return outgoing.markers(
        stamp,
        [(place, now, _drawn_path(poses)) for place, now, poses in robots],
        [(drawn.frame, drawn.points, drawn.P) for drawn in maps])


def thinned(poses: Sequence[tuple[int, Array]], most: int) -> Sequence[tuple[int, Array]]:
    """Return so many of the poses of a path at most, counted from the newest, which is kept."""
    return poses[::-max(1, -(-len(poses) // most))][::-1]


def _drawn_path(poses: Sequence[tuple[int, Array]]) -> Array:
    return np.array([pose for _, pose in thinned(poses, MAX_DRAWN_PATH)])
