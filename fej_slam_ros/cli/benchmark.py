# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the speed of the filter beside this machine's own limits, and that of the smoother.

One BLAS thread, and but for Monte Carlo runs one process. The limits are measured before and
after; a run in which they drift apart says nothing and fails.
"""

import argparse
from dataclasses import asdict
import json
from pathlib import Path

import numpy as np

from fej_slam_ros.cli.arguments import at_least, processors
from fej_slam_ros.cli.table import format_table
from fej_slam_ros.core.least_squares import Problem, Values
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets import victoria_park
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments import speed
from fej_slam_ros.experiments.executor import in_order, processes
from fej_slam_ros.experiments.paper import CONFIGURATIONS, FILTERS
from fej_slam_ros.experiments.victoria_park import as_problem, dead_reckoning
from fej_slam_ros.ros.latency import live_time, LiveTime
from fej_slam_ros.ros.load import Load
from fej_slam_ros.ros.soak import Minute, soak
from fej_slam_ros.writing import refuse_existing, write_text

SOAK_HEADINGS = ('minute', 'landmarks', 'MB', 'median of a step [ms]', 'p99', 'longest')
SMOOTHER_HEADINGS = ('smoother, ms', 'unknowns', 'begin', 'factorisation', 'all marginals')
LIVE_HEADINGS = (
    'robots', 'sent', 'received', 'used', 'steps', 'poses', 'of a processor',
    'ms beyond max_delay: median', 'p99', 'longest', 'median that odometry was waited for')
#: Robots, and the rate of their odometry [Hz].
LIVE_LOADS = ((20, 50), (50, 20))
HEADINGS = ('us a step', 'sightings', 'limit', 'median', 'mean', 'p99', 'longest')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder with the associated Victoria Park data, to run it besides')
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
    """Measure and print."""
    if arguments.output is not None:
        refuse_existing([arguments.output], arguments.force)
    runs = {'synthetic, as large as Victoria Park': speed.synthetic_park()}
    logs = {'synthetic, as large': speed.synthetic_log()}
    if arguments.data is not None:
        runs['Victoria Park, two robots'] = _victoria_park(arguments.data)
        logs['Victoria Park, whole log'] = _whole_log(arguments.data)
    machine = speed.measure_machine()
    steps = [speed.step_times(machine, states) for states in speed.SIZES]
    matching = speed.matching_time()
    totals = {name: speed.run_time(*what) for name, what in runs.items()}
    smoothers = {name: speed.smoother_time(*log) for name, log in logs.items()}
    _refuse_drift(machine, speed.measure_machine())
    print(', '.join(f'{name} {version}' for name, version in speed.versions().items()))
    print(f'F {machine.flops * 1e-9:.1f} Gflop/s, B {machine.bandwidth * 1e-9:.1f} GB/s')
    print(format_table([HEADINGS, *map(_row, steps)]))
    print(
        f'matching {matching.sightings} sightings without identity against {matching.landmarks}'
        f' landmarks: median {matching.median * 1e3:.1f} ms, p99 {matching.p99 * 1e3:.1f} ms,'
        f' {100.0 * matching.matched:.1f} % found')
    for name, total in totals.items():
        print(f'{name}: {total.steps} steps, {total.states} states: {total.seconds:.2f} s')
    print(format_table([SMOOTHER_HEADINGS, *map(_smoother_row, smoothers.items())]))
    campaign = None if arguments.runs is None else _campaign(arguments.runs)
    minutes = [] if arguments.soak is None else _soak(arguments.soak)
    live = [] if arguments.live is None else _live(arguments.live)
    if arguments.output is not None:
        figures = {
            'versions': speed.versions(), 'machine': asdict(machine),
            'steps': [asdict(step) for step in steps],
            'matching': asdict(matching),
            'runs': {name: asdict(total) for name, total in totals.items()},
            'smoothers': {name: asdict(smoother) for name, smoother in smoothers.items()},
            'monte_carlo': None if campaign is None else asdict(campaign),
            'soak': [asdict(minute) for minute in minutes],
            'live': [asdict(time) for time in live]}
        write_text(arguments.output, json.dumps(figures, indent=2) + '\n')
    return 0


def _campaign(runs: int) -> speed.CampaignTime:
    """Make so many Monte Carlo runs on all processors, and print what they took."""
    campaign = speed.campaign_time(runs, processors())
    print(
        f'{campaign.runs} Monte Carlo runs of {len(CONFIGURATIONS)} experiments with'
        f' {len(FILTERS)} filters, {campaign.jobs} processes: {campaign.seconds:.0f} s,'
        f' {campaign.memory * 1e-6:.0f} MB')
    return campaign


def _soak(minutes: int) -> list[Minute]:
    """Run for so many simulated minutes in a process of its own; print some of them."""
    with processes(1) as executor:
        passed = next(in_order(executor, soak, [minutes]))
    told = [minute for minute in passed if minute.number % 10 == 0 or minute is passed[-1]]
    print(format_table([SOAK_HEADINGS, *(
        (str(m.number), str(m.landmarks), f'{m.memory * 1e-6:.1f}',
         *(f'{t * 1e3:.1f}' for t in (m.median, m.p99, m.longest))) for m in told)]))
    return passed


def _live(seconds: int) -> list[LiveTime]:
    """Run an estimator under each load over DDS for so many seconds; print what became of it."""
    from fej_slam_ros.ros.nodes.load import run_load

    times = []
    for robots, odometry_rate in LIVE_LOADS:
        load = Load(robots, odometry_rate, seconds=seconds)
        times.append(live_time(load, run_load(load), Settings.max_delay))
    print(format_table([LIVE_HEADINGS, *map(_live_row, times)]))
    return times


def _victoria_park(folder: Path) -> tuple[list[Record], Settings]:
    team = victoria_park.TEAMS[2]
    logs = victoria_park.divide(victoria_park.read(victoria_park.find(folder)), team)
    return list(victoria_park.records(logs)), victoria_park.settings(team)


def _whole_log(folder: Path) -> tuple[Problem, Values]:
    logs = victoria_park.divide(
        victoria_park.read(victoria_park.find(folder)), victoria_park.TEAMS[1])
    start = dead_reckoning(logs, {'r1': np.zeros(3)})
    return as_problem(logs, start, victoria_park.Q, victoria_park.R)


def _refuse_drift(before: speed.Machine, after: speed.Machine) -> None:
    ratios = after.flops / before.flops, after.bandwidth / before.bandwidth
    if max(*ratios, *(1.0 / ratio for ratio in ratios)) > speed.MAX_DRIFT:
        raise UserError(
            f"the machine's speed drifted during the run (F by {ratios[0]:.2f}, B by"
            f' {ratios[1]:.2f}): run again while nothing else runs')


def _smoother_row(named: tuple[str, speed.SmootherTime]) -> tuple[str, ...]:
    name, time = named
    times = time.begin, time.factorisation, time.marginals
    return (name, str(time.unknowns), *(f'{t * 1e3:.0f}' for t in times))


def _live_row(time: LiveTime) -> tuple[str, ...]:
    late = time.latency.median, time.latency.p99, time.latency.longest, time.waited.median
    counts = time.sent, time.received, time.used, time.steps, time.poses
    return (
        f'{time.robots} x {time.odometry_rate} Hz', *map(str, counts), f'{100.0 * time.cpu:.0f} %',
        *(f'{t * 1e3:.1f}' for t in late))


def _row(step: speed.StepTime) -> tuple[str, ...]:
    times = step.limit, step.median, step.mean, step.p99, step.longest
    return (f'{step.states} states', str(step.sightings), *(f'{t * 1e6:.0f}' for t in times))
