# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings of a run on an MRCLAM set, in the frame of its ground truth.

The anchor is the robot whose start and observations determine the heading of that frame best.
"""

from collections import Counter
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import (
    Array, compose, motion_to_begin, poses_at, Stamps, wrap)
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import ORIGIN, RobotSettings, Settings, Triple
from fej_slam_ros.datasets.mrclam.conversion import (
    increment_variances, observations, odometry, odometry_stamps, robot_name, sums_between)
from fej_slam_ros.datasets.mrclam.conversion_options import bearing_offset, ConversionOptions
from fej_slam_ros.datasets.mrclam.files import MrclamSet, ROBOT_SUBJECTS, RobotLog
from fej_slam_ros.datasets.mrclam.motion_capture import truth_sigma
from fej_slam_ros.datasets.series import Series

#: The estimator waits for robots over gaps in which commands are trusted [s].
STALE_AFTER = 2.5
#: Probability of gates and joining: errors that persist make these tests fail more often than
#: chi-square predicts, and wrong data are far beyond either threshold.
GATE_PROBABILITY = 0.99999
#: Standard deviation of the heading at which a robot joins by landmarks only [rad]: for the same
#: reason a few observations carry less information than their covariances state.
LANDMARKS_HEADING_SIGMA = 0.05
#: Maximum time [ns] from a robot's first odometry to the true pose from which its start is
#: computed.
MAX_START_DELAY = 300 * NS
#: Standard deviation of the heading at its start [rad] above which the anchor begins at its first
#: true pose instead.
GOOD_HEADING_SIGMA = 0.05
#: Time [ns] from the first observation of a landmark in which bearings determine the frame.
FRAME_TIME = 10 * NS
#: Angle [rad], and standard deviations, by which odometry of an anchor may turn away from its true
#: heading by then.
MAX_FRAME_TURN, MAX_FRAME_SIGMAS = 0.1, 2.0
#: Range [m] at which the noise of a robot without observations is stated.
TYPICAL_RANGE = 3.5
#: Longest time [ns] that the other robots wait, each in its own frame, for that which determines
#: the frame best.
MAX_WAIT = 60 * NS
#: A pose and its standard deviations.
Start = tuple[Triple, Triple]


class _Frame(NamedTuple):
    """The frame of the ground truth as the start of a robot and its landmarks define it."""

    is_empty: bool  #: whether the robot observes no landmark
    begins_at_truth: bool  #: whether it begins at its first true pose, as its start is uncertain
    has_turned: bool = False  #: whether its odometry turns away from its true heading at first
    begin: float = math.inf  #: stamp of its first landmark [ns]
    #: variance of its heading [rad^2]: of the start, of odometry until landmarks are observed, of
    #: their bearings and of the angle of the camera
    variance: float = math.inf


def settings(
    data: MrclamSet, options: ConversionOptions, known_starts: bool = False
) -> Settings:
    """
    Return the settings of a run in the frame of the ground truth.

    The anchor starts at the origin if there is no ground truth in its first five minutes. The
    starts of the other robots are unknown, or taken from the ground truth as well.
    """
    starts, anchor = _starts_and_anchor(data, options)
    pose, sigma = starts[anchor] or (ORIGIN, ORIGIN)
    if starts[anchor]:
        # The frame turns with what the camera of the anchor observes.
        sigma = (*sigma[:2], round(math.hypot(sigma[2], bearing_offset(anchor, options)[1]), 6))
    robots = {robot: _robot(robot, log, options) for robot, log in data.logs.items()}
    for robot, known in starts.items():
        if known_starts and known and robot != anchor:
            robots[robot] = replace(robots[robot], start_pose=known[0], start_sigma=known[1])
    return Settings(
        tuple(robots.values()),
        anchor=robot_name(anchor), anchor_pose=pose, anchor_sigma=sigma, filter='fej',
        gate_probability=GATE_PROBABILITY, join_probability=GATE_PROBABILITY,
        join_heading_sigma=(
            Settings.join_heading_sigma if options.robot_observations
            else LANDMARKS_HEADING_SIGMA),
        stale_after=STALE_AFTER)


def start(log: RobotLog, options: ConversionOptions) -> Start | None:
    """Return a robot's true pose at its first odometry and its sigmas, None if not known."""
    stamps, poses = odometry(log, options)
    first = np.searchsorted(log.truth.stamps, stamps[0])
    if first == len(log.truth) or log.truth.stamps[first] > stamps[0] + MAX_START_DELAY:
        return None
    # Odometry leads back from the first true pose since then.
    k = min(int(np.searchsorted(stamps, log.truth.stamps[first])), len(stamps) - 1)
    back = motion_to_begin(log.truth.stamps[first], stamps, poses)
    pose = compose(log.truth.rows[first], back)
    variances = increment_variances(log, options)[:k].sum(axis=0) + np.square(
        truth_sigma(log.truth))
    # The robot has turned meanwhile, which mixes errors ahead and to the left.
    variances[:2] = variances[:2].max() + variances[2] * (back[:2] @ back[:2])
    return _triple(pose), _triple(np.sqrt(variances))


