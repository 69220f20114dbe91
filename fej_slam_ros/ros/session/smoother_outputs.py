# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothed trajectories and maps to messages on topics, for live topics and bags."""

from collections.abc import Iterator, Mapping

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.published_maps import MapEstimate, smoother_maps
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import Outputs, Publication, StampedPoses
from fej_slam_ros.ros.topic_types import SMOOTHED_ROBOT_TYPES, SMOOTHED_TEAM_TYPES


class SmootherOutputs(Outputs[TeamSmoother]):
    """Converts results of a smoother to messages."""

    team_types: Mapping[str, str] = SMOOTHED_TEAM_TYPES
    robot_types = SMOOTHED_ROBOT_TYPES

    def __init__(self, team: TeamSmoother, inputs: Inputs, settings: NodeSettings) -> None:
        super().__init__(team, inputs, settings, settings.publish_smoothed_tf)

    def of_new_pose(self, estimate: PoseEstimate) -> Iterator[Publication]:
        """Yield the messages of a pose that was added in a live run."""
        yield self.of_pose(estimate)
        yield from self._transforms(
            [estimate], {estimate.robot: self._consumer.odometry[estimate.robot]},
            post_date=self._post_date())

    def of_solution(self) -> Iterator[Publication]:
        """Yield the base nodes of the maps of a new solution."""
        for solved in self._consumer.solution.maps:
            for name, base in solved.base_nodes.items():
                if name in self._consumer.robots:
                    yield self.of_pose(
                        PoseEstimate(name, self._stamp(), solved.frame, base.pose, base.P),
                        'base_node')

    def _newest(self) -> Mapping[str, PoseEstimate]:
        if not self._consumer.solution.maps:
            return {}
        return {
            name: trajectory.newest() for name, trajectory in self._consumer.trajectories.items()
            if name in self._consumer.robots}

    def _path(self, robot: str) -> StampedPoses:
        trajectory = self._consumer.trajectories[robot]
        return [*zip(trajectory.stamps, trajectory.poses())]

    def _maps(self) -> Iterator[MapEstimate]:
        return smoother_maps(self._consumer)
