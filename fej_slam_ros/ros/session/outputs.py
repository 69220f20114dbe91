# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates to messages on topics, for live topics and bags."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages import markers, Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.published_maps import MapEstimate
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.topic_types import (
    LANDMARKS_TOPIC, MARKERS_TOPIC, OUTPUT_TYPES, REJECTIONS_TOPIC, ROBOT_OUTPUT_TYPES, TF,
    TF_TYPE, transform_topics)

#: Maximum number of poses of a published path, which limits its message to 100 kB; beyond it every
#: second pose is dropped.
MAX_PATH = 1000
#: Maximum number of poses of a path in the markers, where details are too small to see.
MAX_DRAWN_PATH = 250

Publication = tuple[str, Message]
IsWanted = Callable[[str], bool]
StampedPoses = Sequence[tuple[int, Array]]
ConsumerT = TypeVar('ConsumerT', bound=Estimator | TeamSmoother)


class Outputs(ABC, Generic[ConsumerT]):
    """
    Converts results of an estimator or a smoother to messages.

    Attributes
    ----------
    settings : of the node at present
    is_wanted : returns whether a topic has subscribers; without a node, all count as wanted

    """

    #: Types of the topics of the node, and of each robot.
    team_types: Mapping[str, str] = OUTPUT_TYPES
    robot_types: Mapping[str, str] = ROBOT_OUTPUT_TYPES

    def __init__(
        self, consumer: ConsumerT, inputs: Inputs, settings: NodeSettings, publishes_tf: bool
    ) -> None:
        self._consumer = consumer
        self._frames = inputs.frames
        self.settings = settings
        self.is_wanted: IsWanted = lambda topic: True
        self._publishes_tf = publishes_tf
        # Frames of which a map was published.
        self._mapped: set[str] = set()

    @property
    def topics(self) -> dict[str, str]:
        """Return the types of the topics published for the present team, by topic."""
        return {**self.team_types} | {
            f'{name}/{kind}': type_name
            for name in self._consumer.robots for kind, type_name in self.robot_types.items()
        } | {topic: TF_TYPE for name in self._consumer.robots for topic in self._tf_topics(name)}

    def of_pose(self, estimate: PoseEstimate, kind: str = 'pose') -> Publication:
        """Return the message of a pose, on a topic of its robot by the last part of its name."""
        return f'{estimate.robot}/{kind}', outgoing.pose(
            self._frames.renamed(estimate), self.settings.unused_variance)

    def maps_and_paths(self) -> Iterator[Publication]:
        """Yield maps, and paths and markers if their topics are wanted; not for every step."""
        # The caller may process steps between two messages.
        for name, newest in [*self._newest().items()]:
            if self.is_wanted(f'{name}/path'):
                path = thinned(self._path(name), MAX_PATH)
                yield f'{name}/path', outgoing.path(
                    self._frames.published(newest.frame), path)
        if not self._newest():
            return
        stamp, maps = self._stamp(), [*self._maps()]
        yield from self.cleared_maps({map_estimate.frame for map_estimate in maps})
        topics = self._map_topics()
        for map_estimate in maps:
            if map_estimate.frame in topics:
                self._mapped.add(map_estimate.frame)
                yield topics[map_estimate.frame], outgoing.landmarks(
                    stamp, self._frames.published(map_estimate.frame), map_estimate.ids,
                    map_estimate.points, map_estimate.P)
        if self.is_wanted(MARKERS_TOPIC):
            drawn = self._newest()
            yield MARKERS_TOPIC, markers.markers(
                stamp,
                [(index, drawn[name], self._drawn_path(name))
                 for index, name in enumerate(self._consumer.robots) if name in drawn],
                [(map_estimate.frame, map_estimate.points, map_estimate.P)
                 for map_estimate in maps], self._frames.published(MAP))

    def cleared_maps(self, kept: Collection[str] = ()) -> Iterator[Publication]:
        """Yield an empty map for each published one that is no longer kept, by its frame."""
        # Late subscribers would receive the last one.
        topics = self._map_topics() if self._newest() else {}
        for frame in sorted(self._mapped.difference(kept) & topics.keys()):
            yield topics[frame], outgoing.landmarks(
                self._stamp(), self._frames.published(frame), [], np.empty((0, 2)),
                np.empty((0, 2, 2)))
        self._mapped.intersection_update(kept)

    def _map_topics(self) -> dict[str, str]:
        """Return the topic of the map in each frame."""
        return {MAP: LANDMARKS_TOPIC} | {
            own_frame(name): f'{name}/map_landmarks' for name in self._consumer.robots}

    def _transforms(
        self, estimates: Sequence[PoseEstimate], odometry: Mapping[str, Array], post_date: int = 0
    ) -> Iterator[Publication]:
        """Yield the transforms of estimates and the odometry poses at their stamps."""
        by_topic: dict[str, list[PoseEstimate]] = {}
        for estimate in estimates:
            for topic in self._tf_topics(estimate.robot):
                by_topic.setdefault(topic, []).append(self._frames.renamed(estimate))
        if not by_topic:
            return
        frames = {robot: self._frames.odometry(robot) for robot in odometry}
        for topic, of_topic in by_topic.items():
            if self.is_wanted(topic):
                yield topic, outgoing.transforms(of_topic, odometry, frames, post_date)

    def _tf_topics(self, robot: str) -> list[str]:
        """Return the topics of the transform of a robot."""
        if not self._publishes_tf:
            return []
        return transform_topics(self.settings.tf_topics, robot, TF)

    def _post_date(self) -> int:
        """Return the duration [ns] by which the transforms of a live run are post-dated."""
        return round(self.settings.transform_tolerance * NS)

    @abstractmethod
    def _newest(self) -> Mapping[str, PoseEstimate]:
        """Return the newest pose of each robot, empty before there are maps to publish."""

    @abstractmethod
    def _path(self, robot: str) -> StampedPoses:
        """Return the poses of a robot in the frame of its newest pose."""

    @abstractmethod
    def _maps(self) -> Iterator[MapEstimate]:
        """Yield the map of each frame, ``map`` first."""

    def _drawn_path(self, robot: str) -> Array:
        return np.array([pose for _, pose in thinned(self._path(robot), MAX_DRAWN_PATH)])

    def _stamp(self) -> int:
        return max(estimate.stamp for estimate in self._newest().values())


def rejections(statistics: InputStatistics) -> Iterator[Publication]:
    """Yield each rejected message and observation once."""
    while statistics.rejections:
        yield REJECTIONS_TOPIC, outgoing.rejection(statistics.rejections.popleft())


def thinned(poses: StampedPoses, most: int) -> StampedPoses:
    """Return at most `most` poses of a path, evenly spaced and including the newest."""
    return poses[::-max(1, -(-len(poses) // most))][::-1]
