# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Repeat the experiments of the papers and put the results beside the printed ones; and real data.

tables         Tables 1 and 2, in the authors' worlds (--data) or in our own
figures        Figures 2 to 5, from the same runs
victoria_park  Figure 6, and the filters' errors against batch least squares (needs --data)
observability  Lemma 1: what each filter holds for observable
csam           C-SAM, experiments A and B: what two robots gain by joining their maps
noise          the filters, and one beyond the papers, over levels of noise
all            all of them

mrclam             five real robots and their motion capture (--data: a set of MRCLAM)
raw_victoria_park  the raw log, trees with and without identity, against GPS (needs --data)

Numbers depend on --seed and --data only, not on --jobs or --dask. An interrupt keeps what is
finished.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from io import BytesIO
from pathlib import Path
import signal
from typing import Any

from tqdm import tqdm

from fej_slam_ros.atomic_files import (
    make_folder, PartFile, refuse_existing, write_bytes, write_csv, write_json, write_text)
from fej_slam_ros.cli import monte_carlo
from fej_slam_ros.cli.arguments import at_least
from fej_slam_ros.errors import UsageError
from fej_slam_ros.experiments.andersson import experiment, report
from fej_slam_ros.experiments.liu import (
    noise, noise_report, observability, tables, victoria_park, victoria_park_report)
from fej_slam_ros.experiments.liu.configurations import Configuration, CONFIGURATIONS
from fej_slam_ros.experiments.liu.monte_carlo import Errors, simulate
from fej_slam_ros.experiments.liu.simulated_runs import gathered, Runs, tasks
from fej_slam_ros.experiments.real_data import mrclam, raw_victoria_park
from fej_slam_ros.sim.world import World

PARTS = ('tables', 'figures', 'victoria_park', 'observability', 'csam', 'noise')
#: Those that make a table of runs on real data.
REAL = {'mrclam': mrclam, 'raw_victoria_park': raw_victoria_park}
#: What --data has to hold, where a part needs it.
NEEDED = {
    'victoria_park':
        'the folder with Zstate_VicPark_6898_loops.mat or VicPark_clean_data.mat',
    'mrclam': 'the folder of an MRCLAM set, with Barcodes.dat',
    'raw_victoria_park': 'the folder with aa3_dr.mat and data_sensor_clean_clean.mat'}
#: Robots and landmarks of Lemma 1, and of a case beyond it.
TEAMS = ((2, 2), (3, 4))
#: The largest m of M over m + 1 steps.
STEPS = 10

#: The files of C-SAM's figures.
CSAM_FIGURES = {'map_joining': 'csam_figure_5.png', 'sensor_extension': 'csam_figure_6.png'}

Worlds = dict[Configuration, World]


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        'part', metavar='PART', choices=(*PARTS, 'all', *REAL),
        help=f'{", ".join(PARTS)} or all; {", ".join(REAL)}')
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help="folder with the authors' .mat files or the real data; else worlds are our own")
    parser.add_argument(
        '--output', type=Path, required=True, metavar='DIR', help='folder for the results')
    parser.add_argument(
        '--only', nargs='+', metavar='ENVIRONMENT/LANDMARKS',
        choices=[str(configuration) for configuration in CONFIGURATIONS],
        help=f'only these of the experiments {", ".join(map(str, CONFIGURATIONS))}')
    monte_carlo.add_arguments(parser)
    parser.add_argument(
        '--robots', type=at_least(1, '--robots'), metavar='N',
        help='robots of observability, without and with observations of each other (with'
        ' --landmarks; default: 2 with 2, and 3 with 4)')
    parser.add_argument(
        '--landmarks', type=at_least(2, '--landmarks'), metavar='N',
        help='landmarks of observability')
    parser.add_argument('--force', action='store_true', help='replace earlier results')


def run(arguments: Namespace) -> int:
    """Reproduce a part, or all."""
    parts = _parts(arguments)
    output: Path = arguments.output
    configurations = [
        configuration for configuration in CONFIGURATIONS
        if not arguments.only or str(configuration) in arguments.only]
    names = [name for part in parts for name in _names(part, configurations)]
    refuse_existing([output / name for name in names], arguments.force)
    make_folder(output)
    # Better now than after hours: is the folder writable, is matplotlib there?
    with PartFile(output / names[0]):
        pass
    if parts != ['tables'] and parts[0] not in REAL:
        import_module('matplotlib')
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if parts[0] in REAL:
        _real(arguments, parts[0])
    if 'victoria_park' in parts:
        _victoria_park(arguments)
    if 'observability' in parts:
        _observability(arguments)
    if 'csam' in parts:
        _csam(arguments)
    if 'noise' in parts:
        _noise(arguments, configurations if arguments.only else noise.CONFIGURATIONS)
    if 'tables' in parts or 'figures' in parts:
        _simulate(arguments, parts, configurations)
    print(f'wrote {output}')
    return 0


