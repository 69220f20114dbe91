# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the frames in messages, from parameters and from the odometry of the robots."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.topic_types import STATIC_TF, transform_topics

#: Maximum number of child frames of odometry stored per robot; normally there is one.
MAX_CHILD_FRAMES = 10


class Team(Protocol):
    """An estimator or smoother."""

    @property
    def robots(self) -> Mapping[str, RobotSettings]:
        """Return the present team by name."""


class FrameNames:
    """
    Frames of the map, the odometry and the base of each robot.

    Names are those of the parameters, else those of the odometry messages. A name that two robots
    use is ambiguous where they share a topic of transforms, and the robot's own default replaces
    it.

    """

    def __init__(self, team: Team, settings: NodeSettings) -> None:
        self._team = team
        self._settings = settings
        # Frames in the odometry of each robot: the first and the newest one, and all child frames.
        self._odometry: dict[str, str] = {}
        self._newest: dict[str, str] = {}
        self._children: defaultdict[str, set[str]] = defaultdict(set)

    def static_topics(self, robot: str) -> list[str]:
        """Return the topics of the static transforms of a robot, its own first."""
        return transform_topics(self._settings.tf_topics, robot, STATIC_TF)

    def add(self, robot: str, odometry: Message) -> None:
        """Record the frames of an odometry message."""
        self._newest[robot] = odometry.header.frame_id.lstrip('/')
        self._odometry.setdefault(robot, self._newest[robot])
        if len(self._children[robot]) < MAX_CHILD_FRAMES:
            self._children[robot].add(odometry.child_frame_id.lstrip('/'))

    def remove_robot(self, robot: str) -> None:
        """Forget the frames of a robot that was removed."""
        for of_robots in (self._odometry, self._newest, self._children):
            of_robots.pop(robot, None)

    def published(self, frame: str) -> str:
        """Return the name of a frame of estimates in messages."""
        return self._settings.map_frame if frame == MAP else frame

    def renamed(self, estimate: PoseEstimate) -> PoseEstimate:
        """Return an estimate with the name of its frame in messages."""
        frame = self.published(estimate.frame)
        return estimate if frame == estimate.frame else replace(estimate, frame=frame)

    def odometry(self, robot: str) -> str:
        """Return the odometry frame: of the parameter, of the first odometry, or a default."""
        given, name = self._given(robot, 'odom_frame'), self._odometry_name(robot)
        others = (self._odometry_name(other) for other in self._others(robot))
        is_own = name not in {'', *self._maps(robot)} and name not in others
        return given or (name if is_own else f'{robot}/odom')

    def base(self, robot: str) -> str:
        """Return the base frame: of the parameter, of all odometry, or ``<robot>/base_link``."""
        given, name = self._given(robot, 'base_frame'), self._base_name(robot)
        others = (self._base_name(other) for other in self._others(robot))
        return given or (name if name and name not in others else f'{robot}/base_link')

    def faults(self, robot: str) -> Iterator[str]:
        """Yield a sentence for each frame of the odometry of a robot that changes or is a map."""
        first, base = self.odometry(robot), self.base(robot)
        newest, children = self._newest.get(robot, first), self._children.get(robot, set())
        if newest in self._maps(robot):
            yield (
                f'its odometry is in the frame {newest!r}, as that of a localisation whose'
                ' corrections are no motion: publish odometry that drifts, but never jumps')
        elif newest != first == self._odometry.get(robot):
            yield (
                f'the frame of its odometry has changed from {first!r} to {newest!r}, to which no'
                ' transform from map leads: correct the driver, or start this node again')
        if len(children) > 1 and not self._given(robot, 'base_frame'):
            yield (
                f'the child frame of its odometry changes ({", ".join(sorted(children))}), so that'
                f' its base frame is {base!r}: correct the driver, or set {robot}.base_frame')

    def ambiguities(self, robot: str) -> Iterator[str]:
        """Yield a sentence if the odometry of a robot is in the frame of another one's."""
        name, odometry = self._odometry_name(robot), self.odometry(robot)
        others = [other for other in self._others(robot) if self._odometry_name(other) == name]
        if name not in {'', odometry} and others:
            yield (
                f'its odometry is in the frame {name!r}, as that of {others[0]}, so that the'
                f' transform from map leads to {odometry!r}: set tf_topics to robot if the'
                f' transforms of its driver are on /{robot}/tf, else begin its frames with its'
                ' name')

    def knows_base(self, robot: str) -> bool:
        """Return whether odometry has named the base frame of a robot."""
        return bool(self._children.get(robot))

    def is_base(self, robot: str, frame: str) -> bool:
        """Return whether a frame is the base frame of a robot; a scan without frame is in it."""
        given = self._given(robot, 'base_frame')
        return frame in {'', f'{robot}/base_link', given, *self._children.get(robot, ())}

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a checkpoint as plain data."""
        children = {robot: sorted(names) for robot, names in self._children.items()}
        return {'odometry_frames': self._odometry, 'child_frames': children}

    def restore(self, stored: dict[str, Any]) -> None:
        """Restore the state of a snapshot."""
        self._odometry = {**stored['odometry_frames']}
        for robot, names in stored['child_frames'].items():
            self._children[robot].update(names)

    def _maps(self, robot: str) -> set[str]:
        return {self._settings.map_frame, own_frame(robot)}

    def _others(self, robot: str) -> Iterator[str]:
        """Yield the robots whose frames must have other names."""
        if self._settings.shares_tf():
            yield from (other for other in self._team.robots if other != robot)

    def _odometry_name(self, robot: str) -> str:
        return self._given(robot, 'odom_frame') or self._odometry.get(robot, '')

    def _base_name(self, robot: str) -> str:
        names = self._children.get(robot, set())
        unique = next(iter(names)) if len(names) == 1 else ''
        return self._given(robot, 'base_frame') or unique

    def _given(self, robot: str, name: str) -> str:
        """Return a frame of the parameters, '' where none is given."""
        of_robot = self._team.robots.get(robot)
        return (getattr(of_robot, name) or '') if of_robot else ''
