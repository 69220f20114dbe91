# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of sensors by what they see while the robot moves: pose, handedness, stamps, radii."""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
import math
from operator import attrgetter
from pathlib import Path

import numpy as np

from fej_slam_ros.core.calibration.sensor_pose import fit_sensor, SensorFit
from fej_slam_ros.core.calibration.shown_errors import MIN_SIGMAS
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.ordering.corrected_observations import without_observation_errors
from fej_slam_ros.core.records import Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.doctor import systematic_errors
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, warning
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import incoming_clouds, RawMessage
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.record_collector import RecordCollector
from fej_slam_ros.ros.session.robot_detector import RobotDetector

#: Number of messages of each topic that are used, and of all topics: the first ones.
MAX_SCANS, MAX_MESSAGES = 2_000, 60_000
#: Share of the disagreement that must remain for an error of a sensor to be reported, and below
#: which it corrupts an estimate.
REPORTED, CORRUPTING = 0.5, 0.3
#: Share of that by any other explanation, and disagreement, below which left and right are
#: exchanged: much of both may be noise of odometry. The share was 0.7 to 0.83 with 0.05 m/sqrt(s).
MIRRORED, MAX_MIRRORED = 0.85, 3.0
#: Share that may remain for observations that do not move: in map it was up to 0.32 in MRCLAM set
#: 6, where robots often rest; with the yaw of odometry of the wrong sign it was 0.44.
STILL = 0.35
#: Disagreement from which on scans are looked at with their beams in reverse order, too, and the
#: share of it that must remain at most. In simulated rooms it was 1.1 to 1.4 in the right order.
#: In the wrong one, of robots that turn by up to 0.3 and 0.6 rad/s, it was 1.7 and 2.7, of which
#: 0.73 and 0.5 remained in the right one.
SUSPICIOUS, REVERSED = 1.5, 0.8
#: Share up to which a delay is reported whose gain is of MIN_SIGMAS standard errors: with coarse
#: odometry, 0.8 to 0.9 remained at 0.1 to 0.3 s. Without a delay, the gain was of up to 3.
DELAYED = 0.95
#: Smallest disagreement, divided by the noise that is claimed, that is one.
MIN_DISAGREEMENT = 1e-3
#: Smallest errors that are reported [m], [rad], [s].
MIN_SHIFT, MIN_TURN, MIN_DELAY = 0.03, math.radians(1.0), 0.02
#: Limits of radii [m] between which posts are looked for, whatever the parameters are, the
#: smallest number of them that says something, and the share that must have an allowed radius.
ANY_RADIUS, MIN_POSTS, ALLOWED_SHARE = (0.01, 1.0), 100, 0.2
#: Conditions of scans that corrupt or prevent landmarks, and that may do so, whatever the
#: parameters are; a frame may do so if no parameter names it.
CORRUPTING_CONDITIONS = {'scans_rejected', 'scan_duration'}
DOUBTFUL_CONDITIONS = {'scan_times', 'scan_stamp'}
FRAME_CONDITION = 'laser_frame'
#: Findings after which observations fit nothing.
DOES_NOT_MOVE, BEARINGS = 'does_not_move', 'bearings'
#: Findings on where a sensor is and how it is turned.
WRONG_POSES = {'sensor_pose', 'sensor_mirrored'}
#: How the scans of each robot agree with its odometry, None if there are too few.
Fits = Mapping[str, SensorFit | None]
#: What scans of a laser, and observations of landmarks, need where they are wrong.
CURES = {
    'scan': (
        'check the odometry: by this laser, the robot stands still',
        'negate angle_increment, or give the static transform the roll of the laser',
        'correct the static transform of the laser',
        'stamp a scan with its first beam, or set stamped_at_end; see scan_duration, too'),
    'landmarks': (
        ('give x (ahead) and y (left) from the robot, not in map, and not of what it carries; if'
         ' it stood still, check its odometry'),
        ('give y to the left, as in all frames of ROS, correct the roll of a camera, or set'
         ' mirrored_axis of the adapter'),
        (f'{systematic_errors.POSE_CURE}: of a camera, that of its optical frame, z ahead, x right'
         ' and y down'),
        systematic_errors.DELAY_CURE)}


def check(
    path: Path, names: TopicNames, settings: RunSettings, detector: DetectorSettings
) -> Iterator[Finding]:
    """Yield sensors that are not where, or as, their observations say."""
    robots = [robot.name for robot in settings.estimation.robots]
    collector = RecordCollector(settings.estimation, needs_ids=False)
    inputs = Inputs(collector, settings.node)
    any_post = _any_post_settings(detector, bags.topics(path, names))
    lasers = DetectorSession(any_post)

    def first_messages() -> Iterator[RawMessage]:
        return _first_messages(bags.read(path, names), robots)

    posts = _posts(_received(first_messages(), inputs), lasers, collector.robots)
    team = TeamRecords(collector.records, settings.estimation)
    fits = _fits(any_post.robots, team.odometry, posts)
    reversed_fits: Fits = {}
    if any(fit is not None and fit.as_given > SUSPICIOUS for fit in fits.values()):
        other = DetectorSession(replace(any_post, reversed_beams=not detector.reversed_beams))
        posts = _posts(first_messages(), other, collector.robots)
        reversed_fits = _fits(any_post.robots, team.odometry, posts)
    for robot in robots:
        yield from _scan_findings(
            robot, fits.get(robot), reversed_fits.get(robot), detector.reversed_beams)
        given, odometry = collector.robots[robot], team.odometry[robot]
        scans = [without_observation_errors(scan, given) for scan in team.scans[robot]]
        fit = fit_sensor(odometry, scans)
        of_sensor = [] if fit is None else [
            *findings(f'{robot}/landmarks', fit, given.sensor_delay)]
        yield from of_sensor or systematic_errors.check(given, odometry, team.scans[robot])
        if robot in any_post.robots:
            found = lasers.detectors[robot]
            yield from _radii(robot, found.radii, detector)
            yield from _conditions(robot, found, collector.robots[robot].sensor_frame is None)


