# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Constructors of teams and records; times in ms."""

from dataclasses import replace

import numpy as np

from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.records import (
    NO_ID, Observation, Odometry, RobotObservation, RobotScan, Scan, TruePose)
from fej_slam_ros.core.settings import RobotSettings, Settings

#: A millisecond in ns, and a nanosecond in ms.
MS = 1_000_000
A_NANOSECOND = 1e-6
#: A covariance in which no two entries are alike, and C^T Q C for a quarter turn to the left,
#: which takes (x, y) to (y, -x).
Q = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.25], [0.5, 0.25, 1.0]])
Q_TURNED = np.array([[2.0, -1.0, 0.25], [-1.0, 4.0, -0.5], [0.25, -0.5, 1.0]])


def team(*names, known=(), **changes):
    """Return settings of a team: by default r1, the anchor, and r2; some with an initial pose."""
    starts = {name: {'start_pose': x, 'start_sigma': sigma} for name, x, sigma in known}
    robots = tuple(
        RobotSettings(name, number, **starts.get(name, {}))
        for number, name in enumerate(names or ('r1', 'r2'), start=1))
    return Settings(robots, **{'anchor': robots[0].name, **changes})


def odometry(robot, ms, pose=None, twist_covariance=None):
    """Return odometry; without a pose, of a robot that drives straight ahead at 1 m/s."""
    x = np.array([ms / 1000.0, 0.0, 0.0] if pose is None else pose, dtype=float)
    return Odometry(robot, round(ms * MS), x, twist_covariance)


def scan(robot, ms, seen=()):
    """Return a scan of landmarks, given as (ID, (x, y)), with 0.1 m on each axis."""
    return Scan(robot, round(ms * MS), tuple(
        Observation(number, np.array(z, dtype=float), 0.01 * np.eye(2)) for number, z in seen))


def robot_scan(robot, ms, seen=()):
    """Return a scan of other robots, given as (name, (x, y)), with 0.1 m on each axis."""
    return RobotScan(robot, round(ms * MS), tuple(
        RobotObservation(name, np.array(z, dtype=float), 0.01 * np.eye(2)) for name, z in seen))


def true_pose(robot, ms, pose):
    """Return the ground truth of a pose."""
    return TruePose(robot, round(ms * MS), np.array(pose, dtype=float))


def without_ids(records):
    """Return records in which no observation of a landmark has an ID."""
    return [
        replace(r, observations=tuple(replace(s, id=NO_ID) for s in r.observations))
        if isinstance(r, Scan) else r for r in records]


def claiming(records, factors):
    """Return records whose stated standard deviations are scaled by the factor of their type."""
    return [with_scaled_noise(factors.get(type(record), 1.0), record) for record in records]


def with_scaled_noise(factor, record):
    """Return odometry or a scan with all its stated standard deviations scaled."""
    if isinstance(record, Odometry) and record.twist_covariance is not None:
        return replace(record, twist_covariance=factor**2 * record.twist_covariance)
    if isinstance(record, (Scan, RobotScan)):
        return replace(record, observations=tuple(
            replace(observation, R=factor**2 * observation.R)
            for observation in record.observations))
    return record


def sequencer_of(*names, **changes):
    """Return the sequencer of a team, and its statistics."""
    statistics = InputStatistics()
    return Sequencer(team(*names, **changes), statistics), statistics


def fed(sequencer, *records):
    """Add records one by one; return the steps released meanwhile."""
    steps = []
    for record in records:
        sequencer.add(record, None)
        steps += sequencer.take()
    return steps


def all_steps(sequencer, *records):
    """Add records one by one; return all steps."""
    return [*fed(sequencer, *records), *sequencer.release()]
