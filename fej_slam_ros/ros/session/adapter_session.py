# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the adapter, live or from a bag: poses of tags and other objects in, scans out."""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
import re
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID, NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.detection import objects
from fej_slam_ros.detection.objects import DetectedObject, PlanarObservation
from fej_slam_ros.ros.messages import (
    decoded, incoming, markers, object_formats, outgoing, RawMessage)
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.messages.object_formats import FORMATS, ObjectFormat, SensedObjects
from fej_slam_ros.ros.parameters.adapter_settings import AdapterSettings
from fej_slam_ros.ros.session.front_end import LANDMARK_IDS
from fej_slam_ros.ros.session.inputs import CLOUD, ODOMETRY, TF_TYPE
from fej_slam_ros.ros.session.landmark_ids import LandmarkIds
from fej_slam_ros.ros.session.outputs import (
    DIAGNOSTICS_TOPIC, IsWanted, MARKERS_TOPIC, Publication, TYPES)
from fej_slam_ros.ros.session.sensor_frames import SensorFrames

#: Maximum number of messages of a frame that wait for its transform, and of such frames.
MAX_WAITING, MAX_FRAMES = 1_000, 100
#: Name in reports of what is on topics of the whole team and of an unknown robot.
NO_ROBOT = 'unknown robot'


