# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `benchmark` prints: a table for each part."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fej_slam_ros.benchmark.latency import LiveTime
from fej_slam_ros.benchmark.machine import Machine, Times
from fej_slam_ros.benchmark.peers import OURS, PeerTime
from fej_slam_ros.benchmark.run_speed import CampaignTime, MatchingTime, RunTime, SmootherTime
from fej_slam_ros.benchmark.soak import Minute
from fej_slam_ros.benchmark.step_speed import CompressedTime, exponent, StepTime
from fej_slam_ros.cli.run_table import format_table
from fej_slam_ros.experiments.liu.configurations import CONFIGURATIONS, FILTERS

TIMES = 'median', 'mean', 'p99', 'longest'
DENSE = (
    'dense, us', 'observations', 'limit', 'update of P', '/ limit', *(f'step: {t}' for t in TIMES),
    'median / limit', 'mean / limit')
COMPRESSED = 'compressed, us a step', *TIMES, 'mean / dense limit', 'regions', 'off by'
PEERS = (
    'ms a step', 'landmarks', 'found', *TIMES, 'last quarter', 'mean / ours', 'median / ours',
    'RMSE [m]')
SMOOTHER = 'smoother, ms', 'unknowns', 'begin', 'factorisation', 'all marginals'
LIVE = (
    'robots', 'sent', 'received', 'used', 'steps', 'poses', 'of a processor',
    'ms beyond max_delay: median', 'p99', 'longest', 'median that odometry was waited for')
SOAK = 'minute', 'landmarks', 'MB', 'median of a step [ms]', 'p99', 'longest'


def report(machine: Machine, results: Mapping[str, Sequence[Any]]) -> str:
    """Return the tables of all parts that were measured, by their names."""
    told: dict[str, Callable[[Sequence[Any]], str]] = {
        'steps': partial(step_tables, machine), 'matching': matching_line, 'runs': run_lines,
        'smoothers': smoother_table, 'peers': peer_table, 'monte_carlo': campaign_line,
        'soak': soak_table, 'live': live_table}
    limits = f'F {machine.flops * 1e-9:.1f} Gflop/s, B {machine.bandwidth * 1e-9:.1f} GB/s'
    return '\n\n'.join([limits, *(told[name](result) for name, result in results.items())])


def step_tables(machine: Machine, steps: Sequence[StepTime]) -> str:
    """Return the times of the dense filter, and of the compressed one where there are any."""
    dense: list[Sequence[str]] = [DENSE]
    compressed: list[Sequence[str]] = [COMPRESSED]
    for step in steps:
        limit, name = machine.limit(step.states, step.observations), f'{step.states} states'
        dense.append((
            name, str(step.observations), f'{limit * 1e6:.1f}', f'{step.update.median * 1e6:.1f}',
            f'{step.update.median / limit:.2f}', *_microseconds(step.dense),
            f'{step.dense.median / limit:.2f}', f'{step.dense.mean / limit:.2f}'))
        if step.compressed is not None:
            compressed.append((name, *_compressed(step.compressed, limit)))
    tables = [format_table(dense)]
    if compressed[1:]:
        tables.append(format_table(compressed))
    if compressed[2:]:
        tables.append(f'the median of the compressed filter grows as n^{exponent(steps):.2f}')
    return '\n\n'.join(tables)


def peer_table(times: Sequence[PeerTime]) -> str:
    """Return everybody's times, and how many times ours these are."""
    ours = {time.landmarks: time.times for time in times if time.name == OURS}
    rows = [
        (time.name, str(time.landmarks), str(time.found),
         *(f'{t * 1e3:.2f}' for t in (*_all(time.times), time.late)),
         f'{time.times.mean / ours[time.landmarks].mean:.1f}',
         f'{time.times.median / ours[time.landmarks].median:.1f}', f'{time.rmse:.3f}')
        for time in times]
    return format_table([PEERS, *rows])


def matching_line(times: Sequence[MatchingTime]) -> str:
    """Return how long the matching of a scan takes."""
    return '\n'.join(
        f'matching {time.observations} observations without identity against {time.landmarks}'
        f' landmarks: median {time.median * 1e3:.1f} ms, p99 {time.p99 * 1e3:.1f} ms,'
        f' {100.0 * time.matched:.1f} % found' for time in times)


def run_lines(times: Sequence[RunTime]) -> str:
    """Return how long whole runs take."""
    return '\n'.join(
        f'{time.name}: {time.steps} steps, {time.states} states: {time.seconds:.2f} s'
        for time in times)


def smoother_table(times: Sequence[SmootherTime]) -> str:
    """Return how long the parts of a smoother's work take."""
    return format_table([SMOOTHER, *(
        (time.name, str(time.unknowns),
         *(f'{t * 1e3:.0f}' for t in (time.begin, time.factorisation, time.marginals)))
        for time in times)])


def campaign_line(times: Sequence[CampaignTime]) -> str:
    """Return how long the Monte Carlo runs take."""
    return '\n'.join(
        f'{time.runs} Monte Carlo runs of {len(CONFIGURATIONS)} experiments with'
        f' {len(FILTERS)} filters, {time.jobs} processes: {time.seconds:.0f} s,'
        f' {time.memory * 1e-6:.0f} MB' for time in times)


def soak_table(passed: Sequence[Minute]) -> str:
    """Return every tenth minute, and the last one."""
    told = [minute for minute in passed if minute.number % 10 == 0 or minute is passed[-1]]
    return format_table([SOAK, *(
        (str(m.number), str(m.landmarks), f'{m.memory * 1e-6:.1f}',
         *(f'{t * 1e3:.1f}' for t in (m.median, m.p99, m.longest))) for m in told)])


def live_table(times: Sequence[LiveTime]) -> str:
    """Return what became of each load."""
    return format_table([LIVE, *map(_live, times)])


def _live(time: LiveTime) -> tuple[str, ...]:
    late = time.latency.median, time.latency.p99, time.latency.longest, time.waited.median
    counts = time.sent, time.received, time.used, time.steps, time.poses
    return (
        f'{time.robots} x {time.odometry_rate} Hz', *map(str, counts), f'{100.0 * time.cpu:.0f} %',
        *(f'{t * 1e3:.1f}' for t in late))


def _compressed(time: CompressedTime, limit: float) -> tuple[str, ...]:
    return (
        *_microseconds(time.times), f'{time.times.mean / limit:.2f}', str(time.regions),
        f'{time.difference:.0e}')


def _microseconds(times: Times) -> tuple[str, ...]:
    return tuple(f'{t * 1e6:.0f}' for t in _all(times))


def _all(times: Times) -> tuple[float, float, float, float]:
    return times.median, times.mean, times.p99, times.longest
