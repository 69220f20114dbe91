# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of sensors by what they see while the robot moves: pose, handedness, stamps, radii."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
import math
from pathlib import Path

import numpy as np

from fej_slam_ros.core.calibration.sensor_pose import fit_sensor, SensorFit
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.ros.doctor.findings import error_if, Finding, warning
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import incoming_clouds, RawMessage
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.record_collector import RecordCollector

#: Number of messages of each topic that are used, and of all topics: the first ones.
MAX_SCANS, MAX_MESSAGES = 2_000, 60_000
#: Share of the disagreement that must remain for an error of a sensor to be reported, and below
#: which it corrupts an estimate.
REPORTED, CORRUPTING = 0.5, 0.3
#: Smallest errors that are reported [m], [rad], [s].
MIN_SHIFT, MIN_TURN, MIN_DELAY = 0.03, math.radians(1.0), 0.02
#: Limits of radii [m] between which posts are looked for, whatever the parameters are, the
#: smallest number of them that says something, and the share that must have an allowed radius.
ANY_RADIUS, MIN_POSTS, ALLOWED_SHARE = (0.01, 1.0), 100, 0.2
#: Conditions of scans that corrupt or prevent landmarks, and that may do so, whatever the
#: parameters are; a frame may do so if no parameter names it.
CORRUPTING_CONDITIONS, DOUBTFUL_CONDITIONS = {'scans_rejected', 'scan_duration'}, {'scan_stamp'}
FRAME_CONDITION = 'laser_frame'
#: What scans of a laser, and observations of landmarks, need where they are wrong.
CURES = {
    'scan': (
        'negate angle_increment, or give the static transform the roll of the laser',
        'correct the static transform of the laser',
        'stamp a scan with the time of its first beam, and give time_increment'),
    'landmarks': (
        'give y to the left, as in all frames of ROS, or set mirrored_axis of the adapter',
        'correct the static transform of the sensor or its sensor_pose',
        'stamp observations with the time of the scan or image, not with that of its processing')}


def check(
    path: Path, names: TopicNames, settings: RunSettings, detector: DetectorSettings
) -> Iterator[Finding]:
    """Yield sensors that are not where, or as, their observations say."""
    robots = [robot.name for robot in settings.estimation.robots]
    collector = RecordCollector(settings.estimation, needs_ids=False)
    inputs = Inputs(collector, settings.node)
    lasers = DetectorSession(replace(
        detector, robots=tuple(robots), min_radius=ANY_RADIUS[0], max_radius=ANY_RADIUS[1],
        static_time=0.0))
    posts: defaultdict[str, list[Scan]] = defaultdict(list)
    topics = bags.topics(path, names)
    has_scans = {robot: f'{robot}/scan' in topics for robot in robots}
    for message in _first_messages(bags.read(path, names), robots):
        inputs.receive(message)
        if any(has_scans.values()):
            lasers.receive(message)
        for topic, found in lasers.take():
            robot, _, kind = topic.rpartition('/')
            if kind == 'landmarks':
                posts[robot].append(incoming_clouds.scan(found, collector.robots[robot])[0])
    records = [record for record, _ in collector.records]
    for robot in robots:
        odometry = [r for r in records if isinstance(r, Odometry) and r.robot == robot]
        landmarks = [r for r in records if isinstance(r, Scan) and r.robot == robot]
        for kind, scans in (('scan', posts[robot]), ('landmarks', landmarks)):
            fit = fit_sensor(odometry, sorted(scans, key=lambda scan: scan.stamp))
            if fit is not None:
                yield from findings(f'{robot}/{kind}', fit)
        yield from _radii(robot, lasers.radii[robot], detector)
        if has_scans[robot]:
            yield from _conditions(robot, lasers, collector.robots[robot].sensor_frame is None)


def _conditions(
    robot: str, lasers: DetectorSession, needs_transform: bool
) -> Iterator[Finding]:
    """Yield the conditions of the scans of a robot, which the detector would report."""
    reported = CORRUPTING_CONDITIONS | DOUBTFUL_CONDITIONS
    if needs_transform:
        reported.add(FRAME_CONDITION)
    for name, what, cure in lasers.conditions(robot):
        if name in reported:
            yield error_if(name in CORRUPTING_CONDITIONS)(name, f'{robot}/scan', what, cure)


def findings(topic: str, fit: SensorFit) -> Iterator[Finding]:
    """Yield what explains why pairs of observations on a topic disagree, if anything does."""
    best = min(fit.moved, fit.delayed, fit.mirrored)
    if best > REPORTED * fit.as_given:
        return
    mirrored, moved, delayed = CURES[topic.rpartition('/')[2]]
    share = f'{best / fit.as_given:.0%} of the disagreement between observations would remain'
    found = partial(error_if(best < CORRUPTING * fit.as_given), where=topic, count=fit.pairs)
    x, y, yaw = fit.pose.tolist()
    if best == fit.mirrored:
        yield found(
            'sensor_mirrored', what=f'left and right are exchanged: {share} otherwise',
            cure=mirrored)
    elif best == fit.moved and (math.hypot(x, y) > MIN_SHIFT or abs(yaw) > MIN_TURN):
        where = (
            f'it seems to be {x:+.2f} m further ahead, {y:+.2f} m further to the left and turned'
            f' by {math.degrees(yaw):+.1f} degrees' if fit.is_determined else
            'by how much, this robot cannot tell since it drives on circles of one radius only')
        yield found(
            'sensor_pose', what=f'the sensor is not where it should be: {where}; {share} then',
            cure=moved)
    elif best == fit.delayed and abs(fit.delay) > MIN_DELAY:
        late = 'late' if fit.delay > 0.0 else 'early'
        yield found(
            'sensor_time',
            what=f'its stamps seem to be {abs(fit.delay):.2f} s too {late}: {share} otherwise',
            cure=delayed)


def _radii(robot: str, radii: Iterable[float], given: DetectorSettings) -> Iterator[Finding]:
    found = np.array([*radii])
    allowed = (found >= given.min_radius) & (found <= given.max_radius)
    if len(found) >= MIN_POSTS and np.mean(allowed) < ALLOWED_SHARE:
        low, middle, high = np.quantile(found, [0.1, 0.5, 0.9])
        yield warning(
            'radius_limits', f'{robot}/scan',
            f'round objects have radii of {low:.2f} to {high:.2f} m, {middle:.2f} m in the middle,'
            f' most of them outside of {given.min_radius:g} to {given.max_radius:g} m',
            'set min_radius and max_radius of the detector', int((~allowed).sum()))


def _first_messages(
    messages: Iterable[RawMessage], robots: Iterable[str]
) -> Iterator[RawMessage]:
    """Yield messages until each robot has sent enough scans, if it sends any."""
    needed = {f'{robot}/{kind}' for robot in robots for kind in ('scan', 'landmarks')}
    number: Counter[str] = Counter()
    for message in islice(messages, MAX_MESSAGES):
        number[message.topic] += 1
        if message.topic not in needed or number[message.topic] <= MAX_SCANS:
            yield message
        present = needed & number.keys()
        if present and all(number[topic] > MAX_SCANS for topic in present):
            return
