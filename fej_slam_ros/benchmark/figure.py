# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growth curves of a benchmark: times over the sizes that they may depend on, with exponents."""

from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from typing import Any, BinaryIO, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fej_slam_ros.benchmark.machine import Machine
from fej_slam_ros.benchmark.message_budget import MessageBudget
from fej_slam_ros.benchmark.peers import PeerTime
from fej_slam_ros.benchmark.smoother_peers import GrowthTime
from fej_slam_ros.benchmark.soak import SoakMinute
from fej_slam_ros.benchmark.step_speed import power, StepTime
from fej_slam_ros.palette import ROBOT_COLOURS

LIMIT = 'limit of the machine'
#: Maximum number of sizes that are written along an axis.
MAX_TICKS = 10
LINE_STYLES = ('-', '--', ':')


class Panel(NamedTuple):
    """Curves over one size."""

    title: str
    size: str  #: label of the horizontal axis
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]]  #: sizes and times [s] by name


def draw(file: BinaryIO, machine: Machine, results: Mapping[str, Sequence[Any]]) -> None:
    """Draw a panel for each measured part that has growth curves, as a PNG."""
    panels_of: dict[str, Callable[[Sequence[Any]], Panel]] = {
        'steps': lambda steps: _steps(machine, steps), 'peers': _peers, 'growth': _growth,
        'messages': _messages, 'soak': _soak}
    panels = [of(results[name]) for name, of in panels_of.items() if name in results]
    figure = Figure(figsize=(7.0, 4.4 * len(panels)), layout='constrained')
    for axes, panel in zip(figure.subplots(len(panels), squeeze=False)[:, 0], panels):
        _draw(axes, panel)
    figure.savefig(file, dpi=110)


def _draw(axes: Axes, panel: Panel) -> None:
    styles = cycle([(line, colour) for line in LINE_STYLES for colour in ROBOT_COLOURS])
    for name, (sizes, times) in panel.curves.items():
        exponent = f', $n^{{{power(sizes, times):.2f}}}$' if len(sizes) > 1 else ''
        line, colour = ('--', 'black') if name == LIMIT else next(styles)
        axes.loglog(
            sizes, [1e3 * time for time in times], line, marker='.', color=colour,
            label=f'{name}{exponent}')
    ticks = sorted({size for sizes, _ in panel.curves.values() for size in sizes})
    if len(ticks) <= MAX_TICKS:
        axes.set_xticks(ticks, [f'{size:g}' for size in ticks])
        axes.set_xticks([], minor=True)
    axes.set(title=panel.title, xlabel=panel.size, ylabel='time [ms]')
    axes.grid(alpha=0.25, which='both')
    axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), fontsize='small', frameon=False)


def _steps(machine: Machine, steps: Sequence[StepTime]) -> Panel:
    """Return steps of the numbers of observations of the largest map."""
    steps = [step for step in steps if step.observations == steps[-1].observations]
    return Panel(
        f'A step with {steps[-1].observations} observations', 'states n of the map', {
            LIMIT: _curve([
                (step.states, machine.limit(step.states, step.observations)) for step in steps]),
            'dense, median': _curve([(step.states, step.dense.median) for step in steps]),
            'compressed, mean': _curve([
                (step.states, step.compressed.times.mean) for step in steps if step.compressed])})


def _peers(times: Sequence[PeerTime]) -> Panel:
    names = dict.fromkeys(time.name for time in times)
    return Panel('A step of two robots by 1 m, mean', 'landmarks n of the world', {
        name: _curve([(time.landmarks, time.times.mean) for time in times if time.name == name])
        for name in names})


def _growth(times: Sequence[GrowthTime]) -> Panel:
    names = dict.fromkeys(time.name for time in times)
    return Panel('A new pose of the smoother, mean', 'poses n before', {
        name: _curve([(time.poses, time.times.mean) for time in times if time.name == name])
        for name in names})


def _messages(budgets: Sequence[MessageBudget]) -> Panel:
    """Return the largest map of each team."""
    teams = {of.robots: of for of in budgets}.values()
    return Panel('A message from its bytes to the pose', 'robots n', {
        'odometry': _curve([
            (of.robots, of.odometry + of.order + of.odometry_step + of.publish) for of in teams]),
        'scan of ten observations': _curve([
            (of.robots, of.scan + of.order + of.scan_step + of.publish) for of in teams])})


def _soak(minutes: Sequence[SoakMinute]) -> Panel:
    return Panel('A step of five robots', 'minutes n since the start', {
        'median': _curve([(minute.number, minute.median) for minute in minutes]),
        '99th percentile': _curve([(minute.number, minute.p99) for minute in minutes])})


def _curve(points: Sequence[tuple[float, float]]) -> tuple[Sequence[float], Sequence[float]]:
    sizes, times = zip(*points)
    return sizes, times
