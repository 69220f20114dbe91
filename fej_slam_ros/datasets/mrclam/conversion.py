# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What the robots of an MRCLAM set measured as records, and the settings to run them with.

Commands become odometry by exact arcs, each in force until the next. A range and a bearing become
a Cartesian observation; the rows of one stamp are one scan.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
import heapq
from itertools import groupby
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Flags, wrap_all
from fej_slam_ros.core.ground_truth import MAX_GAP
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, Record, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.datasets.mrclam.files import (
    DataSet, LAST_SECOND, RobotLog, ROBOTS, Series, Stamps)

#: Variance that the increment (x, y, phi) of a robot gains in a second even where it stands.
STANDING = np.array([1e-6, 1e-6, 1e-6])

#: A command is trusted for so long [ns]; in a longer gap a robot may have done what it ever did.
LONGEST_HOLD = 2 * NS

#: Robots are waited for over gaps in which commands are trusted [s].
STALE_AFTER = 2.5

#: Errors that last make tests of one observation, or of one join, fail more often than chi-square
#: says; what is wrong is beyond this by far.
PROBABILITY = 0.99999
#: For the same reason a few observations tell less than they seem to.
JOIN_HEADING_SIGMA = 0.05

#: How well motion capture knows a pose [m, m, rad], and how long [ns] after the first odometry of
#: a robot its pose still tells where that started.
TRUTH_SIGMA = np.array([0.005, 0.005, 0.01])
START_REACH = 60 * NS
#: A start whose heading has this standard deviation [rad], or less, is good for the anchor.
GOOD_HEADING = 0.05
ORIGIN: Triple = (0.0, 0.0, 0.0)

#: Of robots that see nothing, to say something of their noise [m].
TYPICAL_RANGE = 3.5


@dataclass(frozen=True)
class Noise:
    """
    The errors of commands and camera; the defaults are those of set 6.

    Errors of a command last for seconds, so they add up faster than those of independent samples:
    the variances are such that what they add up to in 5 s is right.

    Attributes
    ----------
    way, heading : variance [m^2, rad^2] for each metre driven, and for each radian turned
    range, robot_range : standard deviation of ranges to landmarks and to robots, for each metre
    bearing, robot_bearing : standard deviation of bearings to them [rad]

    """

    way: tuple[float, float] = (0.0022, 0.0010)
    heading: tuple[float, float] = (0.0011, 0.0083)
    range: float = 0.044
    bearing: float = 0.0125
    robot_range: float = 0.042
    robot_bearing: float = 0.0111


@dataclass(frozen=True)
class Reading:
    """
    How a set is read.

    Attributes
    ----------
    motion_delay : how much later than commanded a robot moves [s]
    odometry_scale : true over commanded speed, ahead and turning
    thin : for so long [s] after a robot has seen somebody it is not used that it still does
    robot_observations : whether it is used that robots see each other
    noise : of what is read

    """

    motion_delay: float = 0.18
    odometry_scale: tuple[float, float] = (0.956, 0.947)
    thin: float = 3.0
    robot_observations: bool = True
    noise: Noise = Noise()


def robot_name(robot: int) -> str:
    """Return the name of a robot, by its subject."""
    return f'r{robot}'


def odometry(log: RobotLog, reading: Reading) -> tuple[Stamps, Array]:
    """Return stamps (n,) [ns] and poses (n, 3) in the frame of the first of them."""
    stamps = log.commands.stamps + round(reading.motion_delay * NS)
    dt = np.diff(stamps) / NS
    v, w = (log.commands.rows[:-1] * reading.odometry_scale).T
    turns = w * dt
    headings = np.append(0.0, np.cumsum(turns))
    # The chord of the arc that is driven, and its direction.
    chords, middle = v * dt * np.sinc(turns / math.tau), headings[:-1] + turns / 2.0
    x, y = (np.append(0.0, np.cumsum(chords * of(middle))) for of in (np.cos, np.sin))
    return stamps, np.column_stack([x, y, wrap_all(headings)])


def increment_variances(log: RobotLog, reading: Reading) -> Array:
    """Return the variances (n - 1, 3) of the increments (x, y, phi) of odometry [m^2, rad^2]."""
    dt = np.diff(log.commands.stamps)[:, None] / NS
    speeds, noise = np.abs(log.commands.rows), reading.noise
    driven = speeds[:-1] @ np.array([noise.way, (0.0, 0.0), noise.heading]).T
    variances: Array = dt * (STANDING + driven)
    unknown = dt[:, 0] > LONGEST_HOLD / NS
    v, w = speeds.max(axis=0)
    variances[unknown] += np.square(dt[unknown] * [v, v, w])
    return variances


