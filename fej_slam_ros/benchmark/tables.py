# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The output of `benchmark`: a table for each part."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fej_slam_ros.benchmark.batch import BatchTime, OUR_BATCH
from fej_slam_ros.benchmark.latency import LiveTime
from fej_slam_ros.benchmark.machine import Machine, Times
from fej_slam_ros.benchmark.matching_speed import MatchingTime
from fej_slam_ros.benchmark.message_budget import MessageBudget
from fej_slam_ros.benchmark.peers import OURS, PeerTime
from fej_slam_ros.benchmark.run_speed import CampaignTime, RunTime
from fej_slam_ros.benchmark.smoother_speed import GrowthTime, OUR_SMOOTHER, SmootherTime
from fej_slam_ros.benchmark.soak import SoakMinute
from fej_slam_ros.benchmark.step_speed import exponent, StepTime
from fej_slam_ros.experiments.liu.configurations import CONFIGURATIONS, TABLE_FILTERS
from fej_slam_ros.tables import text_table

TIME_HEADS = 'median', 'mean', 'p99', 'longest'
DENSE_HEAD = (
    'dense, us', 'observations', 'limit', 'update of P', '/ limit',
    *(f'step: {head}' for head in TIME_HEADS), 'median / limit', 'mean / limit')
COMPRESSED_HEAD = (
    'compressed, us a step', *TIME_HEADS, 'mean / dense limit', 'submaps', 'difference')
PEER_HEAD = (
    'landmarks', 'found', *TIME_HEADS, 'last quarter', 'mean / ours', 'median / ours',
    'alone: mean', '/ ours', 'RMSE [m]')
GROWTH_HEAD = 'ms a pose', 'poses', *TIME_HEADS, 'median / ours', 'mean / ours', 'RMSE [m]'
SMOOTHER_HEAD = 'smoother, ms', 'unknowns', 'begin', 'factorisation', 'all marginals'
BATCH_HEAD = (
    'whole solution', 'solver', 'unknowns', 's', '/ ours', 'iterations', 'chi-square',
    'from ours [m]')
BUDGET_HEAD = (
    'robots, us', 'states', 'read odometry', 'read scan', 'order', 'step: odometry', 'step: scan',
    'publish', 'of a core')
LIVE_HEAD = (
    'robots', 'sent', 'received', 'used', 'steps', 'poses', 'CPU',
    'ms beyond max_delay: median', 'p99', 'longest', 'median wait for odometry')
SOAK_HEAD = 'minute', 'landmarks', 'MB', 'median of a step [ms]', 'p99', 'longest'


def report(machine: Machine, results: Mapping[str, Sequence[Any]]) -> str:
    """Return the tables of all measured parts, given by name."""
    tables: dict[str, Callable[[Sequence[Any]], str]] = {
        'steps': partial(step_tables, machine), 'matching': matching_lines, 'runs': run_lines,
        'smoothers': smoother_table, 'batch': batch_table, 'growth': growth_table,
        'peers': peer_table,
        'one_robot': partial(peer_table, head='one robot, ms a step'),
        'monte_carlo': campaign_lines,
        'soak': soak_table, 'messages': budget_table, 'live': live_table}
    limits = f'F {machine.flops * 1e-9:.1f} Gflop/s, B {machine.bandwidth * 1e-9:.1f} GB/s'
    return '\n\n'.join([limits, *(tables[name](result) for name, result in results.items())])


def step_tables(machine: Machine, steps: Sequence[StepTime]) -> str:
    """Return the times of the dense filter, and of the compressed one if it was timed."""
    dense, compressed = [], []
    for step in steps:
        limit, name = machine.limit(step.states, step.observations), f'{step.states} states'
        dense.append((
            name, str(step.observations), f'{limit * 1e6:.1f}', f'{step.update.median * 1e6:.1f}',
            f'{step.update.median / limit:.2f}', *_cells(step.dense, 1e6, '.0f'),
            f'{step.dense.median / limit:.2f}', f'{step.dense.mean / limit:.2f}'))
        if step.compressed is not None:
            times = step.compressed.times
            compressed.append((
                name, *_cells(times, 1e6, '.0f'), f'{times.mean / limit:.2f}',
                str(step.compressed.regions), f'{step.compressed.difference:.0e}'))
    tables = [text_table(DENSE_HEAD, dense)]
    if compressed:
        tables.append(text_table(COMPRESSED_HEAD, compressed))
    if compressed[1:]:
        tables.append(f'the median of the compressed filter grows as n^{exponent(steps):.2f}')
    return '\n\n'.join(tables)