def _any_post_settings(detector: DetectorSettings, topics: Container[str]) -> DetectorSettings:
    """Return settings by which posts of any radius are found, also those that seem to move."""
    with_scans = tuple(name for name in detector.robots if f'{name}/scan' in topics)
    return replace(
        detector, robots=with_scans, min_radius=ANY_RADIUS[0], max_radius=ANY_RADIUS[1],
        static_time=0.0)


def _fits(
    robots: Iterable[str], odometry: Mapping[str, Sequence[Odometry]], scans: Sequence[Scan]
) -> Fits:
    """Return how scans agree with the odometry of each robot."""
    return {
        robot: fit_sensor(odometry[robot], sorted(
            (scan for scan in scans if scan.robot == robot), key=attrgetter('stamp')))
        for robot in robots}


def _received(messages: Iterable[RawMessage], inputs: Inputs) -> Iterator[RawMessage]:
    """Yield messages that inputs have received."""
    for message in messages:
        inputs.receive(message)
        yield message


def _posts(
    messages: Iterable[RawMessage], lasers: DetectorSession, robots: Mapping[str, RobotSettings]
) -> list[Scan]:
    """Return the landmarks in the scans of lasers."""
    posts = []
    for message in messages:
        lasers.receive(message)
        for topic, found in lasers.take():
            robot, _, kind = topic.rpartition('/')
            if kind == 'landmarks':
                scan, _ = incoming_clouds.scan(found, robots[robot])
                posts.append(without_observation_errors(scan, robots[robot]))
    return posts


def _scan_findings(
    robot: str, fit: SensorFit | None, other: SensorFit | None, reversed_beams: bool
) -> Iterator[Finding]:
    """Yield what explains a disagreement of scans; `other` is that by beams in reverse order."""
    if fit is None:
        return
    # Whether beams in the other order explain it, and nothing else better.
    if other is not None and other.as_given < min(
            REVERSED * fit.as_given, fit.moved, fit.delayed, fit.mirrored):
        yield error(
            'reversed_beams', f'{robot}/scan',
            'the beams seem to be in the reverse order of time:'
            f' {other.as_given / fit.as_given:.0%} of the disagreement between observations would'
            ' remain otherwise',
            f'set reversed_beams of the detector to {str(not reversed_beams).lower()}', fit.pairs)
    else:
        yield from findings(f'{robot}/scan', fit)


def _conditions(
    robot: str, detector: RobotDetector, needs_transform: bool
) -> Iterator[Finding]:
    """Yield the conditions of the scans of a robot, which the detector would report."""
    reported = CORRUPTING_CONDITIONS | DOUBTFUL_CONDITIONS
    if needs_transform:
        reported.add(FRAME_CONDITION)
    for name, what, cure in detector.conditions():
        if name in reported:
            yield error_if(name in CORRUPTING_CONDITIONS)(name, f'{robot}/scan', what, cure)


def findings(topic: str, fit: SensorFit, sensor_delay: float = 0.0) -> Iterator[Finding]:
    """
    Yield what explains why pairs of observations on a topic disagree, if anything does.

    Their stamps are earlier by `sensor_delay` [s] already.

    """
    # A robot at rest that repeats one observation agrees up to rounding.
    if fit.as_given < MIN_DISAGREEMENT:
        return
    still, mirrored, moved, delayed = CURES[topic.rpartition('/')[2]]
    best = min(fit.moved, fit.delayed, fit.mirrored)
    if fit.still < min(best, STILL * fit.as_given):
        yield error(
            DOES_NOT_MOVE, topic,
            'observations of a landmark stay the same while odometry moves:'
            f' {fit.still / fit.as_given:.0%} of the disagreement between observations would'
            ' remain if the robot stood still', still, fit.pairs)
        return
    is_mirrored = fit.mirrored < min(
        MIRRORED * min(fit.as_given, fit.moved, fit.delayed), MAX_MIRRORED)
    is_delayed = fit.delay_sigmas > MIN_SIGMAS and (
        fit.delayed < DELAYED * min(fit.as_given, fit.moved, fit.mirrored))
    if best > REPORTED * fit.as_given and not is_mirrored and not is_delayed:
        if fit.bearings_differ:
            yield error(
                BEARINGS, topic,
                'the ranges of observations fit the motion by odometry, their bearings do not',
                'give bearings in radians, counterclockwise from ahead; check the yaw of odometry',
                fit.pairs)
        return
    share = f'{best / fit.as_given:.0%} of the disagreement between observations would remain'
    found = partial(
        error_if(is_mirrored or best < CORRUPTING * fit.as_given), where=topic, count=fit.pairs)
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
            cure=delayed.format(sensor_delay + fit.delay))


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