class AdapterSession:
    """
    Adapter of all robots between messages.

    Observations are published in the base frames of the robots, with the stamps of the messages.
    A message waits until odometry and static transforms have told where its sensor is.

    Parameters
    ----------
    settings : parameters of the adapter
    ids : IDs of names that are known before
    save : called with the IDs of all names when there are new ones

    Attributes
    ----------
    robots : the robots by name
    topics : types of the topics that are read, by topic
    object_topics : the topics with objects
    outputs : types of the topics that are published, by topic

    """

    def __init__(
        self, settings: AdapterSettings, ids: Mapping[str, int],
        save: Callable[[Mapping[str, int]], object],
    ) -> None:
        self._settings, self._noise, self._save = settings, settings.noise(), save
        self._of = dict(zip(settings.robots, settings.of_robots))
        self.robots = {
            name: RobotSettings(name, k, base_frame=of.base_frame)
            for k, (name, of) in enumerate(self._of.items(), start=1)}
        self._carriers = {tag: name for name, of in self._of.items() for tag in of.tags}
        self._ids, self._saved = LandmarkIds(ids), 0
        self._frames = SensorFrames(self.robots, settings.tf_topics)
        self._formats = {
            topic: FORMATS[name] for name in settings.formats for topic in self._topics(name)}
        self.object_topics = [*self._formats]
        self.topics = {
            **{topic: of.type_name for topic, of in self._formats.items()},
            **{f'{name}/odom': ODOMETRY for name in self.robots}, **self._frames.topics}
        self.outputs = {
            **{f'{name}/{kind}': CLOUD for name in self.robots
               for kind in ('landmarks', *(['robots'] if self._carriers else []))},
            **{f'{name}/detection_markers': TYPES[MARKERS_TOPIC] for name in self.robots},
            LANDMARK_IDS: outgoing.TEXT_TYPE, DIAGNOSTICS_TOPIC: TYPES[DIAGNOSTICS_TOPIC]}
        # Waiting messages by the robot of their topic, '' if it is that of the team, and frame.
        self._waiting: dict[tuple[str, str], deque[_Waiting]] = {}
        self._counts: dict[str, Counter[str]] = {
            name: Counter(messages=0, landmarks=0, robots=0) for name in (*self.robots, NO_ROBOT)}

    def receive(self, arrived: RawMessage) -> None:
        """Add a message, or count its rejection."""
        topic = arrived.topic.lstrip('/')
        name, _, kind = topic.rpartition('/')
        if topic in self._formats:
            self._receive_objects(name, arrived, self._formats[topic])
        elif kind == 'odom' and name in self.robots and not self._frames.knows_base(name):
            message = decoded(arrived.raw, ODOMETRY) if arrived.type_name == ODOMETRY else None
            if message is not None:
                self._frames.add_odometry(name, message)
        else:
            self._frames.receive(arrived)

    def take(self, is_wanted: IsWanted = lambda _: True) -> Iterator[Publication]:
        """Yield what is to be published of the messages whose sensors are known."""
        for (name, frame), waiting in [*self._waiting.items()]:
            robot = name or self._owner(frame)
            if not robot:
                continue
            while waiting:
                sensor = self._sensor(robot, frame, waiting[0])
                if sensor is None:
                    break
                yield from self._published(robot, waiting.popleft(), sensor, is_wanted)
            if not waiting:
                del self._waiting[name, frame]
        if self._ids.changes != self._saved:
            self._saved = self._ids.changes
            self._save(self._ids.by_name)
            yield LANDMARK_IDS, outgoing.json_text(self._ids.by_name)

    def close(self) -> Iterator[Publication]:
        """Yield what is to be published at the end of the input, and reject what waits."""
        yield from self.take()
        for (name, _), waiting in self._waiting.items():
            self._reject(name, RejectionReason.WRONG_FRAME, len(waiting))
        self._waiting.clear()

    def counts(self) -> Iterator[tuple[str, str, dict[str, int]]]:
        """Yield each robot, a warning or '', and the counts of its messages and observations."""
        waiting: Counter[str] = Counter()
        for (name, _), messages in self._waiting.items():
            waiting[name or NO_ROBOT] += len(messages)
        for name, counts in self._counts.items():
            if name != NO_ROBOT or counts.total() or waiting[NO_ROBOT]:
                values = {
                    **counts, 'waiting': waiting[name],
                    'transforms_rejected': self._frames.rejected.total()}
                yield name, self._warning(name, counts), values

    def _topics(self, format_name: str) -> Iterator[str]:
        """Yield the topics of a format: transforms are on those of TF, as parameters say."""
        of, tf_topics = FORMATS[format_name], self._settings.tf_topics
        if of.type_name != TF_TYPE or tf_topics != 'shared':
            yield from (f'{name}/{of.topic}' for name in self.robots)
        if of.type_name == TF_TYPE and tf_topics != 'robot':
            yield of.topic

    def _receive_objects(self, name: str, arrived: RawMessage, of: ObjectFormat) -> None:
        message = decoded(arrived.raw, of.type_name) if arrived.type_name == of.type_name else None
        if message is None:
            self._reject(name, RejectionReason.BAD_MESSAGE)
            return
        is_used = re.compile(self._settings.names or of.names).fullmatch
        for sensed in of.read(message):
            used = [item for item in sensed.objects if not item.name or is_used(item.name)]
            # A message without objects is an empty scan, one with others only is none.
            if used or not sensed.objects:
                self._add(name, sensed._replace(objects=used))

    def _add(self, name: str, sensed: SensedObjects) -> None:
        """Let a message wait for the transform of its sensor."""
        key = name, sensed.header.frame_id.lstrip('/')
        try:
            given = sensed.sensor_pose
            pose = None if given is None else incoming.spatial_pose(
                given.position, given.orientation)
            if sensed.header.stamp.nanosec >= NS:
                raise incoming.RejectedError(RejectionReason.BAD_STAMP)
            if key not in self._waiting and len(self._waiting) >= MAX_FRAMES:
                raise incoming.RejectedError(RejectionReason.WRONG_FRAME)
        except incoming.RejectedError as rejected:
            self._reject(name, rejected.reason)
            return
        detected = []
        for item in map(object_formats.detected, sensed.objects):
            if isinstance(item, DetectedObject):
                detected.append(item)
            else:
                self._reject(name, item)
        waiting = self._waiting.setdefault(key, deque())
        waiting.append(_Waiting(from_time(sensed.header.stamp), detected, pose))
        if len(waiting) > MAX_WAITING:
            waiting.popleft()
            self._reject(name, RejectionReason.WRONG_FRAME)

    def _owner(self, frame: str) -> str:
        """Return the robot that has a frame, '' if that is not known."""
        named = [name for name in self.robots if frame.startswith(f'{name}/')]
        if named or len(self.robots) == 1:
            return (named or [*self.robots])[0]
        found = [name for name in self.robots if self._frames.pose(name, frame) is not None]
        return found[0] if len(found) == 1 else ''

    def _sensor(self, robot: str, frame: str, of: '_Waiting') -> Array | None:
        """Return the pose (4, 4) of a sensor on its robot, None if unknown."""
        given = self._of[robot].sensor_pose
        if given is None:
            return self._frames.pose(robot, frame) if of.sensor_pose is None else of.sensor_pose
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_euler('xyz', given[3:]).as_matrix(), given[:3]
        return pose

    def _published(
        self, robot: str, of: '_Waiting', sensor: Array, is_wanted: IsWanted
    ) -> Iterator[Publication]:
        seen = self._in_range(robot, of.objects)
        landmarks = self._landmarks(robot, [o for o in seen if o.name not in self._carriers])
        points, R = _stacked(
            [objects.on_plane(o, sensor, self._noise) for _, o in landmarks])
        robots = self._robots(robot, [o for o in seen if o.name in self._carriers], sensor)
        self._counts[robot].update(
            messages=1, landmarks=len(landmarks), robots=len(robots))
        frame = self._frames.base(robot)
        yield f'{robot}/landmarks', outgoing.detections(
            of.stamp, frame, [id_ for id_, _ in landmarks], points, R)
        if robots:
            yield f'{robot}/robots', outgoing.detections(
                of.stamp, frame, [*robots], *_stacked([*robots.values()]))
        if is_wanted(f'{robot}/detection_markers'):
            yield f'{robot}/detection_markers', markers.detection_markers(
                of.stamp, frame, points, R, np.zeros(len(points)), [o.name for _, o in landmarks])

    def _in_range(self, robot: str, detected: list[DetectedObject]) -> list[DetectedObject]:
        axis = self._settings.mirrored_axis
        if axis:
            detected = [objects.mirrored(of, 'xyz'.index(axis)) for of in detected]
        near = [
            of for of in detected
            if np.linalg.norm(of.pose[:3, 3]) <= self._settings.max_range]
        self._reject(robot, RejectionReason.OUT_OF_RANGE, len(detected) - len(near))
        return near

    def _landmarks(
        self, robot: str, seen: list[DetectedObject]
    ) -> list[tuple[int, DetectedObject]]:
        """Return objects with their IDs, without those that have none or the same."""
        ids = self._ids.find([of.name for of in seen])
        number = Counter(ids)
        kept = []
        for id_, of in zip(ids, seen):
            if id_ is None:
                self._reject(robot, RejectionReason.BAD_ID)
            elif id_ != NO_ID and number[id_] > 1:
                self._reject(robot, RejectionReason.DUPLICATE_ID)
            else:
                kept.append((id_, of))
        return kept

    def _robots(
        self, robot: str, seen: list[DetectedObject], sensor: Array
    ) -> dict[int, PlanarObservation]:
        """Return the observation of each robot by its ID: that of its tag with the least noise."""
        found: dict[int, PlanarObservation] = {}
        for of in seen:
            carrier = self._carriers[of.name]
            if carrier == robot:
                self._reject(robot, RejectionReason.SELF_OBSERVATION)
                continue
            centre = objects.behind(of, self._of[carrier].tag_depth, self._noise)
            observed = objects.on_plane(centre, sensor, self._noise)
            id_ = self.robots[carrier].id
            if id_ not in found or np.trace(observed.R) < np.trace(found[id_].R):
                found[id_] = observed
        return dict(sorted(found.items()))

    def _reject(self, robot: str, reason: RejectionReason, count: int = 1) -> None:
        if count:
            self._counts[robot or NO_ROBOT][f'rejected_{reason.value}'] += count

    def _warning(self, name: str, counts: Counter[str]) -> str:
        """Return what users have to know of a robot, '' if all is well."""
        frames = [frame for robot, frame in self._waiting if (robot or NO_ROBOT) == name]
        if frames and name == NO_ROBOT:
            return (
                f'the frame {frames[0]!r} on /tf is of no robot, or of several: begin it with the'
                ' name of its robot, or publish on <robot>/tf')
        if frames:
            return (
                f'no static transform from the frame {frames[0]!r} to the base frame: publish it'
                f' on /tf_static, or set {name}.sensor_pose')
        if self._ids.conflicts:
            return (
                f'{len(self._ids.conflicts)} names have the ID of another, such as'
                f' {min(self._ids.conflicts)!r}: give them IDs in ids_file')
        if name != NO_ROBOT and not counts['messages']:
            topics = ', '.join(topic for topic in self._formats if topic.startswith(f'{name}/'))
            return f'no detections: publish them on {topics or "/tf"}'
        if not counts['landmarks'] + counts['robots'] and counts.total() > counts['messages']:
            return 'all detections are rejected'
        return ''


class _Waiting(NamedTuple):
    """A message that waits for the transform of its sensor."""

    stamp: int
    objects: list[DetectedObject]
    sensor_pose: Array | None  #: (4, 4) array, if the message has it


def _stacked(observations: list[PlanarObservation]) -> tuple[Array, Array]:
    """Return points (n, 2) and covariances (n, 2, 2)."""
    return (
        np.array([of.z for of in observations]).reshape(-1, 2),
        np.array([of.R for of in observations]).reshape(-1, 2, 2))
