# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the adapter, live or from a bag: poses of tags and other objects in, scans out."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import compress
import re

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID, NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.detection import objects
from fej_slam_ros.detection.objects import DetectedObject, PlanarObservation
from fej_slam_ros.ros.messages import (
    decoded_as, incoming, incoming_clouds, markers, object_formats, outgoing, RawMessage)
from fej_slam_ros.ros.messages.common import from_time, MAX_SECONDS
from fej_slam_ros.ros.messages.object_formats import FORMATS, SensedObjects
from fej_slam_ros.ros.parameters.adapter_settings import AdapterSettings
from fej_slam_ros.ros.session.adapter_counts import AdapterCounts
from fej_slam_ros.ros.session.distinct_stamps import DistinctStamps
from fej_slam_ros.ros.session.front_end import FrontEnd, RobotCounts
from fej_slam_ros.ros.session.landmark_ids import LandmarkIds, number_of
from fej_slam_ros.ros.session.object_queue import ObjectQueue, ObjectScan, Origin
from fej_slam_ros.ros.session.outputs import IsWanted, Publication
from fej_slam_ros.ros.session.sensor_frames import SensorFrames
from fej_slam_ros.ros.topic_types import (
    CLOUD, DIAGNOSTICS_TOPIC, LANDMARK_IDS, MARKERS_TOPIC, ODOMETRY, OUTPUT_TYPES, TF_TYPE,
    transform_topics)

#: Maximum number of objects in a message, and of its bytes, beyond which it is not decoded.
MAX_MESSAGE_OBJECTS, MAX_MESSAGE_SIZE = 2_000, 4_000_000


