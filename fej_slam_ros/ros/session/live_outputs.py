# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of a live estimator: besides those of every run, predicted poses without delay."""

from collections import defaultdict
from collections.abc import Iterator

from fej_slam_ros.core.estimates import PoseEstimate, StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.prediction import PosePredictor
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.estimator_outputs import EstimatorOutputs
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.topic_types import PREDICTED_TYPES


class LiveOutputs(EstimatorOutputs):
    """
    Predicts the pose of a robot at each odometry message, which is published before the next step.

    The transforms are those of the predicted poses instead of those of the steps.

    """

    def __init__(self, estimator: Estimator, inputs: Inputs, settings: NodeSettings) -> None:
        super().__init__(estimator, inputs, settings)
        self._predictors: defaultdict[str, PosePredictor] = defaultdict(PosePredictor)
        # The newest odometry of each robot, as record and message, until its prediction is
        # published.
        self._newest_odometry: dict[str, tuple[Odometry, Message]] = {}
        inputs.on_odometry = self._add

    @property
    def topics(self) -> dict[str, str]:
        return super().topics | {
            f'{name}/{kind}': type_name
            for name in self._consumer.robots for kind, type_name in PREDICTED_TYPES.items()}

    def remove_robot(self, robot: str) -> None:
        """Publish nothing more of a robot that was removed."""
        super().remove_robot(robot)
        self._predictors.pop(robot, None)
        self._newest_odometry.pop(robot, None)

    def of_step(self, result: StepResult) -> Iterator[Publication]:
        """Yield the messages of a step, and predict from its poses from now on."""
        for settled in result.poses:
            self._predictors[settled.robot].settle(settled, result.odometry[settled.robot])
        yield from super().of_step(result)

    def predictions(self) -> Iterator[Publication]:
        """Yield the messages of the newest odometry of each robot, once and if it is wanted."""
        for name in [*self._newest_odometry]:
            topics = [*(f'{name}/{kind}' for kind in PREDICTED_TYPES), *self._tf_topics(name)]
            if not any(map(self.is_wanted, topics)):
                del self._newest_odometry[name]
                continue
            predicted = self._predictors[name].predict(self._consumer.robots[name])
            if predicted:
                yield from self._messages(predicted, *self._newest_odometry.pop(name))

    def _add(self, record: Odometry, message: Message) -> None:
        if self._predictors[record.robot].add(record):
            self._newest_odometry[record.robot] = record, message

    def _messages(
        self, predicted: PoseEstimate, record: Odometry, message: Message
    ) -> Iterator[Publication]:
        if self.is_wanted(f'{record.robot}/predicted_pose'):
            yield self.of_pose(predicted, 'predicted_pose')
        topic = f'{record.robot}/odometry/filtered'
        if self.is_wanted(topic):
            yield topic, outgoing.fused_odometry(
                self._frames.renamed(predicted), self._frames.base(record.robot), message,
                self.settings.unused_variance)
        yield from self._transforms(
            [predicted], {record.robot: record.pose}, self._post_date())

    def _step_transforms(self, result: StepResult) -> Iterator[Publication]:
        return iter(())
