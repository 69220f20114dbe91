# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert CSV tables of your own data, or of `export csv`.

Files: odometry.csv with robot, stamp_ns, x, y, yaw; landmarks.csv with robot, stamp_ns, id, x, y,
var_x, cov_xy, var_y; optional robots.csv, ground_truth.csv and ground_truth_landmarks.csv. Instead
of stamp_ns: time [s]; instead of x to var_y: range, bearing, sigma_range, sigma_bearing.
docs/data.md has all columns.
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from fej_slam_ros.cli.converters.common import add_paths, write
from fej_slam_ros.core.ordering.coarse_stamps import coarse_step
from fej_slam_ros.core.records import NS, Odometry, Record, RobotScan, Scan, TruePose
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets import csv_tables
from fej_slam_ros.datasets.csv_stamps import contradicted

SUMMARY = 'CSV tables of any robots'


def add_arguments(parser: ArgumentParser) -> None:
    add_paths(parser, source='folder of the tables')


def convert(arguments: Namespace) -> None:
    """Write the bag and print the number of its records."""
    repeated: Counter[str] = Counter()
    records = csv_tables.read(arguments.input, repeated)
    settings = csv_tables.settings(records)
    write(records, settings, arguments, _report(records, settings, repeated))


def _report(
    records: Iterable[Record], settings: Settings, repeated: Counter[str]
) -> Iterator[str]:
    kinds = {Odometry: 'odometry', Scan: 'scans', RobotScan: 'robot scans', TruePose: 'true poses'}
    counts = Counter(
        (record.robot, kinds[type(record)]) for record in records
        if isinstance(record, (Odometry, Scan, RobotScan, TruePose)))
    for robot in sorted({robot for robot, _ in counts}):
        yield f'{robot}: ' + ', '.join(
            f'{kind}: {counts[robot, kind]}' for kind in kinds.values() if counts[robot, kind])
        odometry = [r for r in records if isinstance(r, Odometry) and r.robot == robot]
        step = coarse_step(
            np.array([record.stamp for record in odometry]),
            np.array([record.pose[:2] for record in odometry]).reshape(-1, 2))
        if step is not None:
            yield (
                f'    stamps of odometry are in steps of {step / NS:g} s and have several poses'
                ' each, of which only the first is used: export the time with all its digits')
        elif stamps := contradicted(odometry):
            yield (
                f'    rows of odometry with the stamp and not the pose of another: {len(stamps)},'
                f' the first at stamp_ns {stamps[0]}: the clock was set back, or they are wrong;'
                ' only the first row of a stamp is used')
    x, y, phi = settings.anchor_pose
    yield f'start of {settings.anchor}, the anchor: ({x:.3f} m, {y:.3f} m, {phi:.3f} rad) in map'
    for name, count in repeated.items():
        if count:
            yield f'rows of {name} that repeat another of their stamp, and are left out: {count}'