def with_known_anchor(data: MrclamSet, options: ConversionOptions) -> MrclamSet:
    """
    Return a set in which the frame of the ground truth is known.

    Where odometry between the anchor's start and its first true pose has lost its heading, the
    anchor begins at that true pose; its earlier commands are counted.
    """
    starts, anchor = _starts_and_anchor(data, options)
    log, known = data.logs[anchor], starts[anchor]
    if known is None or known[1][2] <= GOOD_HEADING_SIGMA:
        return data
    stamps = odometry_stamps(log, options)
    first = np.searchsorted(log.truth.stamps, stamps[0])
    # The last command before it: its motion leads to the true pose.
    begin = np.searchsorted(stamps, log.truth.stamps[first], 'right') - 1
    counts = log.counts + Counter({'command before the first true pose': int(begin)})
    kept = replace(log, commands=log.commands[begin:], counts=counts)
    return replace(data, logs={**data.logs, anchor: kept})


def _starts_and_anchor(
    data: MrclamSet, options: ConversionOptions
) -> tuple[dict[int, Start | None], int]:
    """
    Return the start of each robot, and the robot that determines the heading of the frame best.

    The latter observes landmarks, without which the others cannot join. If possible, its start is
    known well enough to keep all of its log, its odometry agrees with its true heading then, and
    the others need not wait for it.
    """
    starts = {robot: start(log, options) for robot, log in data.logs.items()}
    frames = {
        robot: _frame(data.logs[robot], known, _landmarks_by(data, robot, options), options)
        for robot, known in starts.items()}
    earliest = min(frame.begin for frame in frames.values())

    def rank(robot: int) -> tuple[bool, bool, bool, bool, float]:
        frame = frames[robot]
        return (
            frame.is_empty, frame.begins_at_truth, frame.has_turned,
            frame.begin > earliest + MAX_WAIT, frame.variance)

    return starts, min(starts, key=rank)


def _landmarks_by(data: MrclamSet, robot: int, options: ConversionOptions) -> Series:
    """Return the observations of landmarks by a robot."""
    rows = observations(data, robot, options, Counter())
    return rows[~np.isin(rows.rows[:, 0], ROBOT_SUBJECTS)]


def _frame(
    log: RobotLog, known: Start | None, of_landmarks: Series, options: ConversionOptions
) -> _Frame:
    """Return how well the start of a robot, if it is known, defines a frame."""
    sigma = known[1][2] if known else math.inf
    frame = _Frame(len(of_landmarks) == 0, sigma > GOOD_HEADING_SIGMA)
    if known is None or frame.is_empty:
        return frame
    begin = odometry_stamps(log, options)[0]
    if frame.begins_at_truth:
        begin = log.truth.stamps[np.searchsorted(log.truth.stamps, begin)]
        sigma = float(truth_sigma(log.truth)[2])
    seen = of_landmarks.stamps[of_landmarks.stamps >= begin]
    if len(seen):
        variance = sigma ** 2 + _heading_variance(log, begin, seen, options)
        frame = frame._replace(begin=seen[0], variance=variance)
    return frame._replace(
        has_turned=_has_turned(log, of_landmarks.stamps[0] + FRAME_TIME, options))


def _heading_variance(
    log: RobotLog, begin: int, seen: Stamps, options: ConversionOptions
) -> float:
    """Return the variance [rad^2] of the frame of a robot that was known at its begin [ns]."""
    count = np.searchsorted(seen, seen[0] + FRAME_TIME, 'right')
    first, after = np.searchsorted(odometry_stamps(log, options), (begin, seen[0]))
    driven = float(increment_variances(log, options)[first:after, 2].sum())
    bearing = options.observation_noise().landmarks.bearing
    of_camera = bearing ** 2 / count + bearing_offset(log.robot, options)[1] ** 2
    return float(driven + of_camera)


def _has_turned(log: RobotLog, end: int, options: ConversionOptions) -> bool:
    """Return whether odometry turns away from the true headings up to a stamp [ns]."""
    stamps, poses = odometry(log, options)
    true = log.truth.between(int(stamps[0]), min(end, int(stamps[-1])))
    if not len(true):
        return False
    ends = true.stamps[[0, -1]]
    (turned,) = np.diff(true.rows[[0, -1], 2] - poses_at(ends, stamps, poses)[:, 2])
    ((variance,),) = sums_between(ends, stamps, increment_variances(log, options)[:, 2:])
    sigma = math.sqrt(variance + 2.0 * truth_sigma(log.truth)[2] ** 2)
    return abs(wrap(turned)) > min(MAX_FRAME_TURN, MAX_FRAME_SIGMAS * sigma)


def _robot(robot: int, log: RobotLog, options: ConversionOptions) -> RobotSettings:
    """Return a robot with its mean noise; each record carries its own."""
    noise, ranges = options.observation_noise(), log.observations.rows[:, 1]
    r = float(ranges.mean()) if len(ranges) else TYPICAL_RANGE
    duration = (log.commands.stamps[-1] - log.commands.stamps[0]) / NS
    variances = increment_variances(log, options).sum(axis=0) / duration
    of_range, of_bearing = noise.landmarks.at(r)
    return RobotSettings(
        robot_name(robot), robot, odometry_sigma=_triple(np.sqrt(variances)),
        landmark_sigma=(round(of_range, 6), round(of_bearing * r, 6)))


def _triple(values: Array) -> Triple:
    """Return three numbers, rounded for a parameter file."""
    x, y, phi = values.round(6).tolist()
    return x, y, phi
