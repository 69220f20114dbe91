# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
By which factors the claimed noise is wrong, from errors against ground truth.

Errors of odometry are those of its way over a window: what wheels and gyros get wrong lasts longer
than a message, so that single increments would tell too small a factor.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from scipy.special import chdtr, chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.consistency import is_definite, nees, pose_error
from fej_slam_ros.core.geometry import Array, between
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.robot_queue import increment
from fej_slam_ros.core.records import (
    NS, Odometry, Record, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import Settings, Triple

#: What has noise, as in the parameters ``<kind>_noise_scale``, and degrees of freedom of an error.
DOF = {'odometry': 3, 'landmark': 2, 'robot': 2}

#: The way over so long a time [ns] is compared.
WINDOW = 5 * NS

#: Errors that noise exceeds with this probability are gross, and left out. The limit of a gate
#: would cut the tails that noise has in the field, and the factors with them.
GROSS = 1e-6

#: Up to these standard errors, relative to the factor, that of a team is worth being believed, and
#: that of a robot to be told from the team's.
MAX_RELATIVE_ERROR = 0.15
MAX_OWN_ERROR = 0.05


@dataclass(frozen=True, slots=True)
class Factor:
    """
    A factor on standard deviations.

    Attributes
    ----------
    scale : the factor
    relative_error : standard error of its logarithm, if errors are independent
    samples : how many errors or innovations tell it

    """

    scale: float
    relative_error: float
    samples: int

    def is_known(self) -> bool:
        """Return whether there was enough data."""
        return self.relative_error <= MAX_RELATIVE_ERROR


#: Squared normalised errors of one kind, of each robot.
Errors = Mapping[str, Sequence[float]]


def factor(squared: Sequence[float], dof: int) -> Factor:
    """
    Return the root mean normalised squared error per degree of freedom, without gross errors.

    What is left out is found from the median on, and the mean of the others is that of chi-square
    below the same limit.

    Parameters
    ----------
    squared : e^T P^-1 e of each error
    dof : of one of them

    """
    d2 = np.array(squared)
    limit = chdtri(dof, GROSS)
    below = dof * chdtr(dof + 2, limit) / chdtr(dof, limit)
    variance, kept = float(np.median(d2)) / chdtri(dof, 0.5), 0
    while (count := int((d2 <= limit * variance).sum())) > kept:
        variance, kept = float(d2[d2 <= limit * variance].mean()) / below, count
    return Factor(math.sqrt(variance), 1.0 / math.sqrt(2 * dof * len(d2)), len(d2))


def factors(errors: Errors, dof: int) -> dict[str, Factor]:
    """Return the factor of all robots as that of '', and of each that has data enough."""
    own = {robot: factor(squared, dof) for robot, squared in errors.items() if squared}
    pooled = factor([d2 for squared in errors.values() for d2 in squared], dof)
    return {'': pooled} | {
        robot: found for robot, found in own.items() if found.relative_error <= MAX_OWN_ERROR}


def against_truth(records: Iterable[Record], settings: Settings) -> dict[str, Errors]:
    """
    Return the errors of each kind of which there is ground truth, normalised by what is claimed.

    Parameters
    ----------
    records : what was measured, and the ground truth
    settings : tells the noise where none is claimed; its noise scales are not looked at

    """
    records = list(records)
    truth = RecordedTruth()
    for record in records:
        if isinstance(record, (TruePose, TrueLandmarks)):
            truth.add(record)
    if not settings.shared_landmark_ids:
        # Nobody knows whose numbers the true landmarks have.
        truth.landmarks.clear()
    errors: dict[str, dict[str, list[float]]] = {kind: {} for kind in DOF}
    for robot in settings.robots:
        own = [r for r in records if isinstance(r, Odometry) and r.robot == robot.name]
        way = sorted(own, key=lambda odometry: odometry.stamp)
        errors['odometry'][robot.name] = [*_ways(way, truth, robot.odometry_sigma)]
        errors['landmark'][robot.name] = []
        errors['robot'][robot.name] = []
    for scan in records:
        if isinstance(scan, (Scan, RobotScan)) and scan.robot in errors['landmark']:
            kind = 'robot' if isinstance(scan, RobotScan) else 'landmark'
            errors[kind][scan.robot] += _observations(scan, truth)
    return {kind: of for kind, of in errors.items() if any(of.values())}


def _ways(way: Sequence[Odometry], truth: RecordedTruth, sigma: Triple) -> Iterator[float]:
    """Yield the squared normalised error of each window."""
    begin, P = None, np.zeros((3, 3))
    for earlier, later in pairwise(way):
        begin = begin or earlier
        x = between(begin.pose, earlier.pose)
        u, Q = increment(earlier, later, sigma)
        G = models.G(x[2])
        Phi = models.Phi(G[:2, :2] @ u[:2])
        P = Phi @ P @ Phi.T + G @ Q @ G.T
        if later.stamp - begin.stamp >= WINDOW:
            known = all(truth.covers(end.robot, end.stamp) for end in (begin, later))
            if known and is_definite(P):
                true = between(*(truth.pose(end.robot, end.stamp) for end in (begin, later)))
                error = pose_error(between(begin.pose, later.pose), true)
                yield 3.0 * float(nees(error, P))
            begin, P = later, np.zeros((3, 3))


def _observations(scan: Scan | RobotScan, truth: RecordedTruth) -> Iterator[float]:
    """Yield the squared normalised error of each observation of something whose place is known."""
    if truth.covers(scan.robot, scan.stamp):
        pose = truth.pose(scan.robot, scan.stamp)
        for z, R, point in _seen(scan, truth):
            yield 2.0 * float(nees(z - models.h(pose[None], point[None])[0], R))


def _seen(
    scan: Scan | RobotScan, truth: RecordedTruth
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield z, R and the true point of each observation."""
    if isinstance(scan, Scan):
        for landmark in scan.observations:
            if landmark.id in truth.landmarks:
                yield landmark.z, landmark.R, truth.landmarks[landmark.id]
    else:
        for robot in scan.observations:
            if truth.covers(robot.seen, scan.stamp):
                yield robot.z, robot.R, truth.pose(robot.seen, scan.stamp)[:2]
