# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of an MRCLAM set as records.

Commands become odometry by exact arcs, each in force until the next. A range and a bearing become
a Cartesian observation; the rows of one stamp are one scan.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
import heapq
from itertools import groupby, repeat

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Flags, Stamps
from fej_slam_ros.core.ground_truth import MAX_GAP
from fej_slam_ros.core.motion_models import arc_poses, polar
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, Record, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.datasets.file_checks import LAST_SECOND
from fej_slam_ros.datasets.mrclam.conversion_options import (
    bearing_offset, ConversionOptions, Noise)
from fej_slam_ros.datasets.mrclam.files import MrclamSet, ROBOT_SUBJECTS, RobotLog
from fej_slam_ros.datasets.series import Series

#: Variance per second of an increment (x, y, phi) of a robot at rest [m^2/s, m^2/s, rad^2/s].
STANDSTILL_VARIANCE = np.array([1e-6, 1e-6, 1e-6])
#: Commands are trusted for up to this time [ns]; in a longer gap a robot may have moved with its
#: highest speeds.
MAX_COMMAND_HOLD = 2 * NS
#: Time [ns] without commands that may be missing where a clock was set.
CLOCK_CHANGE_TIME = NS // 2
#: Turn rate [rad/s] above which a robot is slowed down no further; set 6 has none.
MAX_SLOWING_RATE = 0.41


def robot_name(robot: int) -> str:
    """Return the name of a robot, by its subject."""
    return f'r{robot}'


def odometry_stamps(log: RobotLog, options: ConversionOptions) -> Stamps:
    """Return the stamps (n,) of odometry [ns]: those of the motion that commands lead to."""
    return log.commands.stamps + round(options.motion_delay * NS)


def speeds(commands: Array, options: ConversionOptions) -> Array:
    """Return to what commands (n, 2) lead, ahead [m/s] and turning [rad/s], (n, 2)."""
    v, w = commands.T
    ahead, turning = options.odometry_scale
    return np.column_stack([v * (ahead - options.slowdown * slowing_rates(w)), w * turning])


def slowing_rates(turn_rates: Array) -> Array:
    """Return the part of commanded turn rates (n,) that slows a robot down [rad/s]."""
    return np.minimum(np.abs(turn_rates), MAX_SLOWING_RATE)


def odometry(log: RobotLog, options: ConversionOptions) -> tuple[Stamps, Array]:
    """Return stamps (n,) [ns] and poses (n, 3) in the frame of the first of them."""
    stamps = odometry_stamps(log, options)
    dt = np.diff(stamps) / NS
    v, w = speeds(log.commands.rows[:-1], options).T
    per_metre, per_radian = options.own_turns.get(log.robot, (0.0, 0.0))
    return stamps, arc_poses(v * dt, (w + per_metre * v + per_radian * w) * dt)


def increment_variances(log: RobotLog, options: ConversionOptions) -> Array:
    """Return the variances (n - 1, 3) of the increments (x, y, phi) of odometry [m^2, rad^2]."""
    dt = np.diff(log.commands.stamps)[:, None] / NS
    commanded, noise = np.abs(log.commands.rows), options.noise
    rates = commanded[:-1] @ np.array([noise.position, (0.0, 0.0), noise.heading]).T
    variances: Array = dt * (STANDSTILL_VARIANCE + rates)
    unknown, at_change = unknown_motion(log), _at_clock_change(log)
    unknown_time = dt[unknown] + at_change[unknown, None] * CLOCK_CHANGE_TIME / NS
    v, w = commanded.max(axis=0)
    variances[unknown] += np.square(unknown_time * [v, v, w])
    return variances


def unknown_motion(log: RobotLog) -> Flags:
    """Return between which commands (n - 1,) motion is unknown: in long gaps, at set clocks."""
    return (np.diff(log.commands.stamps) > MAX_COMMAND_HOLD) | _at_clock_change(log)


def _at_clock_change(log: RobotLog) -> Flags:
    return np.isin(log.commands.stamps[1:], log.clock_changes)


def sums_between(edges: Stamps, stamps: Stamps, amounts: Array) -> Array:
    """Return the sums (n - 1, c) between n edges of amounts (m - 1, c) between m stamps."""
    sums = np.vstack([np.zeros(amounts.shape[1]), np.cumsum(amounts, axis=0)])
    at_edges = np.column_stack([np.interp(edges, stamps, column) for column in sums.T])
    return np.diff(at_edges, axis=0)


def observations(
    data: MrclamSet, robot: int, options: ConversionOptions, counts: Counter[str]
) -> Series:
    """Return a robot's observations that are used; the others are counted by reason."""
    log = data.logs[robot]
    rows = _corrected(log.observations, robot, options)
    begin, end = odometry_stamps(log, options)[[0, -1]]
    robots = np.isin(rows.rows[:, 0], ROBOT_SUBJECTS)
    has_log = np.isin(rows.rows[:, 0], list(data.logs))
    wanted = np.ones(len(rows), dtype=bool)
    for reason, accepted in {
        'observation before odometry': rows.stamps >= begin,
        'observation after odometry': rows.stamps <= end,
        'observation of a robot without odometry': has_log | ~robots,
        'observation of a robot': ~robots | options.robot_observations,
        'range below the error of the camera': rows.rows[:, 1] > 0.0,
    }.items():
        counts[reason] += int((wanted & ~accepted).sum())
        wanted &= accepted
    rows = rows[wanted]
    kept = _thinned(rows, round(options.thin * NS))
    counts['observation thinned'] += int((~kept).sum())
    return rows[kept]


