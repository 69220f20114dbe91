# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Repeat the experiments of the papers beside the published results, and runs on real data.

tables         Tables 1 and 2, in the authors' worlds (--data) or in our own
figures        Figures 2 to 5, from the same runs
victoria_park  Figure 6, and the filters' errors against batch least squares (needs --data)
observability  Lemma 1: the observable directions of each filter
csam           C-SAM, experiments A and B: what two robots gain by merging their maps
noise          the filters, and one beyond the papers, over levels of noise
all            all of them

mrclam             five real robots and their motion capture (--data: an MRCLAM set, or several)
raw_victoria_park  the raw log, trees with and without IDs, against GPS (needs --data)

Results depend on --seed and --data only, not on --jobs or --dask. An interrupt keeps the finished
runs.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from fej_slam_ros.atomic_files import (
    refuse_existing, write_csv, write_figure, write_json, write_text)
from fej_slam_ros.cli import monte_carlo
from fej_slam_ros.cli.arguments import integer_option, output_folder
from fej_slam_ros.datasets.victoria_park import associated_log
from fej_slam_ros.errors import UsageError
from fej_slam_ros.experiments.andersson import experiment, report
from fej_slam_ros.experiments.liu import (
    noise, noise_report, observability, tables, victoria_park, victoria_park_report)
from fej_slam_ros.experiments.liu.configurations import Configuration, CONFIGURATIONS
from fej_slam_ros.experiments.liu.monte_carlo import (
    Errors, simulate, table_runs, table_tasks, TableRuns)
from fej_slam_ros.experiments.real_data import mrclam, raw_victoria_park
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.sim.world import World

#: Robots and landmarks of Lemma 1, and of a case beyond it.
OBSERVABILITY_TEAMS = ((2, 2), (3, 4))
#: Largest m of the observability matrix M over m + 1 steps.
OBSERVABILITY_STEPS = 10
CSAM_FIGURES = {'map_joining': 'csam_figure_5.png', 'sensor_extension': 'csam_figure_6.png'}
#: Experiment in which the robots exchange their logs, and its figure.
EXCHANGE, EXCHANGE_FIGURE = 'map_joining', 'csam_exchange.png'
#: Options of Monte Carlo runs, and of where they take place.
MONTE_CARLO = frozenset({'runs', 'run', 'seed', 'jobs', 'dask'})
WORKERS = frozenset({'jobs', 'dask'})


class Order(NamedTuple):
    """Parts to reproduce together, and the experiments of tables, figures and noise."""

    arguments: Namespace
    output: Path
    parts: Sequence[str]
    configurations: Sequence[Configuration]

    def world_source(self) -> tables.WorldSource:
        """Return the authors' worlds if there are data, or our own."""
        data = self.arguments.data
        return tables.OWN_WORLDS if data is None else tables.authors(data)


class Part(NamedTuple):
    """
    A part of the experiments.

    That is its function, the files it always writes, the options that it reads, and what --data
    must hold if needed.

    """

    run: Callable[[Order], None]
    files: Sequence[str]
    options: Collection[str]
    needs: str = ''
    in_all: bool = True
    draws: bool = True


def add_arguments(parser: ArgumentParser) -> None:
    real = [name for name, part in PARTS.items() if not part.in_all]
    papers = [name for name in PARTS if name not in real]
    parser.add_argument(
        'part', metavar='PART', choices=(*papers, 'all', *real),
        help=f'{", ".join(papers)} or all; {", ".join(real)}')
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help="folder with the authors' .mat files or the real data (default: our own worlds)")
    parser.add_argument(
        '--output', type=output_folder, required=True, metavar='DIR',
        help='folder for the results')
    parser.add_argument(
        '--only', nargs='+', metavar='WORLD',
        choices=[str(configuration) for configuration in CONFIGURATIONS],
        help=f'only these of the experiments {", ".join(map(str, CONFIGURATIONS))}')
    monte_carlo.add_arguments(parser)
    parser.add_argument(
        '--robots', type=integer_option('--robots', 1), metavar='N',
        help='robots of observability, without and with observations of each other (with'
        ' --landmarks; default: 2 with 2, and 3 with 4)')
    parser.add_argument(
        '--landmarks', type=integer_option('--landmarks', 2), metavar='N',
        help='landmarks of observability')
    parser.add_argument('--force', action='store_true', help='replace earlier results')


def run(arguments: Namespace) -> int:
    chosen = _chosen(arguments)
    if 'victoria_park' in chosen:
        associated_log.find(arguments.data)  # Says at once that it is not there.
    order = Order(monte_carlo.with_defaults(arguments), arguments.output, chosen, [
        configuration for configuration in CONFIGURATIONS
        if not arguments.only or str(configuration) in arguments.only])
    paths = [order.output / name for name in _files(order)]
    # Fails before hours of runs if the folder cannot be written.
    with OutputLock.of_folder(order.output):
        refuse_existing(paths, arguments.force)
        _reproduce(order)
    return 0


