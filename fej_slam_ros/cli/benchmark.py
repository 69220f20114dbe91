# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the speed of the filter and the smoother, beside the limits of this machine and its peers.

One BLAS thread and, except for Monte Carlo runs, one process. The limits are measured before,
after and between the parts. If they drift apart, the tables are printed and drawn, but no JSON is
written and the exit status is 1. See docs/BENCHMARK.md.
"""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from fej_slam_ros.atomic_files import write_figure, write_json
from fej_slam_ros.benchmark import ceres, mrpt, run_speed, smoother_speed
from fej_slam_ros.benchmark.batch import batch_times, BatchTime, Solver
from fej_slam_ros.benchmark.latency import live_time, LiveTime
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.benchmark.machine import drift, fastest, MAX_DRIFT, measure_machine, versions
from fej_slam_ros.benchmark.matching_speed import matching_time
from fej_slam_ros.benchmark.message_budget import message_budget, TEAMS
from fej_slam_ros.benchmark.peers import (
    one_robot_times, Peer, PEER_LANDMARKS, peer_times, PeerTime)
from fej_slam_ros.benchmark.soak import soak, SoakMinute
from fej_slam_ros.benchmark.step_speed import SIZES, step_time, TIMED_STEPS
from fej_slam_ros.benchmark.tables import report
from fej_slam_ros.cli.arguments import integer_option, processors, require_matplotlib
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets.victoria_park import associated_log
from fej_slam_ros.datasets.victoria_park.associated_log import CAR_TEAMS, CarTeam
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.common.executor import in_order, processes
from fej_slam_ros.experiments.liu.victoria_park import (
    as_problem, dead_reckoning, filtered, TeamLogs)
from fej_slam_ros.output_lock import claimed

NO_GTSAM = "GTSAM is left out: pip install '.[benchmark]' (Python >= 3.11)"
NO_CERES = 'Ceres is left out: apt install libceres-dev g++'
NO_MRPT = 'MRPT is left out: apt install libmrpt-slam-dev g++'
#: Steps over which the fixed-lag smoother keeps poses and landmarks.
LAG = 20
#: Loads of the live part: number of robots, rate of their odometry [Hz].
LIVE_LOADS = ((20, 50), (50, 20))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder with the associated Victoria Park data, to run it as well, and to solve it'
             ' whole beside GTSAM (extra benchmark) and Ceres where it is installed')
    parser.add_argument(
        '--peers', type=integer_option('--peers', 4), metavar='STEPS',
        help='also time these steps of the filter, a textbook EKF and, with the extra benchmark,'
        " GTSAM's iSAM2 and fixed-lag smoother; of one robot, with MRPT where it is installed"
        ' (1000 take some 20 minutes)')
    parser.add_argument(
        '--smoother', type=integer_option('--smoother', 10), metavar='POSES',
        help='also time new poses of the smoother while the trajectory grows to this number and,'
        " with the extra benchmark, of GTSAM's iSAM2 (10000 take some 10 minutes)")
    parser.add_argument(
        '--runs', type=integer_option('--runs', 1), metavar='N',
        help="also time N Monte Carlo runs of the paper's experiments (100 take some minutes)")
    parser.add_argument(
        '--soak', type=integer_option('--soak', 1), metavar='MINUTES',
        help='also report memory and step times of a long simulated run (60 take 5 minutes)')
    parser.add_argument(
        '--messages', type=integer_option('--messages', 2), metavar='SECONDS',
        help='also time the way of a message through the estimator, for teams of 2, 20 and 50'
        ' robots and this time of their data (20 take a minute)')
    parser.add_argument(
        '--live', type=integer_option('--live', 1), metavar='SECONDS',
        help='also run an estimator process under the load over DDS of 20 robots at 50 Hz, then'
        ' of 50 at 20 Hz, for this time each (needs ROS; 120 take 5 minutes)')
    parser.add_argument(
        '--output', type=Path, metavar='FILE.json', help='also write the results as JSON')
    parser.add_argument(
        '--picture', type=Path, metavar='FILE.png',
        help='also draw the times over the sizes that they depend on (needs matplotlib)')
    parser.add_argument('--force', action='store_true', help='replace earlier files')


def run(arguments: argparse.Namespace) -> int:
    """Measure all parts, then print and write the results."""
    if arguments.picture:
        require_matplotlib('leave out --picture')
    if arguments.data is not None:
        associated_log.find(arguments.data)  # Says at once that it is not there.
    if arguments.live is not None:
        import_module('fej_slam_ros.benchmark.live_load')  # Says at once that ROS is missing.
    with claimed(arguments.output, arguments.force), claimed(arguments.picture, arguments.force):
        return _benchmark(arguments)


def _benchmark(arguments: argparse.Namespace) -> int:
    results, machines = {}, [measure_machine()]
    with tqdm(_parts(arguments).items(), unit='part', disable=None) as bar:
        for name, measure in bar:
            bar.set_description(name)
            results[name] = measure()
            machines.append(measure_machine())
    print(', '.join(f'{name} {version}' for name, version in versions().items()))
    print(report(fastest(machines), results))
    if (arguments.peers or arguments.smoother or arguments.data) and not find_spec('gtsam'):
        print(NO_GTSAM)
    if arguments.data and not ceres.is_installed():
        print(NO_CERES)
    if arguments.peers and not mrpt.is_installed():
        print(NO_MRPT)
    if arguments.picture:
        from fej_slam_ros.benchmark import figure

        write_figure(arguments.picture, figure.draw, fastest(machines), results)
    F, B = drift(machines)
    if max(F, B) > MAX_DRIFT:
        raise UserError(
            f"the machine's speed drifted during the run (F by {F:.2f}, B by {B:.2f}), so that"
            ' only the comparisons within one table hold: repeat it on an idle machine')
    if arguments.output is not None:
        write_json(arguments.output, {
            'versions': versions(), 'machine': asdict(fastest(machines)),
            **{name: [asdict(result) for result in part] for name, part in results.items()}})
    return 0


def _parts(arguments: argparse.Namespace) -> dict[str, Callable[[], Sequence[Any]]]:
    """Return the functions that measure the requested parts, by name."""
    parts: dict[str, Callable[[], Sequence[Any]]] = {
        'steps': lambda: [step_time(*size, TIMED_STEPS) for size in SIZES],
        'matching': lambda: [matching_time()],
        'runs': lambda: _runs(arguments.data),
        'smoothers': lambda: _smoothers(arguments.data)}
    if arguments.data is not None:
        parts['batch'] = lambda: _batch(arguments.data)
    if arguments.smoother is not None:
        parts['growth'] = lambda: smoother_speed.growth_times(arguments.smoother, _isam2(10))
    if arguments.peers is not None:
        parts['peers'] = lambda: _peers(arguments.peers)
        if mrpt.is_installed():
            parts['one_robot'] = lambda: _one_robot(arguments.peers)
    if arguments.runs is not None:
        parts['monte_carlo'] = lambda: [run_speed.campaign_time(arguments.runs, processors())]
    if arguments.soak is not None:
        parts['soak'] = lambda: _soak(arguments.soak)
    if arguments.messages is not None:
        parts['messages'] = lambda: [
            message_budget(*team, arguments.messages) for team in TEAMS]
    if arguments.live is not None:
        parts['live'] = lambda: _live(arguments.live)
    return parts


def _peers(steps: int) -> list[PeerTime]:
    """Time the peers; iSAM2, if present, with default relinearisation and at every step."""
    others = _isam2(10, 1, lags=[LAG])
    return [time for landmarks in PEER_LANDMARKS for time in peer_times(landmarks, steps, others)]


def _isam2(*skips: int, lags: Sequence[int] = ()) -> dict[str, Callable[[], Peer]]:
    """
    Return iSAM2 that relinearises in every `skip`-th step, and over the latest steps only.

    Nothing without GTSAM.

    """
    if not find_spec('gtsam'):
        return {}
    from fej_slam_ros.benchmark.isam2 import FixedLag, Isam2

    whole = {f'iSAM2, relinearizeSkip {skip}': partial(Isam2, skip) for skip in skips}
    return whole | {f'iSAM2, last {lag} steps only': partial(FixedLag, 10, lag) for lag in lags}


def _one_robot(steps: int) -> list[PeerTime]:
    """Time both updates of MRPT's EKF beside ours."""
    with mrpt.built() as program, ExitStack() as stack:
        def start(method: str) -> Peer:
            peer = mrpt.Mrpt(program, method)
            stack.callback(peer.close)
            return peer

        others = {f'MRPT, {method}': partial(start, method) for method in mrpt.METHODS}
        return [
            time for landmarks in PEER_LANDMARKS
            for time in one_robot_times(landmarks, steps, others)]


