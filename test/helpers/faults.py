# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults planted in copies of the shipped bags."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.ros.files import bags
from helpers.paths import BAGS
from helpers.ros import DATATYPES, raw, TYPES, write_bag

NS = 10**9


@dataclass
class Entry:
    """A message of a bag and the time at which it was logged [ns]."""

    topic: str
    message: object
    logged: int


def entries(name):
    """Return the messages of a shipped bag, for tests to change."""
    return [
        Entry(m.topic, TYPES.deserialize_cdr(m.raw, m.type_name), m.received)
        for m in bags.read(BAGS / name)]


def planted(path, found, storage='mcap'):
    """Write entries as a bag."""
    messages = sorted(found, key=lambda entry: entry.logged)
    return write_bag(path, [raw(e.topic, e.message, e.logged / 10**6) for e in messages], storage)


def shifted(entry, seconds, log=False):
    """Move the stamp of an entry."""
    stamp = entry.message.header.stamp
    at = stamp.sec * NS + stamp.nanosec + round(seconds * NS)
    entry.message.header.stamp = type(stamp)(sec=at // NS, nanosec=at % NS)
    entry.logged += round(seconds * NS) if log else 0


def in_whole_seconds(entry):
    """Drop the fraction of the stamp of an entry."""
    entry.message.header.stamp.nanosec = 0


def out_of_order(topic):
    """Return a fault that swaps the stamps of every tenth message of a topic and the next one."""
    def plant(found):
        own = [entry.message.header for entry in found if entry.topic == topic]
        for a, b in zip(own[::10], own[1::10]):
            a.stamp, b.stamp = b.stamp, a.stamp
        return found
    return plant


def recorded_late(topic, part, delay):
    """Return a fault that records some messages of a topic [s] late."""
    def plant(found):
        own = [entry for entry in found if entry.topic == topic]
        for entry in own[part]:
            entry.logged += round(delay * NS)
        return sorted(found, key=lambda entry: entry.logged)
    return plant


def each(topics: str, change: Callable[[Entry], None], every=1, begin=0):
    """Return a fault that changes every n-th message of some topics, from index `begin` on."""
    def plant(found):
        for topic in topics.split():
            of_topic = [entry for entry in found if entry.topic == topic]
            assert of_topic
            for entry in of_topic[begin::every]:
                change(entry)
        return found
    return plant


def without(topics: str, part=slice(None)):
    """Return a fault that drops messages of some topics."""
    def plant(found):
        for topic in topics.split():
            of_topic = [entry for entry in found if entry.topic == topic]
            dropped = {id(entry) for entry in of_topic[part]}
            assert dropped
            found = [entry for entry in found if id(entry) not in dropped]
        return found
    return plant


def kept(topic, every):
    """Return a fault that keeps only every n-th message of a topic."""
    def plant(found):
        own = [entry for entry in found if entry.topic == topic]
        return [e for e in found if e.topic != topic] + own[::every]
    return plant


def twice(topic, every, change=lambda entry: None):
    """Return a fault that repeats messages of a topic 1 ms later, changed."""
    def plant(found):
        copies = [deepcopy(e) for e in [e for e in found if e.topic == topic][::every]]
        for copy in copies:
            copy.logged += NS // 1000
            change(copy)
        return found + copies
    return plant


def with_pose(topic, frame, covariance):
    """Return a fault that adds a pose at the origin of a frame in the middle of the bag."""
    return with_poses(topic, frame, covariance, 1)


def with_poses(topic, frame, covariance, number):
    """Return a fault that adds poses at the origin of a frame, with the stamps of odometry."""
    def plant(found):
        odometry = [entry for entry in found if entry.topic == 'r2/odom']
        middle = len(odometry) // 2
        return [*found, *map(pose_at, odometry[middle:middle + number])]

    def pose_at(entry):
        pose = ros.geometry_msgs__msg__Pose(
            position=ros.geometry_msgs__msg__Point(0.0, 0.0, 0.0),
            orientation=ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0))
        message = ros.geometry_msgs__msg__PoseWithCovarianceStamped(
            header=ros.std_msgs__msg__Header(
                stamp=entry.message.header.stamp, frame_id=frame),
            pose=ros.geometry_msgs__msg__PoseWithCovariance(
                pose=pose, covariance=covariance.ravel()))
        return Entry(topic, message, entry.logged)
    return plant