def _reproduce(order: Order) -> None:
    chosen = [PARTS[name] for name in order.parts]
    if any(part.draws for part in chosen):
        import_module('matplotlib')
    # Tables and figures are made of the same runs.
    for make in dict.fromkeys(part.run for part in chosen):
        make(order)
    print(f'wrote {order.output}')


def _chosen(arguments: Namespace) -> list[str]:
    """Return the requested parts, for all those that have the data they need."""
    if (arguments.robots is None) != (arguments.landmarks is None):
        raise UsageError('--robots and --landmarks go together: give both or none')
    parts = [PARTS[arguments.part]] if arguments.part != 'all' else [*PARTS.values()]
    for option in sorted(frozenset().union(*(part.options for part in PARTS.values()))):
        if getattr(arguments, option) is not None and all(
                option not in part.options for part in parts):
            print(f'--{option} has no effect on {arguments.part}')
    if arguments.part != 'all':
        needs = PARTS[arguments.part].needs
        if needs and arguments.data is None:
            raise UsageError(f'{arguments.part} needs --data: {needs}')
        return [arguments.part]
    if arguments.data is None:
        print('victoria_park is left out: it needs --data')
    return [
        name for name, part in PARTS.items()
        if part.in_all and (arguments.data is not None or not part.needs)]


def _files(order: Order) -> list[str]:
    names = [name for part in order.parts for name in PARTS[part].files]
    if 'figures' in order.parts:
        environments = sorted({c.environment for c in order.configurations})
        names += [*map(_worlds_name, environments), *map(_errors_name, order.configurations)]
    return names


def _worlds_name(environment: int) -> str:
    return f'figure_{1 + environment}.png'


def _errors_name(configuration: Configuration) -> str:
    return f'figure_{3 + configuration.environment}_{configuration.landmarks}.png'


def _simulated(order: Order) -> None:
    arguments, source = order.arguments, order.world_source()
    worlds = {c: source.world(c) for c in order.configurations}
    numbers = monte_carlo.numbers(arguments)

    def keep(finished: Sequence[dict[str, Errors]]) -> None:
        runs = table_runs(worlds, finished, len(numbers))
        if 'tables' in order.parts:
            entries = tables.entries(runs, source.ranges_of)
            write_csv(order.output / 'runs.csv', tables.runs_csv_rows(runs, numbers[0]))
            _write_report(
                order.output / 'tables', tables, entries,
                f'{source.about(entries)} Seed {arguments.seed}.')
        if 'figures' in order.parts:
            _draw_simulated(order.output, worlds, runs)

    monte_carlo.run_all(arguments, simulate, table_tasks(worlds, arguments.seed, numbers), keep)


def _draw_simulated(output: Path, worlds: dict[Configuration, World], runs: TableRuns) -> None:
    from fej_slam_ros.experiments.liu import figures

    for environment in dict.fromkeys(configuration.environment for configuration in worlds):
        write_figure(output / _worlds_name(environment), figures.draw_worlds, {
            c: world for c, world in worlds.items() if c.environment == environment})
    for configuration, by_filter in runs.items():
        write_figure(
            output / _errors_name(configuration), figures.draw_errors, configuration, by_filter)


def _mrclam(order: Order) -> None:
    folders, refused = mrclam.sets(order.arguments.data)
    for name, reason in refused.items():
        print(f'{name} is left out: {reason}')
    _real_runs(order, mrclam, mrclam.tasks(folders))


def _raw_victoria_park(order: Order) -> None:
    _real_runs(order, raw_victoria_park, raw_victoria_park.tasks(order.arguments.data))


def _real_runs(order: Order, experiment: Any, tasks: Sequence[Any]) -> None:
    """Run the tasks of a module of an experiment, and write its page and JSON."""
    (name,) = order.parts

    def keep(runs: Sequence[Any]) -> None:
        text = experiment.markdown(runs)
        write_text(order.output / f'{name}.md', text)
        write_json(order.output / f'{name}.json', experiment.summary(runs))
        print(text)

    monte_carlo.run_all(order.arguments, experiment.run, tasks, keep)


def _victoria_park(order: Order) -> None:
    from fej_slam_ros.experiments.liu import figures

    with tqdm(total=victoria_park.SOLUTIONS, unit='solution', disable=None) as bar:
        def progress(solution: str) -> None:
            bar.set_description(solution)
            bar.update()

        result = victoria_park.reproduce(order.arguments.data, progress)
    output = order.output
    write_csv(output / 'victoria_park_poses.csv', victoria_park_report.pose_rows(result))
    write_csv(output / 'victoria_park_landmarks.csv', victoria_park_report.landmark_rows(result))
    _write_report(output / 'victoria_park', victoria_park_report, result)
    write_figure(output / 'figure_6.png', figures.draw_park, result)