def observations(
    data: DataSet, robot: int, reading: Reading, counts: Counter[str]
) -> Series:
    """Return what of a robot's observations is used; the others are counted by the reason."""
    log = data.logs[robot]
    seen = log.observations
    delay = round(reading.motion_delay * NS)
    begin, end = log.commands.stamps[[0, -1]] + delay
    robots = np.isin(seen.rows[:, 0], ROBOTS)
    here = np.isin(seen.rows[:, 0], list(data.logs))
    wanted = np.ones(len(seen), dtype=bool)
    for reason, right in {
        'observation before odometry': seen.stamps >= begin,
        'observation after odometry': seen.stamps <= end,
        'observation of a robot without odometry': here | ~robots,
        'observation of a robot': ~robots | reading.robot_observations,
    }.items():
        counts[reason] += int((wanted & ~right).sum())
        wanted &= right
    seen = seen.where(wanted)
    kept = _thinned(seen, round(reading.thin * NS))
    counts['observation thinned'] += int((~kept).sum())
    return seen.where(kept)


def truth(log: RobotLog, reading: Reading) -> Series:
    """
    Return the true poses that odometry reaches; those that stand alone, at the next odometry.

    An estimate is compared with a true pose of its own stamp, or between two that are close.

    """
    stamps, poses = odometry(log, reading)
    found = log.truth.where((log.truth.stamps >= stamps[0]) & (log.truth.stamps <= stamps[-1]))
    gaps = np.diff(found.stamps, prepend=-NS, append=LAST_SECOND * NS)
    after = np.searchsorted(stamps, found.stamps).clip(1)
    wait = stamps[after] - found.stamps
    for k in np.flatnonzero((np.minimum(gaps[:-1], gaps[1:]) > MAX_GAP) & (wait <= MAX_GAP)):
        step = between(poses[after[k] - 1], poses[after[k]])
        rest = wait[k] / (stamps[after[k]] - stamps[after[k] - 1])
        found.rows[k] = compose(found.rows[k], rest * step)
        found.stamps[k] = stamps[after[k]]
    return found


def records(
    data: DataSet, reading: Reading, counts: Mapping[int, Counter[str]]
) -> Iterator[Record]:
    """
    Yield the records of all robots in the order of stamps, the true landmarks first.

    Parameters
    ----------
    data : what was measured
    reading : how it is read
    counts : of each robot, how many observations are not used, by the reason; is added to

    """
    of_robots = [_records(data, robot, reading, counts[robot]) for robot in data.logs]
    if data.landmarks:
        first = min(int(log.commands.stamps[0]) for log in data.logs.values())
        yield TrueLandmarks(data.landmarks, first)
    yield from heapq.merge(*of_robots, key=lambda record: record.stamp)


def settings(data: DataSet, reading: Reading, known_starts: bool = False) -> Settings:
    """
    Return the settings of a run in the frame of the ground truth.

    The anchor is a robot that sees landmarks, without which the others would not find their
    places: the first whose start the ground truth tells well, else the one where it is told best,
    else the first, from the origin. The others' starts are unknown, or known as well.

    """
    starts = {robot: start(log, reading) for robot, log in data.logs.items()}

    def rank(robot: int) -> tuple[bool, float]:
        found = starts[robot]
        heading_sigma = max(found[1][2], GOOD_HEADING) if found else math.inf
        return not _sees_landmarks(data, robot, reading), heading_sigma

    anchor = min(starts, key=rank)
    pose, sigma = starts[anchor] or (ORIGIN, ORIGIN)
    robots = {robot: _robot(robot, log, reading) for robot, log in data.logs.items()}
    for robot, found in starts.items():
        if known_starts and found and robot != anchor:
            robots[robot] = replace(robots[robot], start_pose=found[0], start_sigma=found[1])
    return Settings(
        tuple(robots.values()),
        anchor=robot_name(anchor), anchor_pose=pose, anchor_sigma=sigma, filter='fej',
        gate_probability=PROBABILITY, join_probability=PROBABILITY,
        join_heading_sigma=JOIN_HEADING_SIGMA, stale_after=STALE_AFTER)


