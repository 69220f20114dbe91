# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages, bags and parameter files in one line each, made without the package's converters."""

import csv
from dataclasses import fields
import json
from pathlib import Path
import re
from unittest import mock

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.stores import ros2_jazzy as ros
from scipy.spatial.transform import Rotation

from fej_slam_ros.cli.main import executable
from fej_slam_ros.core.records import TrueLandmarks, TruePose
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags, checkpoint, checksums
from fej_slam_ros.ros.messages import incoming, incoming_clouds, outgoing, RawMessage
from fej_slam_ros.ros.parameters import NodeSettings, RunSettings
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.log_lines import LogSeverity
from helpers.records import MS, odometry, scan, team

TYPES = get_typestore(Stores.ROS2_JAZZY)
ODOMETRY = 'nav_msgs/msg/Odometry'
CLOUD = 'sensor_msgs/msg/PointCloud2'

#: Codes of number types, as the definition of PointField lists them.
DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}

R1 = RobotSettings('r1', 1)


def run_settings(*names, known=(), **changes):
    """Return settings of a run; changes are of the estimation or of the node."""
    of_node = {field.name for field in fields(NodeSettings)} & changes.keys()
    node = NodeSettings(**{name: changes.pop(name) for name in of_node})
    return RunSettings(team(*names, known=known, **changes), node)


def header(ms, frame):
    sec, nanosec = divmod(round(ms * MS), 10**9)
    stamp = ros.builtin_interfaces__msg__Time(sec=sec, nanosec=nanosec)
    return ros.std_msgs__msg__Header(stamp=stamp, frame_id=frame)


def odometry_message(
    ms=0, xyz=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0), twist_covariance=None,
    child='r1/base_link',
):
    """Return odometry; the quaternion is x, y, z, w, the covariance (6, 6) by default unknown."""
    pose = ros.geometry_msgs__msg__Pose(
        position=ros.geometry_msgs__msg__Point(*xyz),
        orientation=ros.geometry_msgs__msg__Quaternion(*quaternion))
    zero = ros.geometry_msgs__msg__Vector3(x=0.0, y=0.0, z=0.0)
    covariance = np.zeros(36) if twist_covariance is None else np.ravel(twist_covariance)
    return ros.nav_msgs__msg__Odometry(
        header=header(ms, 'r1/odom'), child_frame_id=child,
        pose=ros.geometry_msgs__msg__PoseWithCovariance(pose=pose, covariance=np.zeros(36)),
        twist=ros.geometry_msgs__msg__TwistWithCovariance(
            twist=ros.geometry_msgs__msg__Twist(linear=zero, angular=zero),
            covariance=covariance.astype(float)))


def cloud(columns, ms=0, frame='', order='<', pad=0, rows=1, row_pad=0):
    """
    Return a cloud of columns {name: (type, values)}.

    There are pad bytes of rubbish before each field and row_pad bytes after each row.
    """
    codes = [order + code for code, _ in columns.values()]
    ends = np.cumsum([pad + np.dtype(code).itemsize for code in codes], dtype=int).tolist()
    offsets = [end - np.dtype(code).itemsize for end, code in zip(ends, codes)]
    layout = np.dtype({
        'names': list(columns), 'formats': codes, 'offsets': offsets, 'itemsize': ends[-1]})
    size = len(next(iter(columns.values()))[1])
    points = np.full(size * layout.itemsize, 0xFF, dtype=np.uint8).view(layout)
    for name, (_, values) in columns.items():
        points[name] = values
    row_size = size // rows * layout.itemsize
    data = np.pad(
        points.view(np.uint8).reshape(rows, row_size), ((0, 0), (0, row_pad)),
        constant_values=0xFF)
    fields = [
        ros.sensor_msgs__msg__PointField(
            name=name, offset=offset, datatype=DATATYPES[code], count=1)
        for (name, (code, _)), offset in zip(columns.items(), offsets)]
    return ros.sensor_msgs__msg__PointCloud2(
        header=header(ms, frame), height=rows, width=size // rows, fields=fields,
        is_bigendian=order == '>', point_step=layout.itemsize, row_step=data.shape[1],
        data=data.ravel(), is_dense=True)