def _corrected(observed: Series, robot: int, options: ConversionOptions) -> Series:
    """
    Return observations, at the stamps of their images, without the errors of a camera.

    Ranges are increased by `range_increases`.

    """
    observed = observed.shifted(-round(options.camera_delay * NS))
    subjects, r, beta = observed.rows.T
    offset, per_metre = options.range_errors.get(robot, (0.0, 0.0))
    of_landmarks, of_robots = options.range_increases
    increases = np.where(np.isin(subjects, ROBOT_SUBJECTS), of_robots, of_landmarks)
    return Series(observed.stamps, np.column_stack([
        subjects, (1.0 + increases) * (r - offset) / (1.0 + per_metre),
        beta - bearing_offset(robot, options)[0]]))


def truth(log: RobotLog, options: ConversionOptions) -> Series:
    """
    Return the true poses within the odometry; isolated ones are moved to the next odometry stamp.

    An estimate is compared with a true pose at its own stamp, or interpolated between two that
    are close in time.
    """
    stamps, poses = odometry(log, options)
    within = log.truth.between(stamps[0], stamps[-1])
    gaps = np.diff(within.stamps, prepend=-NS, append=LAST_SECOND * NS)
    after = np.searchsorted(stamps, within.stamps).clip(1)
    wait = stamps[after] - within.stamps
    for k in np.flatnonzero((np.minimum(gaps[:-1], gaps[1:]) > MAX_GAP) & (wait <= MAX_GAP)):
        increment = between(poses[after[k] - 1], poses[after[k]])
        fraction = wait[k] / (stamps[after[k]] - stamps[after[k] - 1])
        within.rows[k] = compose(within.rows[k], fraction * increment)
        within.stamps[k] = stamps[after[k]]
    return within


def records(
    data: MrclamSet, options: ConversionOptions, counts: Mapping[int, Counter[str]]
) -> Iterator[Record]:
    """
    Yield the records of all robots in the order of stamps, the true landmarks first.

    The observations that are dropped are added to the counts of each robot, by reason.
    """
    streams: list[Iterable[Record]] = []
    for robot, log in data.logs.items():
        observed, true = observations(data, robot, options, counts[robot]), truth(log, options)
        streams += [
            _odometry(robot, log, options), _scans(robot, observed, options.observation_noise()),
            map(TruePose, repeat(robot_name(robot)), true.stamps.tolist(), true.rows)]
    if data.landmarks:
        first = min(int(log.commands.stamps[0]) for log in data.logs.values())
        yield TrueLandmarks(data.landmarks, first)
    yield from heapq.merge(*streams, key=lambda record: record.stamp)


def _odometry(robot: int, log: RobotLog, options: ConversionOptions) -> Iterator[Odometry]:
    stamps, poses = odometry(log, options)
    rates = increment_variances(log, options) / np.square(np.diff(stamps) / NS)[:, None]
    for k, (stamp, pose) in enumerate(zip(stamps.tolist(), poses)):
        yield Odometry(robot_name(robot), stamp, pose, np.diag(rates[k - 1]) if k else None)


def _scans(robot: int, observed: Series, noise: Noise) -> Iterator[Scan | RobotScan]:
    """Yield the landmark scan and the robot scan at each stamp, where they are not empty."""
    at_stamps = groupby(zip(observed.stamps.tolist(), observed.rows.tolist()), lambda row: row[0])
    for stamp, rows in at_stamps:
        landmarks, robots = [], []
        for _, (subject, r, beta) in rows:
            if subject in ROBOT_SUBJECTS:
                z, R = polar(r, beta, *noise.robots.at(r))
                robots.append(RobotObservation(robot_name(int(subject)), z, R))
            else:
                z, R = polar(r, beta, *noise.landmarks.at(r))
                landmarks.append(Observation(int(subject), z, R))
        if landmarks:
            yield Scan(robot_name(robot), stamp, tuple(landmarks))
        if robots:
            yield RobotScan(robot_name(robot), stamp, tuple(robots))


def _thinned(observed: Series, period: int) -> Flags:
    """Return which rows are at least a period [ns] after the last kept one of their subject."""
    kept = np.zeros(len(observed), dtype=bool)
    latest: dict[float, int] = {}
    for k, (stamp, subject) in enumerate(
            zip(observed.stamps.tolist(), observed.rows[:, 0].tolist())):
        if subject not in latest or stamp - latest[subject] >= period:
            kept[k], latest[subject] = True, stamp
    return kept
