# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the speed of the filter beside this machine's own limits and others, and of the smoother.

One BLAS thread, and but for Monte Carlo runs one process. The limits are measured before, after
and between; a run in which they drift apart says nothing and fails. docs/BENCHMARK.md tells what
is measured, and what is not comparable.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from fej_slam_ros.atomic_files import refuse_existing, write_json
from fej_slam_ros.benchmark import run_speed
from fej_slam_ros.benchmark.latency import live_time, LiveTime
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.benchmark.machine import (
    drift, fastest, Machine, MAX_DRIFT, measure_machine, versions)
from fej_slam_ros.benchmark.peers import LANDMARKS, Peer, peer_times, PeerTime
from fej_slam_ros.benchmark.soak import Minute, soak
from fej_slam_ros.benchmark.step_speed import SIZES, step_time, STEPS
from fej_slam_ros.benchmark.tables import report
from fej_slam_ros.cli.arguments import at_least, processors
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.core.smoothing.least_squares import Problem, Values
from fej_slam_ros.datasets.victoria_park import associated_log
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.common.executor import in_order, processes
from fej_slam_ros.experiments.liu.victoria_park import as_problem, dead_reckoning

NO_GTSAM = "iSAM2 is left out, as GTSAM is not here: pip install '.[benchmark]' (Python >= 3.11)"
#: Robots, and the rate of their odometry [Hz].
LIVE_LOADS = ((20, 50), (50, 20))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder with the associated Victoria Park data, to run it besides')
    parser.add_argument(
        '--peers', type=at_least(4, '--peers'), metavar='STEPS',
        help='also time so many steps of the filter, a textbook EKF and, with the extra benchmark,'
        " GTSAM's iSAM2 on the same data (1000 take some 10 minutes)")
    parser.add_argument(
        '--runs', type=at_least(1, '--runs'), metavar='N',
        help='also time N Monte Carlo runs of each experiment of the paper, with all filters, on'
        ' all processors (100 take some minutes)')
    parser.add_argument(
        '--soak', type=at_least(1, '--soak'), metavar='MINUTES',
        help='also run five robots among 300 landmarks for so many simulated minutes, and tell the'
        ' memory and the times of steps as they pass (60 take about 5 minutes)')
    parser.add_argument(
        '--live', type=at_least(1, '--live'), metavar='SECONDS',
        help='also run an estimator as a process on one processor, to which 20 robots send over'
        ' DDS with 50 Hz and then 50 robots with 20 Hz for so many seconds (needs ROS; 120 take'
        ' about 5 minutes)')
    parser.add_argument(
        '--output', type=Path, metavar='FILE.json', help='also write the figures as JSON')
    parser.add_argument('--force', action='store_true', help='replace an earlier FILE.json')


def run(arguments: argparse.Namespace) -> int:
    """Measure, then print and write."""
    if arguments.output is not None:
        refuse_existing([arguments.output], arguments.force)
    results, machines = {}, [measure_machine()]
    with tqdm(_parts(arguments).items(), unit='part', disable=None) as bar:
        for name, measure in bar:
            bar.set_description(name)
            results[name] = measure()
            machines.append(measure_machine())
    _refuse_drift(machines)
    machine = fastest(machines)
    print(', '.join(f'{name} {version}' for name, version in versions().items()))
    print(report(machine, results))
    if arguments.peers is not None and not find_spec('gtsam'):
        print(NO_GTSAM)
    if arguments.output is not None:
        figures = {
            'versions': versions(), 'machine': asdict(machine),
            **{name: [asdict(figure) for figure in result] for name, result in results.items()}}
        write_json(arguments.output, figures)
    return 0


def _parts(arguments: argparse.Namespace) -> dict[str, Callable[[], Sequence[Any]]]:
    """Return what to measure, by name."""
    parts: dict[str, Callable[[], Sequence[Any]]] = {
        'steps': lambda: [step_time(*size, STEPS) for size in SIZES],
        'matching': lambda: [run_speed.matching_time()],
        'runs': lambda: _runs(arguments.data),
        'smoothers': lambda: _smoothers(arguments.data)}
    if arguments.peers is not None:
        parts['peers'] = lambda: _peers(arguments.peers)
    if arguments.runs is not None:
        parts['monte_carlo'] = lambda: [run_speed.campaign_time(arguments.runs, processors())]
    if arguments.soak is not None:
        parts['soak'] = lambda: _soak(arguments.soak)
    if arguments.live is not None:
        parts['live'] = lambda: _live(arguments.live)
    return parts


def _peers(steps: int) -> list[PeerTime]:
    """Race with iSAM2 at its default and looking for changes at every step, if it is there."""
    others: dict[str, Callable[[], Peer]] = {}
    if find_spec('gtsam'):
        from fej_slam_ros.benchmark.isam2 import Isam2

        others = {f'iSAM2, relinearizeSkip {skip}': partial(Isam2, skip) for skip in (10, 1)}
    return [time for landmarks in LANDMARKS for time in peer_times(landmarks, steps, others)]


def _soak(minutes: int) -> list[Minute]:
    """Run for so many simulated minutes in a process of its own."""
    with processes(1) as executor:
        return next(in_order(executor, soak, [minutes]))


def _runs(folder: Path | None) -> list[run_speed.RunTime]:
    times = [run_speed.run_time(
        'synthetic, as large as Victoria Park', *run_speed.synthetic_park())]
    if folder is not None:
        times.append(run_speed.run_time('Victoria Park, two robots', *_victoria_park(folder)))
    return times


def _smoothers(folder: Path | None) -> list[run_speed.SmootherTime]:
    times = [run_speed.smoother_time('synthetic, as large', *run_speed.synthetic_log())]
    if folder is not None:
        times.append(run_speed.smoother_time('Victoria Park, whole log', *_whole_log(folder)))
    return times


def _live(seconds: int) -> list[LiveTime]:
    """Run an estimator under each load over DDS for so many seconds."""
    from fej_slam_ros.benchmark.live_load import run_load

    times = []
    for robots, odometry_rate in LIVE_LOADS:
        load = Load(robots, odometry_rate, seconds=seconds)
        times.append(live_time(load, run_load(load), Settings.max_delay))
    return times


def _victoria_park(folder: Path) -> tuple[list[Record], Settings]:
    team = associated_log.TEAMS[2]
    logs = associated_log.divide(associated_log.read(associated_log.find(folder)), team)
    return list(associated_log.records(logs)), associated_log.settings(team)


def _whole_log(folder: Path) -> tuple[Problem, Values]:
    logs = associated_log.divide(
        associated_log.read(associated_log.find(folder)), associated_log.TEAMS[1])
    start = dead_reckoning(logs, {'r1': np.zeros(3)})
    return as_problem(logs, start, associated_log.Q, associated_log.R)


def _refuse_drift(measured: Sequence[Machine]) -> None:
    F, B = drift(measured)
    if max(F, B) > MAX_DRIFT:
        raise UserError(
            f"the machine's speed drifted during the run (F by {F:.2f}, B by {B:.2f}): run again"
            ' while nothing else runs')