def _parts(arguments: Namespace) -> list[str]:
    if (arguments.robots is None) != (arguments.landmarks is None):
        raise UsageError('--robots and --landmarks go together: give both or none')
    if arguments.part in NEEDED and arguments.data is None:
        raise UsageError(f'{arguments.part} needs --data: {NEEDED[arguments.part]}')
    if arguments.part != 'all':
        return [arguments.part]
    if arguments.data is None:
        print('victoria_park is left out: it needs --data')
    return [part for part in PARTS if part != 'victoria_park' or arguments.data is not None]


def _names(part: str, configurations: Sequence[Configuration]) -> list[str]:
    """Return the files of a part."""
    if part == 'tables':
        return ['tables.md', 'tables.csv', 'tables.json', 'runs.csv']
    if part == 'figures':
        environments = sorted({configuration.environment for configuration in configurations})
        return [*map(_worlds_name, environments), *map(_courses_name, configurations)]
    if part == 'victoria_park':
        return [
            'victoria_park.md', 'victoria_park.csv', 'victoria_park.json', 'figure_6.png',
            'victoria_park_poses.csv', 'victoria_park_landmarks.csv']
    if part in REAL:
        return [f'{part}.md', f'{part}.json']
    if part == 'noise':
        return ['noise.md', 'noise.csv', 'noise.json', 'noise_runs.csv', 'noise.png']
    if part == 'csam':
        return ['csam.md', 'csam.csv', 'csam.json', *CSAM_FIGURES.values()]
    return ['observability.md', 'observability.csv', 'observability.json', 'observability.png']


def _worlds_name(environment: int) -> str:
    return f'figure_{1 + environment}.png'


def _courses_name(configuration: Configuration) -> str:
    return f'figure_{3 + configuration.environment}_{configuration.landmarks}.png'


def _simulate(
    arguments: Namespace, parts: Sequence[str], configurations: Sequence[Configuration]
) -> None:
    """Make the runs; write what came of them, also after an interrupt."""
    source = _source(arguments)
    worlds = {configuration: source.world(configuration) for configuration in configurations}
    numbers = monte_carlo.numbers(arguments)

    def keep(finished: Sequence[dict[str, Errors]]) -> None:
        gained = gathered(worlds, finished, len(numbers))
        if 'tables' in parts:
            _write_tables(arguments, source, gained, numbers[0])
        if 'figures' in parts:
            _draw_figures(arguments.output, worlds, gained)

    monte_carlo.make(arguments, simulate, tasks(worlds, arguments.seed, numbers), keep)


def _source(arguments: Namespace) -> tables.Source:
    """Return where worlds come from."""
    return tables.OWN if arguments.data is None else tables.authors(arguments.data)


def _write_tables(
    arguments: Namespace, source: tables.Source, runs: Runs, first: int
) -> None:
    output: Path = arguments.output
    made = tables.entries(runs, source.chance)
    text = tables.markdown(made, f'{source.about(made)} Seed {arguments.seed}.')
    write_csv(output / 'runs.csv', tables.runs_csv_rows(runs, first))
    _tell(output / 'tables', text, tables.csv_rows(made), tables.as_json(made))


def _draw_figures(output: Path, worlds: Worlds, runs: Runs) -> None:
    from fej_slam_ros.experiments.liu import figures

    for environment in dict.fromkeys(configuration.environment for configuration in worlds):
        of_environment = {c: world for c, world in worlds.items() if c.environment == environment}
        _draw(output / _worlds_name(environment), figures.draw_worlds, of_environment)
    for configuration, by_filter in runs.items():
        name = _courses_name(configuration)
        _draw(output / name, figures.draw_courses, configuration, by_filter)


def _real(arguments: Namespace, part: str) -> None:
    """Make the runs on real data; write what came of them, also after an interrupt."""
    experiment, output = REAL[part], arguments.output

    def keep(runs: Sequence[Any]) -> None:
        text = experiment.markdown(runs)
        write_text(output / f'{part}.md', text)
        write_json(output / f'{part}.json', experiment.summary(runs))
        print(text)

    monte_carlo.make(arguments, experiment.run, experiment.tasks(arguments.data), keep)