def _observability(order: Order) -> None:
    from fej_slam_ros.experiments.liu import observability_figure

    given = order.arguments.robots, order.arguments.landmarks
    cases = [
        observability.ObservabilityCase(robots, landmarks, robots_seen)
        for robots, landmarks in (OBSERVABILITY_TEAMS if given[0] is None else [given])
        for robots_seen in ((False, True) if robots > 1 else (False,))]
    results = observability.reproduce(cases, OBSERVABILITY_STEPS, order.arguments.seed)
    _write_report(order.output / 'observability', observability, results)
    write_figure(order.output / 'observability.png', observability_figure.draw, results)


def _csam(order: Order) -> None:
    """Write the report of C-SAM, whose run k has the seed S + k - 1, and draw the first runs."""
    from fej_slam_ros.experiments.andersson import exchange_figure, figure
    from fej_slam_ros.experiments.andersson.exchange import exchange

    def keep(runs: Sequence[experiment.CsamRun]) -> None:
        _write_report(order.output / 'csam', report, runs)
        # The first run of each experiment in which the maps were merged.
        drawn = {run.task.experiment: run.task for run in reversed(runs) if run.gain is not None}
        for name, task in drawn.items():
            solved = experiment.solve(task)
            write_figure(order.output / CSAM_FIGURES[name], figure.draw, solved, solved.joint)
            if name == EXCHANGE:
                exchanged = exchange(experiment.scene(*task), task.seed)
                write_figure(
                    order.output / EXCHANGE_FIGURE, exchange_figure.draw, solved, solved.joint,
                    exchanged)

    seed, numbers = order.arguments.seed, monte_carlo.numbers(order.arguments)
    monte_carlo.run_all(order.arguments, experiment.run, [
        experiment.CsamTask(name, seed + number - 1)
        for name in experiment.EXPERIMENTS for number in numbers], keep)


def _noise(order: Order) -> None:
    from fej_slam_ros.experiments.liu import noise_figure

    arguments, source = order.arguments, order.world_source()
    configurations = order.configurations if arguments.only else noise.NOISE_CONFIGURATIONS
    worlds = {c: source.world(c) for c in configurations}
    numbers = monte_carlo.numbers(arguments)

    def keep(finished: Sequence[noise.NoiseRun]) -> None:
        samples = noise.gathered(configurations, finished)
        means = noise.means(samples)
        owners = 'our own' if arguments.data is None else "the authors'"
        write_csv(
            order.output / 'noise_runs.csv', noise_report.runs_csv_rows(samples, numbers[0]))
        _write_report(
            order.output / 'noise', noise_report, means,
            f'Worlds: {owners}. Seed {arguments.seed}.')
        write_figure(order.output / 'noise.png', noise_figure.draw, means)

    monte_carlo.run_all(arguments, noise.run, noise.tasks(worlds, arguments.seed, numbers), keep)


def _write_report(path: Path, report: Any, results: Any, *remarks: str) -> None:
    """Write the page, table and JSON that a report module makes of results; print the page."""
    text = report.markdown(results, *remarks)
    write_text(path.with_suffix('.md'), text)
    write_csv(path.with_suffix('.csv'), report.csv_rows(results))
    write_json(path.with_suffix('.json'), report.summary(results))
    print(text)


def _report_files(name: str) -> list[str]:
    return [f'{name}.md', f'{name}.csv', f'{name}.json']


PARTS = {
    'tables': Part(
        _simulated, [*_report_files('tables'), 'runs.csv'], MONTE_CARLO | {'data', 'only'},
        draws=False),
    'figures': Part(_simulated, [], MONTE_CARLO | {'data', 'only'}),
    'victoria_park': Part(
        _victoria_park, [
            *_report_files('victoria_park'), 'figure_6.png', 'victoria_park_poses.csv',
            'victoria_park_landmarks.csv'],
        {'data'}, 'the folder with Zstate_VicPark_6898_loops.mat or VicPark_clean_data.mat'),
    'observability': Part(
        _observability, [*_report_files('observability'), 'observability.png'],
        {'seed', 'robots', 'landmarks'}),
    'csam': Part(
        _csam, [*_report_files('csam'), *CSAM_FIGURES.values(), EXCHANGE_FIGURE], MONTE_CARLO),
    'noise': Part(
        _noise, [*_report_files('noise'), 'noise_runs.csv', 'noise.png'],
        MONTE_CARLO | {'data', 'only'}),
    'mrclam': Part(
        _mrclam, ['mrclam.md', 'mrclam.json'], WORKERS | {'data'},
        'the folder of an MRCLAM set, with Barcodes.dat, or of several sets', in_all=False,
        draws=False),
    'raw_victoria_park': Part(
        _raw_victoria_park, ['raw_victoria_park.md', 'raw_victoria_park.json'],
        WORKERS | {'data'}, 'the folder with aa3_dr.mat and data_sensor_clean_clean.mat',
        in_all=False, draws=False)}
