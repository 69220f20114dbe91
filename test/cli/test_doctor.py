# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults planted in copies of the shipped bags are found, each with its cure; clean ones pass."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
import json
from math import nan
from pathlib import Path

import numpy as np
import pytest
from ros_helpers import DATATYPES, raw, run_verb, TYPES, write_bag
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.ros import bags

BAGS = Path(__file__).parents[2] / 'bags'
NS = 10**9


@dataclass
class Entry:
    """A message of a bag: what it is, and when it was logged [ns]."""

    topic: str
    message: object
    logged: int


def entries(name):
    """Return what is in a shipped bag, to be changed at will."""
    return [
        Entry(m.topic, deepcopy(TYPES.deserialize_cdr(m.raw, m.type_name)), m.received)
        for m in bags.read(BAGS / name)]


def planted(path, found):
    """Write entries as a bag."""
    messages = sorted(found, key=lambda entry: entry.logged)
    return write_bag(path, [raw(e.topic, e.message, e.logged / 10**6) for e in messages])


def shifted(entry, seconds, log=False):
    """Move the stamp of an entry."""
    stamp = entry.message.header.stamp
    at = stamp.sec * NS + stamp.nanosec + round(seconds * NS)
    entry.message.header.stamp = type(stamp)(sec=at // NS, nanosec=at % NS)
    entry.logged += round(seconds * NS) if log else 0


def each(topics: str, change: Callable[[Entry], None], every=1, begin=0):
    """Return what changes every so many-th message of some topics, from one on."""
    def plant(found):
        for topic in topics.split():
            of_topic = [entry for entry in found if entry.topic == topic]
            assert of_topic
            for entry in of_topic[begin::every]:
                change(entry)
        return found
    return plant


def without(topics: str, part=slice(None)):
    """Return what drops messages of some topics."""
    def plant(found):
        for topic in topics.split():
            of_topic = [entry for entry in found if entry.topic == topic]
            dropped = {id(entry) for entry in of_topic[part]}
            assert dropped
            found = [entry for entry in found if id(entry) not in dropped]
        return found
    return plant


def kept(topic, every):
    """Return what leaves every so many-th message of a topic."""
    def plant(found):
        own = [entry for entry in found if entry.topic == topic]
        return [e for e in found if e.topic != topic] + own[::every]
    return plant


def twice(topic, every, change=lambda entry: None):
    """Return what repeats messages of a topic a moment later, changed."""
    def plant(found):
        copies = [deepcopy(e) for e in [e for e in found if e.topic == topic][::every]]
        for copy in copies:
            copy.logged += NS // 1000
            change(copy)
        return found + copies
    return plant


def columns(**changed):
    """Return what changes columns of a cloud, each by a function of its numbers."""
    def change(entry):
        cloud = entry.message
        layout = np.dtype({
            'names': [f.name for f in cloud.fields],
            'formats': [{v: k for k, v in DATATYPES.items()}[f.datatype] for f in cloud.fields],
            'offsets': [f.offset for f in cloud.fields], 'itemsize': cloud.point_step})
        points = np.frombuffer(cloud.data.tobytes(), layout).copy()
        for name, made in changed.items():
            points[name] = made(points[name])
        cloud.data = points.view(np.uint8).ravel()
    return change


def floating_ids(entry):
    """Make the ids of a cloud float32."""
    field = next(f for f in entry.message.fields if f.name == 'id')
    columns(id=lambda ids: ids.astype(np.float32).view(np.int32))(entry)
    field.datatype = DATATYPES['f4']


def twist_covariance(change):
    def made(entry):
        entry.message.twist.covariance = change(entry.message.twist.covariance.copy())
    return made


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


C, R = 'two_circles', 'rendezvous'
ERROR, WARNING = 1, 0
#: Bag, what is planted, exit status, name of the finding, where it is, a word of the cure.
FAULTS = {
    'odometry missing': (C, without('r2/odom'), 1, 'no_odometry', 'r2/odom', 'remap'),
    'landmarks missing': (C, without('r2/landmarks'), 1, 'no_landmarks', 'r2/landmarks', 'remap'),
    'landmarks of one missing': (R, without('q/landmarks'), 1, 'no_landmarks', 'q/landmarks', ''),
    'wrong type': (C, of_type_pose, 1, 'wrong_type', 'r2/odom', 'nav_msgs/msg/Odometry'),
    'gap': (C, without('r1/odom', slice(40, 65)), 1, 'gap', 'r1/odom', 'link'),
    'gap at two a second': (R, without('p/odom', slice(20, 30)), 1, 'gap', 'p/odom', 'link'),
    'pause of scans': (C, without('r1/landmarks', slice(40, 65)), 0, 'gap', 'r1/landmarks', ''),
    'slow odometry': (C, kept('r2/odom', 5), 0, 'slow_odometry', 'r2/odom', 'often'),
    'odometry that nobody waits for': (
        C, kept('r2/odom', 10), 1, 'slow_odometry', 'r2/odom', '5 Hz'),
    'slow scans': (C, kept('r2/landmarks', 6), 0, 'slow_scans', 'r2/landmarks', 'detector'),
    'half of the messages lost': (
        C, both(without('r1/odom', slice(10, 60, 2)), without('r1/odom', slice(50, 70, 3))), 0,
        'irregular_rate', 'r1/odom', 'recorder'),
    'clock ahead': (
        C, each('r2/odom r2/landmarks r2/ground_truth', lambda e: shifted(e, 3.0)), 1,
        'clock_skew', 'r2', 'chrony'),
    'clock half a second behind': (
        R, each('q/odom q/landmarks q/robots', lambda e: shifted(e, -0.5)), 1, 'clock_skew', 'q',
        'chrony'),
    'another clock of the sensor': (
        C, each('r1/landmarks', lambda e: shifted(e, 0.5)), 1, 'clock_skew', 'r1/landmarks',
        'stamp scans'),
    'no common time': (
        C, each('r2/odom r2/landmarks r2/ground_truth', lambda e: shifted(e, 100.0, log=True)), 1,
        'no_overlap', 'r2/odom', 'clock'),
    'late': (C, each('r1/odom', delayed(2.0), every=10), 1, 'late', 'r1/odom', 'max_delay'),
    'late scans': (R, each('p/landmarks', delayed(3.0), 8), 1, 'late', 'p/landmarks', 'max_delay'),
    'duplicate': (C, twice('r1/odom', 5), 0, 'duplicate', 'r1/odom', 'once'),
    'duplicate scans': (R, twice('q/landmarks', 5), 0, 'duplicate', 'q/landmarks', 'once'),
    'conflicting': (C, twice('r1/odom', 5, moved(1.0)), 1, 'conflicting', 'r1/odom', 'one node'),
    'time goes back': (C, looped, 1, 'time_jump', 'all robots', 'loop'),
    'stamps not set': (
        R, each('p/landmarks', lambda e: shifted(e, -e.message.header.stamp.sec
                - e.message.header.stamp.nanosec / NS)), 1, 'unset_stamp', 'p/landmarks',
        'header.stamp'),
    'future': (C, each('r1/odom', lambda e: shifted(e, 3600.0), 9), 1, 'future', 'r1/odom',
               'clock'),
    'frame of scans': (
        C, each('r1/landmarks', framed('camera')), 1, 'wrong_frame', 'r1/landmarks',
        'sensor_frame'),
    'frame of another robot': (
        R, each('p/landmarks', framed('q/base_link')), 1, 'wrong_frame', 'p/landmarks',
        'p/base_link'),
    'odometry of another robot': (
        C, each('r1/odom', framed(child='r2/base_link')), 1, 'wrong_frame', 'r1/odom',
        'r1/base_link'),
    'bare frames': (
        C, each('r1/odom r2/odom', framed('odom', 'base_link')), 0, 'shared_frame', 'r1/odom',
        'begin the frames'),
    'no ids': (C, each('r2/landmarks', columns(id=lambda i: -1 + 0 * i)), 1, 'no_identity',
               'r2/landmarks', 'numbers'),
    'id twice': (
        R, each('p/landmarks', columns(
            id=lambda i: np.where(i == i.max(initial=-9), i[:1], i)), 3), 1, 'duplicate_id',
        'p/landmarks', 'own'),
    'negative ids': (C, each('r1/landmarks', columns(id=lambda i: -5 - i), 4), 1, 'bad_id',
                     'r1/landmarks', 'from 0'),
    'floating ids': (C, each('r1/landmarks', floating_ids), 1, 'bad_cloud', 'r1/landmarks',
                     'int32'),
    'new id each time': (
        C, (lambda found: [
            columns(id=lambda i, k=k: 1000 * (k + 1) + i)(e) or e
            if e.topic == 'r2/landmarks' else e for k, e in enumerate(found)]), 1,
        'never_seen_again', 'r2/landmarks', 'always the same'),
    'unknown robot': (R, each('p/robots', columns(id=lambda i: 7 + 0 * i)), 1, 'unknown_robot',
                      'p/robots', '.id'),
    'sees itself': (R, each('p/robots', columns(id=lambda i: 1 + 0 * i)), 1, 'self_sighting',
                    'p/robots', 'p.id'),
    'odometry covariance zero': (
        C, each('r1/odom', twist_covariance(np.zeros_like)), 1, 'unknown_covariance', 'r1/odom',
        'odometry_sigma'),
    'sighting covariance zero': (
        R, each('p/landmarks', columns(**dict.fromkeys(
            ('var_x', 'cov_xy', 'var_y'), np.zeros_like))), None, 'unknown_covariance',
        'p/landmarks', 'landmark_sigma'),
    'odometry covariance huge': (
        C, each('r2/odom', twist_covariance(at(0, 1e6))), 1, 'absurd_covariance', 'r2/odom',
        'variances'),
    'odometry covariance tiny': (
        C, each('r2/odom', twist_covariance(lambda c: 1e-12 * np.eye(6).ravel())), 1,
        'absurd_covariance', 'r2/odom', 'variances'),
    'odometry covariance not definite': (
        R, each('q/odom', twist_covariance(at(0, -0.1))), 1, 'bad_covariance', 'q/odom', ''),
    'sighting covariance tiny': (
        C, each('r1/landmarks', columns(
            var_x=lambda v: 0 * v + 1e-10, var_y=lambda v: 0 * v + 1e-10, cov_xy=np.zeros_like)),
        1, 'absurd_covariance', 'r1/landmarks', 'm^2'),
    'sighting covariance huge': (
        R, each('p/landmarks', columns(var_x=lambda v: 0 * v + 1e6)), 1, 'absurd_covariance',
        'p/landmarks', 'm^2'),
    'sighting covariance too small by 100': (
        C, each('r1/landmarks r2/landmarks', columns(
            **dict.fromkeys(('var_x', 'cov_xy', 'var_y'), lambda v: 0.01 * v))), 1, None, '',
        'calibrate'),
    'never join': (C, each('r2/landmarks', columns(id=lambda i: i + 1000)), 1, 'never_joins',
                   'r2', 'start_pose'),
    'never meet': (R, without('p/robots q/robots'), 1, 'never_joins', 'q', 'start_pose'),
    'blind anchor': (C, without('r1/landmarks'), 1, 'blind_anchor', 'r1', 'anchor'),
    'teleport': (C, each('r1/odom', moved(30.0), begin=60), 1, 'jump', 'r1/odom', 'reset'),
    'small teleport': (R, each('p/odom', moved(3.0), begin=40), 1, 'jump', 'p/odom', 'reset'),
    'bad quaternion': (C, each('r1/odom', turned(), 7), 1, 'bad_quaternion', 'r1/odom', 'w'),
    'tilted': (R, each('p/odom', turned(x=0.7071068, w=0.7071068), 5), 1, 'tilted', 'p/odom', ''),
    'not finite': (C, each('r2/odom', moved(nan), 11), 1, 'not_finite', 'r2/odom', ''),
    'millimetres': (C, each('r1/landmarks', columns(
        x=lambda x: 1e3 * x, y=lambda y: 1e3 * y)),
                    1, 'range', 'r1/landmarks', 'metres'),
    'odometry in millimetres': (C, each('r1/odom', scaled(1e3)), 1, 'speed', 'r1/odom', 'metres'),
    'y to the right': (R, each('p/landmarks', columns(y=lambda y: -y)), 1, 'does_not_fit', 'p',
                       'left'),
    'stands still': (C, each('r1/odom', scaled(0.0)), 1, None, '', ''),
}


@pytest.fixture
def doctor(tmp_path, capsys):
    """Return a function that examines a bag; it returns status, findings and output."""
    def run(bag, *options):
        file = tmp_path / 'findings.json'
        status = run_verb('doctor', bag, '--json', file, '--force', *options)
        told = json.loads(file.read_text()) if file.exists() else None
        return status, told, capsys.readouterr()

    return run


@pytest.mark.parametrize('with_parameters', [True, False])
@pytest.mark.parametrize('name', [C, R])
def test_nothing_is_found_in_a_clean_bag(doctor, name, with_parameters):
    options = ('--params', BAGS / f'{name}.yaml') if with_parameters else ()

    status, found, printed = doctor(BAGS / name, *options)

    assert (status, found) == (0, [])
    assert 'no errors, no warnings' in printed.out


@pytest.mark.parametrize('with_parameters', [True, False])
@pytest.mark.parametrize('fault', FAULTS)
def test_a_planted_fault_is_found_with_its_cure(doctor, tmp_path, fault, with_parameters):
    bag, plant, status, name, where, cure = FAULTS[fault]
    path = planted(tmp_path / 'faulty', plant(entries(bag)))
    options = ('--params', BAGS / f'{bag}.yaml') if with_parameters else ()

    got, found, _ = doctor(path, *options)

    if status is not None:
        assert got == status
    assert any(
        f['name'] == (name or f['name']) and where in f['where'] and cure in f['cure']
        for f in found)
