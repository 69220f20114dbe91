# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the estimator to messages on topics, for live topics and bags."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from fej_slam_ros.core.estimates import PoseEstimate, StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.published_maps import estimator_maps, MapEstimate
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import MAX_PATH, Outputs, Publication, StampedPoses
from fej_slam_ros.ros.topic_types import (
    JOINT_COVARIANCE_TOPIC, POSE_WITH_COVARIANCE, relative_topic)


@dataclass(slots=True)
class ThinnedPath:
    """The trajectory of one robot in one frame, thinned evenly to at most `MAX_PATH` poses."""

    frame: str
    poses: list[tuple[int, Array]] = field(default_factory=list)
    _stride: int = 1
    _skipped: int = 0

    def add(self, stamp: int, pose: Array) -> None:
        self._skipped += 1
        if self._skipped < self._stride:
            return
        self._skipped = 0
        self.poses.append((stamp, pose))
        if len(self.poses) > MAX_PATH:
            del self.poses[1::2]
            self._stride *= 2


class EstimatorOutputs(Outputs[Estimator]):
    """Converts results of an estimator to messages."""

    def __init__(self, estimator: Estimator, inputs: Inputs, settings: NodeSettings) -> None:
        super().__init__(estimator, inputs, settings, settings.publish_tf)
        self._pairs = settings.relative_pairs()
        self._paths: dict[str, ThinnedPath] = {}
        self._latest: dict[str, PoseEstimate] = {}

    @property
    def topics(self) -> dict[str, str]:
        return super().topics | {
            relative_topic(*pair): POSE_WITH_COVARIANCE for pair in self._pairs}

    def remove_robot(self, robot: str) -> None:
        """Publish no more paths and markers of a robot that was removed."""
        self._paths.pop(robot, None)
        self._latest.pop(robot, None)

    def of_step(self, result: StepResult) -> Iterator[Publication]:
        """Yield the messages of a step: the poses always, others if their topics are wanted."""
        for estimate in result.poses:
            self._append(estimate)
            yield self.of_pose(estimate)
        for pair in self._pairs:
            if not result.odometry.keys().isdisjoint(pair):
                relative = self._consumer.relative_pose(*pair)
                if relative is not None:
                    yield relative_topic(*pair), outgoing.relative_pose(
                        relative, self._frames.base(relative.observer),
                        self.settings.unused_variance)
        yield from self._step_transforms(result)
        if result.joined and self.is_wanted(JOINT_COVARIANCE_TOPIC):
            yield JOINT_COVARIANCE_TOPIC, outgoing.joint_covariance(
                result.joined, self._consumer.joint_covariance())

    def predictions(self) -> Iterable[Publication]:
        """Return the messages of predicted poses, which only a live run has."""
        return ()

    def _step_transforms(self, result: StepResult) -> Iterator[Publication]:
        return self._transforms(result.poses, result.odometry)

    def _append(self, estimate: PoseEstimate) -> None:
        path = self._paths.get(estimate.robot)
        if path is None or path.frame != estimate.frame:
            path = self._paths[estimate.robot] = ThinnedPath(estimate.frame)
        path.add(estimate.stamp, estimate.pose)
        self._latest[estimate.robot] = estimate

    def _newest(self) -> Mapping[str, PoseEstimate]:
        return self._latest

    def _path(self, robot: str) -> StampedPoses:
        return self._paths[robot].poses

    def _maps(self) -> Iterator[MapEstimate]:
        return estimator_maps(self._consumer)


class NoOutputs(EstimatorOutputs):
    """Of a run whose results only go to files."""

    def of_step(self, result: StepResult) -> Iterator[Publication]:
        """Return no message."""
        return iter(())