def peer_table(times: Sequence[PeerTime], head: str = 'ms a step') -> str:
    """Return the times of all peers, and their ratios to ours."""
    ours = {time.landmarks: time for time in times if time.name == OURS}
    return text_table((head, *PEER_HEAD), [
        (time.name, str(time.landmarks), str(time.found), *_cells(time.times, 1e3, '.2f'),
         f'{time.late * 1e3:.2f}', f'{time.times.mean / ours[time.landmarks].times.mean:.1f}',
         f'{time.times.median / ours[time.landmarks].times.median:.1f}',
         f'{time.alone * 1e3:.2f}', f'{time.alone / ours[time.landmarks].alone:.1f}',
         f'{time.rmse:.3f}')
        for time in times])


def matching_lines(times: Sequence[MatchingTime]) -> str:
    """Return the times of the association of a scan."""
    return '\n'.join(
        f'association of {time.observations} observations without IDs with {time.landmarks}'
        f' landmarks: median {time.median * 1e3:.1f} ms, p99 {time.p99 * 1e3:.1f} ms,'
        f' {100.0 * time.matched:.1f} % found' for time in times)


def run_lines(times: Sequence[RunTime]) -> str:
    """Return the times of whole runs."""
    return '\n'.join(
        f'{time.name}: {time.steps} steps, {time.states} states: {time.seconds:.2f} s'
        for time in times)


def smoother_table(times: Sequence[SmootherTime]) -> str:
    """Return the times of the parts of batch least squares."""
    return text_table(SMOOTHER_HEAD, [
        (time.name, str(time.unknowns),
         *(f'{t * 1e3:.0f}' for t in (time.begin, time.factorisation, time.marginals)))
        for time in times])


def batch_table(times: Sequence[BatchTime]) -> str:
    """Return the times of batch least squares by all solvers, and their ratios to ours."""
    ours = {time.name: time.seconds for time in times if time.solver == OUR_BATCH}
    return text_table(BATCH_HEAD, [
        (time.name, time.solver, str(time.unknowns), f'{time.seconds:.2f}',
         f'{time.seconds / ours[time.name]:.1f}', str(time.iterations), f'{time.cost:.1f}',
         f'{time.difference:.1g}') for time in times])


def growth_table(times: Sequence[GrowthTime]) -> str:
    """Return the times of all smoothers by number of poses, and their ratios to ours."""
    ours = {time.poses: time.times for time in times if time.name == OUR_SMOOTHER}
    return text_table(GROWTH_HEAD, [
        (time.name, str(time.poses), *_cells(time.times, 1e3, '.2f'),
         f'{time.times.median / ours[time.poses].median:.1f}',
         f'{time.times.mean / ours[time.poses].mean:.1f}', f'{time.rmse:.3f}')
        for time in times])


def campaign_lines(times: Sequence[CampaignTime]) -> str:
    """Return the times of Monte Carlo runs."""
    return '\n'.join(
        f'{time.runs} Monte Carlo runs of {len(CONFIGURATIONS)} experiments with'
        f' {len(TABLE_FILTERS)} filters, {time.jobs} processes: {time.seconds:.0f} s,'
        f' {time.memory * 1e-6:.0f} MB' for time in times)


def soak_table(minutes: Sequence[SoakMinute]) -> str:
    """Return every tenth minute, and the last one."""
    return text_table(SOAK_HEAD, [
        (str(m.number), str(m.landmarks), f'{m.memory * 1e-6:.1f}',
         *(f'{t * 1e3:.1f}' for t in (m.median, m.p99, m.longest)))
        for m in minutes if m.number % 10 == 0 or m is minutes[-1]])


def budget_table(budgets: Sequence[MessageBudget]) -> str:
    """Return the parts of the way of a message."""
    return text_table(BUDGET_HEAD, [
        (str(budget.robots), str(budget.states), *(f'{1e6 * t:.0f}' for t in (
            budget.odometry, budget.scan, budget.order, budget.odometry_step, budget.scan_step,
            budget.publish)),
         f'{100.0 * budget.cpu:.0f} %') for budget in budgets])


def live_table(times: Sequence[LiveTime]) -> str:
    """Return the results of each load."""
    return text_table(LIVE_HEAD, [
        (f'{time.robots} x {time.odometry_rate} Hz',
         *map(str, (time.sent, time.received, time.used, time.steps, time.poses)),
         f'{100.0 * time.cpu:.0f} %', *(f'{t * 1e3:.1f}' for t in (
             time.latency.median, time.latency.p99, time.latency.longest, time.waited.median)))
        for time in times])


def _cells(times: Times, scale: float, form: str) -> tuple[str, ...]:
    """Return the cells below `TIME_HEADS`."""
    values = times.median, times.mean, times.p99, times.longest
    return tuple(format(t * scale, form) for t in values)
