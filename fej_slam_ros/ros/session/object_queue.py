# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detected objects between their arrival and the time when the pose of their sensor is known."""

from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.detection.objects import DetectedObject, transform_of
from fej_slam_ros.ros.parameters.adapter_settings import AdapterSettings
from fej_slam_ros.ros.session.sensor_frames import SensorFrames

#: Maximum number of scans of a frame that wait, of such frames, and of objects in all of them.
MAX_SCANS_PER_FRAME, MAX_WAITING_FRAMES, MAX_WAITING_OBJECTS = 1_000, 100, 50_000
#: Frame in counts of scans of further frames.
OTHER_FRAMES = 'others'


class ObjectScan(NamedTuple):
    """Objects that a sensor has detected at one time."""

    stamp: int  #: [ns]
    objects: list[DetectedObject]
    sensor_pose: Array | None  #: (4, 4) array, of the sensor in the base frame, if known


class Origin(NamedTuple):
    """Robot and sensor of a scan."""

    namespace: str  #: the robot of its topic, '' if the topic is that of the team
    frame: str  #: of the sensor


class ObjectQueue:
    """
    Scans of objects, each until the robot that has its sensor, and the pose there, are known.

    Attributes
    ----------
    dropped : number of scans for which there was no room, by origin

    """

    def __init__(self, settings: AdapterSettings, frames: SensorFrames) -> None:
        self._robots = settings.robots
        self._frames = frames
        self._given = {
            robot: transform_of(*of_robot.sensor_pose)
            for robot, of_robot in settings.of_robots.items()
            if of_robot.sensor_pose is not None}
        self._waiting: dict[Origin, deque[ObjectScan]] = {}
        self._objects = 0
        self.dropped: Counter[Origin] = Counter()

    def add(self, origin: Origin, scan: ObjectScan) -> None:
        """Add a scan; if too many wait, the oldest one of the oldest frame is dropped."""
        self._waiting.setdefault(origin, deque()).append(scan)
        self._objects += len(scan.objects)
        if len(self._waiting[origin]) > MAX_SCANS_PER_FRAME:
            self._drop(origin)
        while self._objects > MAX_WAITING_OBJECTS or len(self._waiting) > MAX_WAITING_FRAMES:
            self._drop(next(iter(self._waiting)))

    def take(self) -> Iterator[tuple[str, Array, ObjectScan]]:
        """
        Yield the scans whose sensor is known: the robot, the pose (4, 4) on it, the scan.

        Of scans that are added meanwhile, none delays those of other frames.

        """
        for origin, scans in [*self.waiting().items()]:
            robot = self.owner(origin)
            for _ in range(scans if robot else 0):
                if origin not in self._waiting:
                    break
                sensor = self._sensor(
                    robot, origin.frame, self._waiting[origin][0].sensor_pose)
                if sensor is None:
                    break
                yield robot, sensor, self._pop(origin)

    def close(self) -> None:
        """Drop what waits at the end of the input."""
        for origin in [*self._waiting]:
            while origin in self._waiting:
                self._drop(origin)

    def waiting(self) -> dict[Origin, int]:
        """Return the number of scans that wait, by origin."""
        return {origin: len(scans) for origin, scans in self._waiting.items()}

    def unknown(self) -> list[Origin]:
        """Return the origins of waiting and dropped scans whose sensors are still not known."""
        return [
            origin for origin in (*self._waiting, *self.dropped)
            if not (robot := self.owner(origin))
            or self._sensor(robot, origin.frame, None) is None]

    def owner(self, origin: Origin) -> str:
        """
        Return the robot of a scan, '' if it is not known.

        On topics of the team it is the one with whose name the frame begins. Any other frame is
        that of the only robot from whose base it is reached, once all bases are known.

        """
        prefix, slash, _ = origin.frame.partition('/')
        if origin.namespace:
            return origin.namespace
        if slash and prefix in self._robots:
            return prefix
        if len(self._robots) == 1 and not slash:
            return self._robots[0]
        if not all(map(self._frames.knows_base, self._robots)):
            return ''
        reached = [
            robot for robot in self._robots if self._frames.pose(robot, origin.frame) is not None]
        return reached[0] if len(reached) == 1 else ''

    def _sensor(self, robot: str, frame: str, reported: Array | None) -> Array | None:
        """Return the pose (4, 4) of a sensor, which its message may have; None if unknown."""
        if frame and self._frames.names.is_base(robot, frame):
            return np.eye(4) if reported is None else reported
        if self._frames.is_fixed(robot, frame):
            return None
        if robot in self._given:
            return self._given[robot]
        if reported is None and frame:
            return self._frames.pose(robot, frame)
        return reported

    def _pop(self, origin: Origin) -> ObjectScan:
        scans = self._waiting[origin]
        scan = scans.popleft()
        self._objects -= len(scan.objects)
        if not scans:
            del self._waiting[origin]
        return scan

    def _drop(self, origin: Origin) -> None:
        self._pop(origin)
        if origin not in self.dropped and len(self.dropped) >= MAX_WAITING_FRAMES:
            origin = origin._replace(frame=OTHER_FRAMES)
        self.dropped[origin] += 1