def crowded(entry):
    """Repeat each point of a cloud 600 times."""
    cloud = entry.message
    cloud.data = np.tile(cloud.data, 600)
    cloud.width *= 600
    cloud.row_step *= 600


def columns(**changed):
    """Return a change of the columns of a cloud, each by a function of its values."""
    def change(entry):
        cloud = entry.message
        layout = np.dtype({
            'names': [f.name for f in cloud.fields],
            'formats': [{v: k for k, v in DATATYPES.items()}[f.datatype] for f in cloud.fields],
            'offsets': [f.offset for f in cloud.fields], 'itemsize': cloud.point_step})
        points = np.frombuffer(cloud.data.tobytes(), layout).copy()
        for name, function in changed.items():
            points[name] = function(points[name])
        cloud.data = points.view(np.uint8).ravel()
    return change


def without_cov_xy(entry):
    """Give the column cov_xy of a cloud another name."""
    next(f for f in entry.message.fields if f.name == 'cov_xy').name = 'intensity'


def floating_ids(entry):
    """Change the type of the IDs of a cloud to float32."""
    field = next(f for f in entry.message.fields if f.name == 'id')
    columns(id=lambda ids: ids.astype(np.float32).view(np.int32))(entry)
    field.datatype = DATATYPES['f4']


def twist_covariance(change):
    def change_entry(entry):
        entry.message.twist.covariance = change(entry.message.twist.covariance.copy())
    return change_entry


def at(place, value):
    def change(numbers):
        numbers[place] = value
        return numbers
    return change


def moved(dx):
    def change(entry):
        entry.message.pose.pose.position.x += dx
    return change


def scaled(factor):
    def change(entry):
        entry.message.pose.pose.position.x *= factor
        entry.message.pose.pose.position.y *= factor
    return change


def turned(x=0.0, y=0.0, z=0.0, w=0.0):
    def change(entry):
        entry.message.pose.pose.orientation = ros.geometry_msgs__msg__Quaternion(x, y, z, w)
    return change


def in_degrees(entry):
    """Give the bearings of the observations of a cloud in degrees, as if they were radians."""
    positions(entry, lambda z: abs(z) * np.exp(1j * np.angle(z, deg=True)))


def in_map(topic):
    """Return a fault that gives the observations of a robot in map, by its true poses."""
    def plant(found):
        def stamp(entry):
            return entry.message.header.stamp.sec, entry.message.header.stamp.nanosec

        truth = topic.replace('landmarks', 'ground_truth')
        poses = {stamp(e): e.message.pose.pose for e in found if e.topic == truth}
        for entry in found:
            if entry.topic == topic:
                place(entry, poses[stamp(entry)])
        return found

    def place(entry, pose):
        p, q = pose.position, pose.orientation
        turn = np.exp(2j * np.arctan2(q.z, q.w))
        positions(entry, lambda z: turn * z + p.x + 1j * p.y)
    return plant


def positions(entry, change):
    """Change the points x + iy of a cloud."""
    points = []
    columns(x=lambda x: points.append(x) or x, y=lambda y: points.append(y) or y)(entry)
    z = change(points[0] + 1j * points[1])
    columns(x=lambda _: z.real, y=lambda _: z.imag)(entry)


def exchanged(first, second):
    """Return a fault that exchanges two topics."""
    def plant(found):
        names = {first: second, second: first}
        for entry in found:
            entry.topic = names.get(entry.topic, entry.topic)
        return found
    return plant


def framed(frame=None, child=None):
    def change(entry):
        if frame is not None:
            entry.message.header.frame_id = frame
        if child is not None:
            entry.message.child_frame_id = child
    return change


def delayed(seconds):
    def change(entry):
        entry.logged += round(seconds * NS)
    return change


def of_type_pose(found):
    for entry in found:
        if entry.topic == 'r2/odom':
            entry.message = ros.geometry_msgs__msg__PoseStamped(
                header=entry.message.header, pose=entry.message.pose.pose)
    return found


def looped(found):
    """Record a bag that is played twice."""
    again = deepcopy(found)
    for entry in again:
        entry.logged += 60 * NS
    return found + again


def both(*plants):
    def plant(found):
        for one in plants:
            found = one(found)
        return found
    return plant