def seen(*observations, ms=0, frame=''):
    """Return a cloud of observations (id, x, y), without covariances."""
    ids, x, y = zip(*observations) if observations else ((), (), ())
    return cloud({'x': ('f8', x), 'y': ('f8', y), 'id': ('i4', ids)}, ms, frame)


def empty_cloud(ms=0):
    """Return a cloud as its ROS constructor makes it: without fields and data."""
    return ros.sensor_msgs__msg__PointCloud2(
        header=header(ms, ''), height=0, width=0, fields=[], is_bigendian=False, point_step=0,
        row_step=0, data=np.empty(0, np.uint8), is_dense=False)


def cdr(message):
    """Return the serialised bytes of a message."""
    return bytes(TYPES.serialize_cdr(message, message.__msgtype__))


def through_cdr(message):
    """Return a message after serialisation and deserialisation."""
    return TYPES.deserialize_cdr(cdr(message), message.__msgtype__)


def mounts(*links, topic='tf_static'):
    """Return static transforms (parent, child, position, roll pitch yaw)."""
    transforms = []
    for parent, child, position, angles in links:
        quaternion = Rotation.from_euler('xyz', angles).as_quat().tolist()
        transforms.append(ros.geometry_msgs__msg__TransformStamped(
            header=header(0, parent), child_frame_id=child,
            transform=ros.geometry_msgs__msg__Transform(
                translation=ros.geometry_msgs__msg__Vector3(*position),
                rotation=ros.geometry_msgs__msg__Quaternion(*quaternion))))
    return raw(topic, ros.tf2_msgs__msg__TFMessage(transforms=transforms), 0)


def raw(topic, message, received_ms=None):
    """Return a message on its way to an estimator."""
    received = None if received_ms is None else round(received_ms * MS)
    return RawMessage(topic, message.__msgtype__, received, cdr(message))


def raw_record(record, robot_ids=()):
    """Return a record on its way to an estimator, received at its own stamp."""
    topic, message = outgoing.input_message(record, dict(robot_ids))
    return RawMessage(topic, message.__msgtype__, record.stamp, cdr(message))


def decoded(arrived):
    """Return the record in a valid message."""
    robot, _, kind = arrived.topic.partition('/')
    message = TYPES.deserialize_cdr(arrived.raw, arrived.type_name)
    if arrived.topic == 'ground_truth/landmarks':
        return incoming_clouds.true_landmarks(message)
    if kind == 'landmarks':
        record, rejected = incoming_clouds.scan(message, RobotSettings(robot, 1))
        assert not rejected
        return record
    return {'odom': incoming.odometry, 'ground_truth': incoming.true_pose}[kind](message, robot)


#: Landmarks in the frame of r1's start, and the start of r2 in it.
LANDMARKS = {1: (5.0, 1.0), 2: (5.0, -1.0), 3: (3.0, 4.0)}
R2_START = (1.0, -3.0)


def meeting(steps=5):
    """
    Return the exact records of r1 and r2, which drive abreast at 1 m/s, 100 ms a step.

    At step 0 they only move; from step 1 on both see all landmarks, and r2 can join.
    """
    records = []
    for ms in range(0, 100 * steps, 100):
        for robot, (x, y) in {'r1': (0.0, 0.0), 'r2': R2_START}.items():
            records.append(odometry(robot, ms))
            if ms:
                at = x + ms / 1000.0
                observations = [(i, (lx - at, ly - y)) for i, (lx, ly) in LANDMARKS.items()]
                records.append(scan(robot, ms, observations))
    return records


