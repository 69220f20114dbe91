# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park, with and without tree IDs, compared with GPS.

There is no ground truth. GPS is accurate to one or two metres between its jumps; the published
data association has the ID of nine detections in ten.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import time
from typing import Any

import numpy as np

from fej_slam_ros.core.consistency import total_nis_per_dof
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, rigid_fit, transform
from fej_slam_ros.core.records import GpsFix, NO_ID, Record, Scan
from fej_slam_ros.datasets.victoria_park import raw_conversion, raw_log
from fej_slam_ros.datasets.victoria_park.gps import antenna_points
from fej_slam_ros.datasets.victoria_park.raw_conversion import CarDrive
from fej_slam_ros.experiments.real_data.association_score import AssociationScore
from fej_slam_ros.tables import markdown_table

#: File of the published association, in the folder of the log.
ASSOCIATION_FILE = 'data_sensor_clean_clean.mat'
#: The fit to GPS uses distances up to this multiple of the median; number of its iterations.
MAX_MEDIANS = 3.0
FIT_ITERATIONS = 20
RAW_PARK_NOTES = """\
The start of the anchor is fitted to GPS over the first 50 m, which leaves an error of a few
hundredths of a radian in the heading of the whole map: distances to GPS are given as estimated,
and after one rigid fit of all robots, as published for batch least squares (median 0.90 m). GPS
outliers are excluded. A match is false if most observations with its ID are of another tree by
the published association; a tree is split if several landmarks stand for it."""
RAW_PARK_TITLES = (
    'robots', 'identities', 'landmarks', 'median to GPS [m]', 'after a fit [m]', '90 % [m]',
    'NIS/2', 'matches', 'false', 'split trees', 'doubtful', 'time [s]')


@dataclass(frozen=True)
class RawParkTask:
    """A run."""

    folder: Path  #: Holds the raw log and the association
    robots: int  #: Number of robots that the car stands for
    has_ids: bool  #: If True, detections have the published IDs, and those without are dropped


@dataclass(slots=True, eq=False)
class RawParkRun:
    """Results of a run."""

    task: RawParkTask  #: The run
    distances: Array  #: Of the estimated antenna from each good fix, of all robots [m]
    fitted: Array  #: The same after a rigid fit
    landmarks: int  #: Number of confirmed landmarks at the end
    nis: float  #: Mean NIS of an observation, divided by 2
    #: Of observations without IDs, as in `AssociationScore`.
    matches: int
    false: int
    split: int  #: Number of trees with several landmarks
    doubtful: int  #: Number of observations with ambiguous association, which are not used
    seconds: float  #: Processing time


def tasks(folder: Path) -> list[RawParkTask]:
    """Return all runs on the log in a folder."""
    return [
        RawParkTask(folder, robots, has_ids)
        for robots in sorted(raw_conversion.RAW_TEAMS) for has_ids in (True, False)]


def run(task: RawParkTask) -> RawParkRun:
    """Run the estimator on the log and evaluate it."""
    log = raw_log.read(task.folder)
    trees = raw_log.with_ids(log.trees, task.folder / ASSOCIATION_FILE)
    team = raw_conversion.drives(replace(log, trees=trees), task.robots)
    estimator, score = Estimator(raw_conversion.settings(team)), AssociationScore()
    estimates: defaultdict[str, list[PoseEstimate]] = defaultdict(list)
    begin = time.perf_counter()
    for step in estimator.run(_records(team, _known if task.has_ids else score.without_ids)):
        score.add(step.associated)
        for estimate in step.poses:
            estimates[estimate.robot].append(estimate)
    seconds = time.perf_counter() - begin
    antenna, fixes = map(
        np.vstack, zip(*(_beside_gps(drive, estimates[name]) for name, drive in team.items())))
    landmarks = estimator.landmarks()
    landmarks_of = score.landmarks(f.id for f in landmarks if f.id < NO_ID)
    return RawParkRun(
        task, np.hypot(*(antenna - fixes).T), _fitted(antenna, fixes), len(landmarks),
        total_nis_per_dof(estimator.innovations.nis.values()), score.count(), score.false(),
        sum(count > 1 for tree, count in landmarks_of.items() if tree != NO_ID),
        sum(counts['doubtful'] for counts in estimator.landmark_manager.counts.values()), seconds)


def markdown(runs: Sequence[RawParkRun]) -> str:
    """Return the runs as a page."""
    table = markdown_table(RAW_PARK_TITLES, map(_row, runs), (1,))
    return f'# The raw log of Victoria Park\n\n{RAW_PARK_NOTES}\n\n{table}\n'


def summary(runs: Sequence[RawParkRun]) -> list[dict[str, Any]]:
    """Return the runs for a JSON file."""
    return [{
        'robots': result.task.robots, 'identities': result.task.has_ids,
        'landmarks': result.landmarks,
        'gps_median': float(np.median(result.distances)),
        'gps_median_fitted': float(np.median(result.fitted)),
        'gps_90_percent_fitted': float(np.quantile(result.fitted, 0.9)),
        'nis': result.nis, 'matches': result.matches, 'false_matches': result.false,
        'split_trees': result.split, 'doubtful': result.doubtful, 'seconds': result.seconds}
        for result in runs]


def _records(
    team: Mapping[str, CarDrive], prepared: Callable[[Scan], Scan]
) -> Iterator[Record]:
    """Yield odometry and prepared scans; GPS is for evaluation only."""
    for record in raw_conversion.records(team):
        if isinstance(record, Scan):
            yield prepared(record)
        elif not isinstance(record, GpsFix):
            yield record


def _known(scan: Scan) -> Scan:
    return replace(scan, observations=tuple(s for s in scan.observations if s.id != NO_ID))


def _beside_gps(drive: CarDrive, estimates: Sequence[PoseEstimate]) -> tuple[Array, Array]:
    """Return the estimated antenna positions (g, 2) at each good fix, and the fixes."""
    stamps, fixes = np.array([estimate.stamp for estimate in estimates]), drive.log.fixes
    good = ~drive.is_outlier & (fixes.stamps <= stamps[-1])
    poses = np.array([estimate.pose for estimate in estimates])
    return antenna_points(fixes.stamps[good], stamps, poses), fixes.rows[good]


def _fitted(antenna: Array, fixes: Array) -> Array:
    """Return the distances (g,) after a rigid fit to the fixes that are near."""
    near = np.ones(len(antenna), bool)
    for _ in range(FIT_ITERATIONS):
        pose = rigid_fit(antenna[near], fixes[near])
        distances: Array = np.hypot(*(transform(pose, antenna) - fixes).T)
        near = distances <= MAX_MEDIANS * np.median(distances)
    return distances


def _row(result: RawParkRun) -> list[str]:
    false = '-'
    if result.matches:
        false = f'{result.false} ({100.0 * result.false / result.matches:.2f} %)'
    return [
        str(result.task.robots), 'published' if result.task.has_ids else 'unknown',
        str(result.landmarks),
        f'{np.median(result.distances):.2f}', f'{np.median(result.fitted):.2f}',
        f'{np.quantile(result.fitted, 0.9):.2f}', f'{result.nis:.2f}',
        str(result.matches or '-'), false, '-' if result.task.has_ids else str(result.split),
        str(result.doubtful), f'{result.seconds:.0f}']