def _soak(minutes: int) -> list[SoakMinute]:
    with processes(1) as executor:  # Measures the memory of its process.
        return next(in_order(executor, soak, [minutes]))


def _runs(folder: Path | None) -> list[run_speed.RunTime]:
    times = [run_speed.run_time(
        'synthetic, as large as Victoria Park', *run_speed.synthetic_park())]
    if folder is not None:
        team = CAR_TEAMS[2]
        times.append(run_speed.run_time(
            'Victoria Park, two robots', list(associated_log.records(_logs(folder, team))),
            associated_log.settings(team)))
    return times


def _smoothers(folder: Path | None) -> list[smoother_speed.SmootherTime]:
    times = [smoother_speed.smoother_time('synthetic, as large', *smoother_speed.synthetic_log())]
    if folder is not None:
        logs = _logs(folder, CAR_TEAMS[1])
        start = dead_reckoning(logs, {'r1': np.zeros(3)})
        times.append(smoother_speed.smoother_time(
            'Victoria Park, whole log', *as_problem(logs, start)))
    return times


def _batch(folder: Path) -> list[BatchTime]:
    team = CAR_TEAMS[2]
    logs = _logs(folder, team)
    problem, values = as_problem(logs, filtered(logs, team, 'fej'))
    return batch_times('Victoria Park, two robots', problem, values, _batch_solvers())


def _logs(folder: Path, team: CarTeam) -> TeamLogs:
    """Return the log of Victoria Park, divided among the robots of a team."""
    return associated_log.divide(associated_log.read(associated_log.find(folder)), team)


def _batch_solvers() -> dict[str, Solver]:
    """Return the other solvers that are installed."""
    solvers: dict[str, Solver] = {}
    if find_spec('gtsam'):
        from fej_slam_ros.benchmark import gtsam_batch

        solvers['GTSAM'] = gtsam_batch.solve
    if ceres.is_installed():
        solvers['Ceres'] = ceres.solve
    return solvers


def _live(seconds: int) -> list[LiveTime]:
    from fej_slam_ros.benchmark.live_load import run_load

    loads = [Load(robots, rate, seconds=seconds) for robots, rate in LIVE_LOADS]
    return [live_time(load, run_load(load), Settings.max_delay) for load in loads]