def meeting_truth(steps=5):
    """Return the ground truth of the meeting."""
    poses = [
        TruePose(robot, ms * MS, np.array([x + ms / 1000.0, y, 0.0]))
        for ms in range(0, 100 * steps, 100)
        for robot, (x, y) in {'r1': (0.0, 0.0), 'r2': R2_START}.items()]
    return [TrueLandmarks({i: np.array(at) for i, at in LANDMARKS.items()}), *poses]


def noisy_meeting():
    """Return messages of the meeting with noise: numbers of which every digit matters."""
    rng = np.random.default_rng(5)
    records = [odometry('r1', 0), odometry('r2', 0)]
    for k in range(1, 8):
        for robot, (x, y) in {'r1': (0.0, 0.0), 'r2': R2_START}.items():
            at = np.array([x + k / 10.0, y])
            records += [odometry(robot, 100 * k), scan(robot, 100 * k, [
                (i, point - at + rng.normal(0.0, 0.1, 2)) for i, point in LANDMARKS.items()])]
    return [raw_record(record) for record in records]


def feed(run, messages):
    """Process messages one by one; return the publications."""
    published = []
    for message in messages:
        run.receive(message)
        published += run.take()
    return published


def reports(session):
    """Yield each robot of a front end, its warnings in one string, and its counts."""
    for robot, warnings, counts in session.counts():
        yield robot, '; '.join(warnings), counts


def drive(run, messages):
    """Process messages one by one and close the run; return all publications."""
    return [*feed(run, messages), *run.close()]


def save(run):
    """Write the checkpoint of a run."""
    checkpoint.write(Path(run.settings.node.checkpoint), run.checkpoint_content())


def run_bag(bag):
    """Run the estimator over a bag with the parameters beside it; return the run."""
    run = EstimatorSession(parameters.load(bag.with_suffix('.yaml')), None)
    drive(run, bags.read(bag))
    return run


def log_texts(run):
    """Return the new lines of the log of a run from INFO on, without those of first data."""
    return [
        text for severity, text in run.log.take()
        if severity is not LogSeverity.DEBUG and not text.startswith('first data')]


def refusal_of(convert, *arguments):
    """Return the reason for which a conversion rejects a message as a whole."""
    with pytest.raises(incoming.RejectedError) as rejected:
        convert(*arguments)
    return rejected.value.reason


def write_bag(path, messages, storage='mcap', types=TYPES):
    """Write messages as a bag, each of them logged when it was received."""
    connections = {}
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        for m in messages:
            key = f'/{m.topic}', m.type_name
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=types)
            writer.write(connections[key], m.received, m.raw)
    for file in path.glob('*.mcap'):
        checksums.add(file)
    return path


def write_parameters(path, node='/**', **values):
    """Write a parameter file; by default with the team of r1 and r2."""
    parameters = values or {'robots': ['r1', 'r2']}
    path.write_text(json.dumps({node: {'ros__parameters': parameters}}), encoding='utf-8')
    return path


def run_verb(verb, *words):
    """Run an executable in this process and return its exit status."""
    with mock.patch('sys.argv', [verb, *map(str, words)]):
        try:
            return executable()
        except SystemExit as end:
            return end.code


def assert_one_sentence(result, status, *parts):
    """Check status and the two outputs of a verb that was used wrongly."""
    got, output, error = result
    assert (got, output) == (status, '')
    assert re.match(r'\w+: ', error)
    assert error.count('\n') == 1
    for part in map(str, parts):
        assert part in error


def finished_run(folder, messages, force=False, **options):
    """Return a run that has ended and completed its files, and its summary."""
    run = EstimatorSession(run_settings(**options), folder, force)
    drive(run, messages)
    return run, run.write_files()


def summary_of(folder):
    """Return the content of the ``summary.json`` of a run."""
    return json.loads((folder / 'summary.json').read_text(encoding='utf-8'))


def csv_rows(path):
    """Return the rows of a table by the names of its columns."""
    with path.open(encoding='utf-8', newline='') as file:
        return list(csv.DictReader(file))
