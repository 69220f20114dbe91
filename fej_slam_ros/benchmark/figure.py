# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growth curves of a benchmark: times over the sizes that they may depend on, with exponents."""

from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, BinaryIO, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fej_slam_ros.benchmark.machine import Machine
from fej_slam_ros.benchmark.message_budget import MessageBudget
from fej_slam_ros.benchmark.peers import PeerTime
from fej_slam_ros.benchmark.smoother_speed import GrowthTime
from fej_slam_ros.benchmark.soak import SoakMinute
from fej_slam_ros.benchmark.step_speed import power, StepTime
from fej_slam_ros.palette import line_style

LIMIT = 'limit of the machine'
#: Maximum number of sizes that are written along an axis.
MAX_AXIS_TICKS = 10


#: Sizes, and the times [s] of each.
Curve = tuple[Sequence[float], Sequence[float]]


class Panel(NamedTuple):
    """Curves over one size."""

    title: str
    size: str  #: label of the horizontal axis
    curves: Mapping[str, Curve]  #: by name


def draw(file: BinaryIO, machine: Machine, results: Mapping[str, Sequence[Any]]) -> None:
    """Draw a panel for each measured part that has growth curves, as a PNG."""
    panels_of: dict[str, Callable[[Sequence[Any]], Panel]] = {
        'steps': lambda steps: _steps(machine, steps), 'peers': _peers, 'growth': _growth,
        'messages': _messages, 'soak': _soak}
    panels = [panel_of(results[name]) for name, panel_of in panels_of.items() if name in results]
    figure = Figure(figsize=(7.0, 4.4 * len(panels)), layout='constrained')
    for axes, panel in zip(figure.subplots(len(panels), squeeze=False)[:, 0], panels):
        _draw(axes, panel)
    figure.savefig(file, dpi=110)


def _draw(axes: Axes, panel: Panel) -> None:
    styles = map(line_style, count())
    for name, (sizes, times) in panel.curves.items():
        exponent = f', $n^{{{power(sizes, times):.2f}}}$' if len(sizes) > 1 else ''
        colour, line = ('black', '--') if name == LIMIT else next(styles)
        axes.loglog(
            sizes, [1e3 * time for time in times], line, marker='.', color=colour,
            label=f'{name}{exponent}')
    ticks = sorted({size for sizes, _ in panel.curves.values() for size in sizes})
    if len(ticks) <= MAX_AXIS_TICKS:
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
    return Panel('A step of two robots by 1 m, mean', 'landmarks n of the world', _curves([
        (time.name, time.landmarks, time.times.mean) for time in times]))


def _growth(times: Sequence[GrowthTime]) -> Panel:
    return Panel('A new pose of the smoother, mean', 'poses n before', _curves([
        (time.name, time.poses, time.times.mean) for time in times]))


def _messages(budgets: Sequence[MessageBudget]) -> Panel:
    """Return the largest map of each team."""
    teams = {budget.robots: budget for budget in budgets}.values()
    return Panel('A message from its bytes to the pose', 'robots n', {
        'odometry': _curve([
            (budget.robots, (
                budget.odometry + budget.order + budget.odometry_step + budget.publish))
            for budget in teams]),
        'scan of ten observations': _curve([
            (budget.robots, budget.scan + budget.order + budget.scan_step + budget.publish)
            for budget in teams])})


def _soak(minutes: Sequence[SoakMinute]) -> Panel:
    return Panel('A step of five robots', 'minutes n since the start', {
        'median': _curve([(minute.number, minute.median) for minute in minutes]),
        '99th percentile': _curve([(minute.number, minute.p99) for minute in minutes])})


def _curves(points: Sequence[tuple[str, float, float]]) -> dict[str, Curve]:
    """Return the curves of sizes and times, each with the name of its curve."""
    return {
        name: _curve([(size, time) for other, size, time in points if other == name])
        for name in dict.fromkeys(name for name, _, _ in points)}


def _curve(points: Sequence[tuple[float, float]]) -> Curve:
    sizes, times = zip(*points)
    return sizes, times
