# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo runs of a verb: numbers, worker processes, and results after an interrupt."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, closing

from tqdm import tqdm

from fej_slam_ros.cli.arguments import integer_option, processors
from fej_slam_ros.errors import UsageError
from fej_slam_ros.experiments.common import executor
from fej_slam_ros.experiments.common.executor import ResultT, TaskT


#: Values of options that are not given.
DEFAULTS = {'runs': 100, 'seed': 1, 'jobs': processors()}


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        '--runs', type=integer_option('--runs', 1), metavar='N',
        help=f'Monte Carlo runs of each experiment (default: {DEFAULTS["runs"]})')
    parser.add_argument(
        '--run', type=integer_option('--run', 1), metavar='K', help='only run number K of them')
    parser.add_argument(
        '--seed', type=integer_option('--seed', 0), metavar='S',
        help=f'seed of all noise (default: {DEFAULTS["seed"]})')
    parser.add_argument(
        '--jobs', type=integer_option('--jobs', 1), metavar='J',
        help=f'worker processes (default: one per processor, {DEFAULTS["jobs"]})')
    parser.add_argument(
        '--dask', metavar='ADDRESS', help='use the workers of this Dask scheduler (extra: dask)')


def with_defaults(arguments: Namespace) -> Namespace:
    """Return the arguments with values for all options but --run and --dask."""
    if arguments.run is not None and arguments.runs is not None and arguments.run > arguments.runs:
        raise UsageError(f'--run {arguments.run} is none of --runs {arguments.runs}')
    given = {name: value for name, value in vars(arguments).items() if value is not None}
    return Namespace(**{**vars(arguments), **DEFAULTS, **given})


def numbers(arguments: Namespace) -> range:
    """Return the numbers of the runs."""
    return range(arguments.run or 1, (arguments.run or arguments.runs) + 1)


def run_all(
    arguments: Namespace, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT],
    keep: Callable[[Sequence[ResultT]], None],
) -> None:
    """Run all tasks and keep their results; after an interrupt, those of the finished ones."""
    finished: list[ResultT] = []
    try:
        with _executor(arguments) as workers, closing(
            executor.in_order(workers, function, tasks)
        ) as results:
            finished.extend(tqdm(results, total=len(tasks), unit='run', disable=None))
            if isinstance(workers, executor.WorkerProcesses) and workers.deaths:
                print(f'{workers.deaths} worker processes ended; their runs were repeated')
    finally:
        if finished and len(finished) < len(tasks):
            print(f'{len(finished)} of {len(tasks)} runs are finished and kept')
        if finished:
            keep(finished)


def _executor(arguments: Namespace) -> AbstractContextManager[Executor]:
    if arguments.dask is not None:
        from fej_slam_ros.experiments.common.cluster import dask

        return dask(arguments.dask)
    return executor.processes(arguments.jobs)