def _victoria_park(arguments: Namespace) -> None:
    from fej_slam_ros.experiments.liu import victoria_park_figure

    output: Path = arguments.output
    with tqdm(total=victoria_park.SOLUTIONS, unit='solution', disable=None) as bar:
        def progress(doing: str) -> None:
            bar.set_description(doing)
            bar.update()

        result = victoria_park.reproduce(arguments.data, progress)
    text = victoria_park_report.markdown(result)
    write_csv(output / 'victoria_park_poses.csv', victoria_park_report.pose_rows(result))
    write_csv(output / 'victoria_park_landmarks.csv', victoria_park_report.landmark_rows(result))
    _tell(
        output / 'victoria_park', text, victoria_park_report.csv_rows(result),
        victoria_park_report.summary(result))
    _draw(output / 'figure_6.png', victoria_park_figure.draw, result)


def _observability(arguments: Namespace) -> None:
    from fej_slam_ros.experiments.liu import observability_figure

    output: Path = arguments.output
    teams = TEAMS if arguments.robots is None else ((arguments.robots, arguments.landmarks),)
    cases = [
        observability.ObservabilityCase(robots, landmarks, robots_seen)
        for robots, landmarks in teams
        for robots_seen in ((False, True) if robots > 1 else (False,))]
    results = observability.reproduce(cases, STEPS, arguments.seed)
    text = observability.markdown(results)
    _tell(
        output / 'observability', text, observability.csv_rows(results),
        observability.summary(results))
    _draw(output / 'observability.png', observability_figure.draw, results)


def _csam(arguments: Namespace) -> None:
    """Make the runs of C-SAM, run k with seed S + k - 1."""
    todo = [
        experiment.CsamTask(name, arguments.seed + number - 1)
        for name in experiment.EXPERIMENTS for number in monte_carlo.numbers(arguments)]
    monte_carlo.make(arguments, experiment.run, todo, lambda runs: _write_csam(arguments.output, runs))


def _write_csam(output: Path, runs: Sequence[experiment.CsamRun]) -> None:
    from fej_slam_ros.experiments.andersson import figure

    _tell(
        output / 'csam', report.markdown(runs), report.csv_rows(runs),
        report.summary(runs))
    # The first run of each experiment in which the maps were joined.
    drawn = {run.task.experiment: run.task for run in reversed(runs) if run.gain is not None}
    for name, task in drawn.items():
        solved = experiment.solve(task)
        _draw(output / CSAM_FIGURES[name], figure.draw, solved, solved.joint)


def _noise(arguments: Namespace, configurations: Sequence[Configuration]) -> None:
    """Make the runs of all levels of noise, as `_simulate` does."""
    source = _source(arguments)
    worlds = {configuration: source.world(configuration) for configuration in configurations}
    numbers = monte_carlo.numbers(arguments)
    monte_carlo.make(
        arguments, noise.run, noise.tasks(worlds, arguments.seed, numbers),
        lambda finished: _write_noise(
            arguments, noise.gathered(configurations, finished), numbers[0]))


def _write_noise(arguments: Namespace, samples: noise.Samples, first: int) -> None:
    from fej_slam_ros.experiments.liu import noise_figure

    output: Path = arguments.output
    means = noise.means(samples)
    worlds = 'of our own' if arguments.data is None else "the authors'"
    text = noise_report.markdown(means, f'The worlds are {worlds}. Seed {arguments.seed}.')
    write_csv(output / 'noise_runs.csv', noise_report.runs_csv_rows(samples, first))
    _tell(output / 'noise', text, noise_report.csv_rows(means), noise_report.as_json(means))
    _draw(output / 'noise.png', noise_figure.draw, means)


def _tell(path: Path, text: str, rows: Iterable[Sequence[str]], content: Any) -> None:
    """Write and print a page, with the files of its numbers beside it."""
    write_text(path.with_suffix('.md'), text)
    write_csv(path.with_suffix('.csv'), rows)
    write_json(path.with_suffix('.json'), content)
    print(text)


def _draw(path: Path, draw: Callable[..., None], *what: Any) -> None:
    picture = BytesIO()
    draw(picture, *what)
    write_bytes(path, picture.getvalue())