class AdapterSession(FrontEnd):
    """
    Adapter of all robots: messages in, messages out.

    Observations are published in the base frames of the robots, with the stamps of the messages. A
    message waits until the pose of its sensor is known from odometry and static transforms.

    Parameters
    ----------
    ids : IDs of names that are known before
    save : called with the IDs of all names when there are new ones, at most once a second

    Attributes
    ----------
    object_topics : the topics with objects

    """

    def __init__(
        self, settings: AdapterSettings, ids: Mapping[str, int],
        save: Callable[[Mapping[str, int]], object],
    ) -> None:
        self._settings, self._noise, self._save = settings, settings.noise(), save
        self._carriers = {
            tag: name for name, of_robot in settings.of_robots.items() for tag in of_robot.tags}
        self.robots = {
            name: RobotSettings(name, id_, base_frame=settings.of_robots[name].base_frame)
            for name, id_ in settings.ids().items()}
        self._ids = LandmarkIds(ids)
        # Number of names with and without ID when they were published last, and the stamp [ns].
        self._published_ids, self._ids_stamp = (0, 0), -NS
        self._frames = SensorFrames(self.robots, settings.tf_topics)
        self._queue = ObjectQueue(settings, self._frames)
        self._formats = {
            topic: (FORMATS[name], re.compile(settings.names or FORMATS[name].names).fullmatch)
            for name in settings.formats for topic in self._topics(name)}
        self.object_topics = [*self._formats]
        self.topics = {
            **{topic: of_topic.type_name for topic, (of_topic, _) in self._formats.items()},
            **{f'{name}/odom': ODOMETRY for name in self.robots}, **self._frames.topics}
        self.outputs = {
            **{f'{name}/{kind}': CLOUD for name in self.robots
               for kind in ('landmarks', *(['robots'] if self._carriers else []))},
            **{f'{name}/detection_markers': OUTPUT_TYPES[MARKERS_TOPIC] for name in self.robots},
            LANDMARK_IDS: outgoing.TEXT_TYPE, DIAGNOSTICS_TOPIC: OUTPUT_TYPES[DIAGNOSTICS_TOPIC]}
        self._stamps = {name: DistinctStamps() for name in self.robots}
        self._counts = AdapterCounts(
            self.robots, self.object_topics, self._frames, self._queue, self._ids)

    def receive(self, arrived: RawMessage) -> None:
        topic = arrived.topic.lstrip('/')
        name, _, kind = topic.rpartition('/')
        if topic in self._formats:
            self._receive_objects(name, topic, arrived)
        elif kind == 'odom' and name in self.robots:
            self._receive_odometry(name, arrived)
        else:
            self._frames.receive(arrived)

    def take(self, is_wanted: IsWanted = lambda _: True) -> Iterator[Publication]:
        latest = self._ids_stamp
        for robot, sensor, scan in self._queue.take():
            yield from self._published(robot, sensor, scan, is_wanted)
            latest = scan.stamp
        # Stamps may go back, as of a bag that is played again.
        if abs(latest - self._ids_stamp) >= NS:
            self._ids_stamp = latest
            yield from self._new_ids()

    def close(self) -> Iterator[Publication]:
        yield from self.take()
        yield from self._new_ids()
        self._queue.close()

    def counts(self) -> Iterator[RobotCounts]:
        return self._counts.report()

    def _topics(self, format_name: str) -> Iterator[str]:
        """Yield the topics of a format: transforms are on those of TF, as parameters say."""
        added = FORMATS[format_name]
        for name in self.robots:
            if added.type_name == TF_TYPE:
                of_robot = transform_topics(self._settings.tf_topics, name, added.topic)
                yield from (topic.lstrip('/') for topic in of_robot)
            else:
                yield f'{name}/{added.topic}'

    def _receive_odometry(self, name: str, arrived: RawMessage) -> None:
        """Record the base frame of a robot, which is all that is used of its odometry."""
        if not self._frames.knows_base(name):
            message = decoded_as(arrived, ODOMETRY)
            if message is None:
                self._counts.reject(name, RejectionReason.BAD_MESSAGE)
            else:
                self._frames.names.add(name, message)

    def _receive_objects(self, name: str, topic: str, arrived: RawMessage) -> None:
        object_format, is_used = self._formats[topic]
        if len(arrived.raw) > MAX_MESSAGE_SIZE:
            self._counts.reject(name, RejectionReason.TOO_LARGE)
            return
        message = decoded_as(arrived, object_format.type_name)
        if message is None:
            self._counts.reject(name, RejectionReason.BAD_MESSAGE)
            return
        for sensed in object_format.read(message):
            named = [item._replace(name=self._common_name(item.name)) for item in sensed.objects]
            is_known = [
                not item.name or is_used(item.name) or self._carrier(item.name) for item in named]
            used = [*compress(named, is_known)]
            if len(used) < len(named):
                self._counts.ignore(name, sensed.header.frame_id.lstrip('/'), [
                    item.name for item, known in zip(named, is_known) if not known])
            # A message without objects is an empty scan, one with others only is none.
            if used or not sensed.objects:
                self._add(name, sensed._replace(objects=used))

    def _common_name(self, name: str) -> str:
        """Return the name of an object without that of the robot that sees it."""
        prefix, slash, common = name.partition('/')
        return common if slash and prefix in self.robots and name not in self._carriers else name

    def _add(self, name: str, sensed: SensedObjects) -> None:
        """Add the valid objects of a message to those that wait for the pose of their sensor."""
        origin = Origin(name, sensed.header.frame_id.lstrip('/'))
        robot = self._queue.owner(origin)
        given = sensed.sensor_pose
        try:
            pose = None if given is None else incoming.spatial_pose(
                given.position, given.orientation)
            if sensed.header.stamp.nanosec >= NS or sensed.header.stamp.sec > MAX_SECONDS:
                raise incoming.RejectedError(RejectionReason.BAD_STAMP)
            if len(sensed.objects) > MAX_MESSAGE_OBJECTS:
                raise incoming.RejectedError(RejectionReason.TOO_LARGE)
        except incoming.RejectedError as rejected:
            self._counts.reject(robot, rejected.reason)
            return
        detected = []
        for item in map(object_formats.detected, sensed.objects):
            if isinstance(item, DetectedObject):
                detected.append(item)
            else:
                self._counts.reject(robot, item)
        self._queue.add(origin, ObjectScan(from_time(sensed.header.stamp), detected, pose))

    def _published(
        self, robot: str, sensor: Array, scan: ObjectScan, is_wanted: IsWanted
    ) -> Iterator[Publication]:
        near = self._in_range(robot, scan.objects)
        named = self._landmarks(robot, [item for item in near if not self._carrier(item.name)])
        landmarks = self._valid(robot, [
            (id_, item.name, objects.planar_observation(item, sensor, self._noise))
            for id_, item in named])
        robots = self._valid(robot, [
            (self.robots[name].id, name, observation) for name, observation in self._robots(
                robot, [item for item in near if self._carrier(item.name)], sensor).items()])
        self._counts.add(robot, messages=1, landmarks=len(landmarks), robots=len(robots))
        frame, ids = self._frames.names.base(robot), [id_ for id_, _, _ in landmarks]
        points, R = outgoing.stacked([observation for _, _, observation in landmarks])
        stamp = scan.stamp
        if NO_ID in ids:
            stamp = self._stamps[robot].of(stamp, sensor.tobytes())
        yield f'{robot}/landmarks', outgoing.detections(stamp, frame, ids, points, R)
        if robots:
            yield f'{robot}/robots', outgoing.detections(
                scan.stamp, frame, [id_ for id_, _, _ in robots],
                *outgoing.stacked([observation for _, _, observation in robots]))
        if is_wanted(f'{robot}/detection_markers'):
            yield f'{robot}/detection_markers', markers.detection_markers(
                scan.stamp, frame, points, R, np.zeros(len(points)),
                [name for _, name, _ in landmarks])

    def _in_range(self, robot: str, detected: list[DetectedObject]) -> list[DetectedObject]:
        axis = self._settings.mirrored_axis
        if axis:
            detected = [objects.with_axis_negated(item, 'xyz'.index(axis)) for item in detected]
        near = [
            item for item in detected
            if np.linalg.norm(item.pose[:3, 3]) <= self._settings.max_range]
        self._counts.reject(robot, RejectionReason.OUT_OF_RANGE, len(detected) - len(near))
        return near

    def _landmarks(
        self, robot: str, detected: list[DetectedObject]
    ) -> list[tuple[int, DetectedObject]]:
        """Return objects with their IDs, without those that have none or the same."""
        ids = self._ids.assign([item.name for item in detected])
        number = Counter(ids)
        kept = []
        for id_, item in zip(ids, detected):
            if id_ is None:
                self._counts.reject(robot, RejectionReason.BAD_ID)
            elif id_ != NO_ID and number[id_] > 1:
                self._counts.reject(robot, RejectionReason.DUPLICATE_ID)
            else:
                kept.append((id_, item))
        return kept

    def _robots(
        self, robot: str, tags: list[DetectedObject], sensor: Array
    ) -> dict[str, PlanarObservation]:
        """Return the observation of each other robot: that of its tag with the least noise."""
        found: dict[str, PlanarObservation] = {}
        for tag in tags:
            carrier = self._carrier(tag.name)
            if carrier == robot:
                self._counts.reject(robot, RejectionReason.SELF_OBSERVATION)
                continue
            depth = self._settings.of_robots[carrier].tag_depth
            centre = objects.carrier_position(tag, depth, self._noise)
            observed = objects.planar_observation(centre, sensor, self._noise)
            self._counts.add(robot, further_tags=int(carrier in found))
            if carrier not in found or np.trace(observed.R) < np.trace(found[carrier].R):
                found[carrier] = observed
        return {name: found[name] for name in self.robots if name in found}

    def _carrier(self, name: str) -> str:
        """Return the robot that carries a tag, listed by name or number, '' if none does."""
        return self._carriers.get(name) or self._carriers.get(str(number_of(name)), '')

    def _valid(
        self, robot: str, observations: list[tuple[int, str, PlanarObservation]]
    ) -> list[tuple[int, str, PlanarObservation]]:
        """Return the observations that the estimator accepts, with their IDs and names."""
        faults = incoming_clouds.observation_faults(
            *outgoing.stacked([of_one for _, _, of_one in observations]))
        for reason in faults:
            if reason is not None:
                self._counts.reject(robot, reason)
        return [item for item, reason in zip(observations, faults) if reason is None]

    def _new_ids(self) -> Iterator[Publication]:
        """Yield the IDs of all names, and save them, if there are new ones."""
        version = len(self._ids.by_name), len(self._ids.conflicts)
        if version != self._published_ids:
            self._published_ids = version
            self._save(self._ids.by_name)
            yield LANDMARK_IDS, outgoing.json_text(self._ids.by_name)