def start(log: RobotLog, reading: Reading) -> tuple[Triple, Triple] | None:
    """Return a robot's pose at its first odometry and the standard deviations, if truth tells."""
    stamps, poses = odometry(log, reading)
    reached = np.searchsorted(log.truth.stamps, stamps[0])
    if reached == len(log.truth) or log.truth.stamps[reached] > stamps[0] + START_REACH:
        return None
    # Odometry carries back the first true pose since then.
    k = min(int(np.searchsorted(stamps, log.truth.stamps[reached])), len(stamps) - 1)
    back = between(poses[k], poses[0])
    pose = compose(log.truth.rows[reached], back)
    variances = increment_variances(log, reading)[:k].sum(axis=0) + np.square(TRUTH_SIGMA)
    # On the way the robot has turned, so what is ahead and what is to the left is mixed.
    variances[:2] = variances[:2].max() + variances[2] * (back[:2] @ back[:2])
    return _triple(pose), _triple(np.sqrt(variances))


def _sees_landmarks(data: DataSet, robot: int, reading: Reading) -> bool:
    seen = observations(data, robot, reading, Counter())
    return not np.isin(seen.rows[:, 0], ROBOTS).all()


def _robot(robot: int, log: RobotLog, reading: Reading) -> RobotSettings:
    """Return a robot with what its noise is in the mean; the records carry what it is in each."""
    noise, ranges = reading.noise, log.observations.rows[:, 1]
    r = float(ranges.mean()) if len(ranges) else TYPICAL_RANGE
    duration = (log.commands.stamps[-1] - log.commands.stamps[0]) / NS
    variances = increment_variances(log, reading).sum(axis=0) / duration
    return RobotSettings(
        robot_name(robot), robot, odometry_sigma=_triple(np.sqrt(variances)),
        landmark_sigma=(round(noise.range * r, 6), round(noise.bearing * r, 6)))


def _records(
    data: DataSet, robot: int, reading: Reading, counts: Counter[str]
) -> Iterator[Record]:
    log = data.logs[robot]
    seen, true = observations(data, robot, reading, counts), truth(log, reading)
    return heapq.merge(
        _odometry(robot, log, reading), _scans(robot, seen, reading.noise),
        (TruePose(robot_name(robot), int(t), pose) for t, pose in zip(true.stamps, true.rows)),
        key=lambda record: record.stamp)


def _odometry(robot: int, log: RobotLog, reading: Reading) -> Iterator[Odometry]:
    stamps, poses = odometry(log, reading)
    rates = increment_variances(log, reading) / np.square(np.diff(stamps) / NS)[:, None]
    for k, (stamp, pose) in enumerate(zip(stamps.tolist(), poses)):
        yield Odometry(robot_name(robot), stamp, pose, np.diag(rates[k - 1]) if k else None)


def _scans(robot: int, seen: Series, noise: Noise) -> Iterator[Scan | RobotScan]:
    """Yield the landmarks, and the robots, that are seen at each stamp."""
    for stamp, rows in groupby(zip(seen.stamps.tolist(), seen.rows.tolist()), lambda row: row[0]):
        landmarks, robots = [], []
        for _, (subject, r, beta) in rows:
            if subject in ROBOTS:
                z, R = polar(r, beta, noise.robot_range * r, noise.robot_bearing)
                robots.append(RobotObservation(robot_name(int(subject)), z, R))
            else:
                z, R = polar(r, beta, noise.range * r, noise.bearing)
                landmarks.append(Observation(int(subject), z, R))
        if landmarks:
            yield Scan(robot_name(robot), stamp, tuple(landmarks))
        if robots:
            yield RobotScan(robot_name(robot), stamp, tuple(robots))


def _thinned(seen: Series, period: int) -> Flags:
    """Return which rows come no sooner than a period [ns] after the last one of their subject."""
    kept = np.zeros(len(seen), dtype=bool)
    latest: dict[float, int] = {}
    for k, (stamp, subject) in enumerate(zip(seen.stamps.tolist(), seen.rows[:, 0].tolist())):
        if subject not in latest or stamp - latest[subject] >= period:
            kept[k], latest[subject] = True, stamp
    return kept


def _triple(values: Array) -> Triple:
    """Return three numbers, for people to read."""
    x, y, phi = values.round(6).tolist()
    return x, y, phi
