# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park, with and without the identities of the trees, against GPS.

Nobody knows the truth. GPS is good to a metre or two between its jumps; the association that was
published for the log names seven detections in eight.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
import time
from typing import Any

import numpy as np

from fej_slam_ros.core.consistency import mean_nis
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, rigid_fit, transform
from fej_slam_ros.core.records import GpsFix, NO_ID, Record, Scan
from fej_slam_ros.datasets.victoria_park import car, raw_log
from fej_slam_ros.datasets.victoria_park.car import CarDrive
from fej_slam_ros.datasets.victoria_park.gps import antenna_points
from fej_slam_ros.experiments.common.markdown import table
from fej_slam_ros.experiments.real_data.association_score import AssociationScore

#: The published association, beside the log.
ASSOCIATION = 'data_sensor_clean_clean.mat'

#: A fit to GPS counts what is nearer than so many medians, in so many rounds.
NEAR = 3.0
ROUNDS = 20

MEANING = """\
The anchor sets out where GPS has it over the first 50 m, which leaves a few hundredths of a radian
in the direction of the whole map: distances to GPS are given as estimated, and after one rigid fit
of all robots, as they are published of batch least squares (median 0.90 m). Fixes that their
neighbours do not bear out do not count. A match is false where most observations with its number are
of another tree by the published association; a tree is split where several landmarks stand for
it."""

TITLES = (
    'robots', 'identities', 'landmarks', 'median to GPS [m]', 'after a fit [m]', '90 % [m]',
    'NIS/2', 'matches', 'false', 'split trees', 'doubtful', 'time [s]')


@dataclass(frozen=True)
class RawParkTask:
    """
    A run.

    Attributes
    ----------
    folder : holds the raw log, and the association
    robots : how many robots the car stands for
    named : whether the association is told to the estimator; what it does not name is left out

    """

    folder: Path
    robots: int
    named: bool


@dataclass(slots=True, eq=False)
class RawParkRun:
    """
    What came of a task.

    Attributes
    ----------
    task : what was to be done
    distances : of the estimated antenna from each good fix, of all robots [m]
    fitted : the same after a rigid fit
    landmarks : how many count in the end
    nis : mean NIS of an observation, divided by 2
    matches, false : of observations without identity, as in `Matches`
    split : trees for which several landmarks stand
    doubtful : observations that were not used
    seconds : how long it took

    """

    task: RawParkTask
    distances: Array
    fitted: Array
    landmarks: int
    nis: float
    matches: int
    false: int
    split: int
    doubtful: int
    seconds: float


@dataclass(eq=False)
class GpsComparison:
    """Where a robot was at each of its steps."""

    stamps: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)


def tasks(folder: Path) -> list[RawParkTask]:
    """Return all runs on the log in a folder."""
    return [RawParkTask(folder, robots, named) for robots in sorted(car.TEAMS) for named in (True, False)]


def run(task: RawParkTask) -> RawParkRun:
    """
    Return what the estimator makes of the log.

    Raises
    ------
    UserError
        The log or the association is missing or damaged.

    """
    log = raw_log.read(task.folder)
    scans = raw_log.identified(log.scans, task.folder / ASSOCIATION)
    team = car.drives(replace(log, scans=scans), task.robots)
    estimator, matches = Estimator(car.settings(team)), AssociationScore()
    ways = {robot: GpsComparison() for robot in team}
    begin = time.perf_counter()
    for step in estimator.run(_told(team, _named if task.named else matches.unnamed)):
        matches.add(step.associated)
        for estimate in step.poses:
            ways[estimate.robot].stamps.append(estimate.stamp)
            ways[estimate.robot].poses.append(estimate.pose)
    seconds = time.perf_counter() - begin
    there, fixes = map(np.vstack, zip(*(_beside_gps(team[name], ways[name]) for name in team)))
    trees = matches.landmarks(f.id for f in estimator.landmarks() if f.id < NO_ID)
    return RawParkRun(
        task, np.hypot(*(there - fixes).T), _fitted(there, fixes), len(estimator.landmarks()),
        mean_nis(estimator.innovations.nis.values()), matches.count(), matches.false(),
        sum(count > 1 for tree, count in trees.items() if tree != NO_ID),
        sum(counts['doubtful'] for counts in estimator.landmark_manager.counts.values()), seconds)


def markdown(runs: Sequence[RawParkRun]) -> str:
    """Return the runs as a page."""
    rows = map(_row, runs)
    return '\n\n'.join([
        '# The raw log of Victoria Park', MEANING, table(TITLES, rows, words=(1,))]) + '\n'


def summary(runs: Sequence[RawParkRun]) -> list[dict[str, Any]]:
    """Return the runs in a form that JSON knows."""
    return [{
        'robots': of.task.robots, 'identities': of.task.named, 'landmarks': of.landmarks,
        'gps_median': float(np.median(of.distances)),
        'gps_median_fitted': float(np.median(of.fitted)),
        'gps_90_percent_fitted': float(np.quantile(of.fitted, 0.9)),
        'nis': of.nis, 'matches': of.matches, 'false_matches': of.false, 'split_trees': of.split,
        'doubtful': of.doubtful, 'seconds': of.seconds} for of in runs]


def _told(
    team: Mapping[str, CarDrive], scan_as_told: Callable[[Scan], Scan]
) -> Iterator[Record]:
    """Yield what an estimator gets."""
    for record in car.records(team):
        if isinstance(record, Scan):
            yield scan_as_told(record)
        elif not isinstance(record, GpsFix):
            yield record


def _named(scan: Scan) -> Scan:
    return replace(scan, observations=tuple(s for s in scan.observations if s.id != NO_ID))


def _beside_gps(drive: CarDrive, way: GpsComparison) -> tuple[Array, Array]:
    """Return where the antenna was estimated to be (g, 2) at each good fix, and the fixes."""
    fixes = drive.log.fixes
    good = ~drive.is_doubted & (fixes.stamps <= way.stamps[-1])
    there = antenna_points(fixes.stamps[good], np.array(way.stamps), np.array(way.poses))
    return there, fixes.points[good]


def _fitted(there: Array, fixes: Array) -> Array:
    """Return the distances (g,) after the rigid fit to those that it comes near."""
    near = np.ones(len(there), bool)
    for _ in range(ROUNDS):
        pose = rigid_fit(there[near], fixes[near])
        distances: Array = np.hypot(*(transform(pose, there) - fixes).T)
        near = distances <= NEAR * np.median(distances)
    return distances


def _row(of: RawParkRun) -> list[str]:
    false = f'{of.false} ({100.0 * of.false / of.matches:.2f} %)' if of.matches else '-'
    return [
        str(of.task.robots), 'published' if of.task.named else 'unknown', str(of.landmarks),
        f'{np.median(of.distances):.2f}', f'{np.median(of.fitted):.2f}',
        f'{np.quantile(of.fitted, 0.9):.2f}', f'{of.nis:.2f}', str(of.matches or '-'), false,
        '-' if of.task.named else str(of.split), str(of.doubtful), f'{of.seconds:.0f}']
