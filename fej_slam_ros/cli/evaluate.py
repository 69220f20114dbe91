# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Evaluate a run against ground truth: errors of poses and map, consistency of covariances.

The run is a folder written by replay, smooth or a node, or a bag with the output topics. The
ground truth is a bag with <robot>/ground_truth and ground_truth/landmarks, or a folder with
<robot>.tum (t x y z qx qy qz qw) and optionally landmarks.csv (id,x,y). It is interpolated to the
stamps of the estimate across gaps of at most 0.5 s. Only poses in frame map are compared, unless a
robot has none.

APE and RPE are those of evo. APE is given unaligned, after one rigid motion of the whole team, and
after one of each robot (evo_ape --align); RPE over segments of the estimated path (evo_rpe
--delta_unit m). NEES/3 is e' P^-1 e / 3; its band is the 95 % interval of the mean of a consistent
estimate, for the equivalent number of independent samples (poses of one run are correlated).

Output: evaluation.json; for evo <robot>.tum and <robot>_truth.tum, the compared poses;
<robot>_covariance.csv, their covariances and NEES; and three figures.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fej_slam_ros.atomic_files import (
    csv_bytes, figure, json_bytes, refuse_existing, short_path, write_all)
from fej_slam_ros.cli.arguments import number_option, output_folder, require_matplotlib
from fej_slam_ros.cli.topic_options import add_topic_names, names_in
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation.coverage import REGIONS
from fej_slam_ros.evaluation.run_evaluation import (
    ROBOT_ALIGNED, RunEvaluation, TEAM_ALIGNED, UNALIGNED)
from fej_slam_ros.evaluation.run_result import MatchedPoses
from fej_slam_ros.interrupts import postponed
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files import recorded_truth, run_results
from fej_slam_ros.ros.files.run_files import tum_line
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.tables import interval, text_table

#: Default lengths of the path segments of RPE [m].
RPE_LENGTHS = (1.0, 10.0)
COVARIANCE_HEADER = (
    'stamp_ns', 'cov_xx', 'cov_xy', 'cov_xyaw', 'cov_yy', 'cov_yyaw', 'cov_yawyaw', 'nees')
#: Figures of trajectories, errors and NEES.
FIGURES = ('ways.png', 'errors.png', 'nees.png')
#: Ratio of unaligned errors to those with the team aligned, and NEES/3, of which both are above
#: it only where the ground truth is in another frame.
OTHER_FRAME = 10.0
CONSISTENCY_HEADINGS = (
    'robot', 'NEES/3', '95 % band', 'if independent', 'inside 1 sigma', '2', '3', '95 %',
    'NIS/dof', '95 % band')
#: Last row: what consistent estimates have.
EXPECTED = (
    'expected', '1', '', '', *(f'{100 * p:.1f} %' for p in REGIONS.values()), '1', '')


class Sources(NamedTuple):
    """The ground truth, and the names under which the bags of run and truth are read."""

    run_names: TopicNames
    truth: Path
    truth_names: TopicNames


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'run', type=Path, metavar='DIR|BAG', help='folder of a run, or bag with its output topics')
    parser.add_argument(
        '--truth', type=Path, metavar='BAG|DIR',
        help='ground truth (default: that of BAG, or of the input bag of the run)')
    parser.add_argument(
        '--delta', type=number_option('--delta', 1e-6), nargs='+', default=RPE_LENGTHS,
        metavar='LENGTH', help='lengths of the path segments of RPE [m] (default: 1 10)')
    parser.add_argument(
        '--output', type=output_folder, metavar='DIR',
        help='folder for the results (default: DIR/evaluation, or BAG_evaluation)')
    parser.add_argument('--no-plots', dest='plots', action='store_false', help='draw no figures')
    parser.add_argument('--force', action='store_true', help='replace earlier results')
    add_topic_names(parser)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the run, write the files and print the tables."""
    path: Path = arguments.run
    if not path.exists():
        raise UserError(
            f'{path} does not exist: give the output of replay or smooth, or a rosbag2')
    if arguments.plots:
        require_matplotlib('give --no-plots')
    is_bag = run_results.is_bag(path)
    output: Path = arguments.output or (
        short_path(Path(f'{path.resolve()}_evaluation')) if is_bag else path / 'evaluation')
    with OutputLock.of_folder(output):
        refuse_existing([output / 'evaluation.json'], arguments.force)
        return _evaluate(arguments, is_bag, output)


def _evaluate(arguments: argparse.Namespace, is_bag: bool, output: Path) -> int:
    path: Path = arguments.run
    sources = _sources(arguments)
    names, truth = sources.run_names, sources.truth
    result = run_results.read_bag(path, names) if is_bag else run_results.read_folder(path)
    true_data, invalid_truth = recorded_truth.read_truth(truth, sources.truth_names)
    evaluation = RunEvaluation(result, true_data, arguments.delta)
    report = {'run': str(path), 'truth': str(truth), **evaluation.as_dict()}
    for name, count, what, source in (
            ('invalid_messages', result.invalid_messages, 'messages', path),
            ('invalid_true_messages', invalid_truth, 'messages of ground truth', truth)):
        if count:
            report[name] = count
            print(f'{count} invalid {what} in {source} are left out')
    contents: dict[Path, bytes] = {}
    for name, matched in evaluation.matched.items():
        contents |= _robot_contents(output, name, matched, evaluation.nees.get(name))
    refuse_existing(contents, arguments.force)
    if arguments.plots:
        refuse_existing([output / name for name in FIGURES], arguments.force)
        contents |= _pictures(output, evaluation)
    with postponed():
        write_all(contents | {output / 'evaluation.json': json_bytes(report)})
        for path in _of_evaluation(output) - contents.keys() if arguments.force else ():
            path.unlink(missing_ok=True)
    print('\n'.join([*_tables(report, result.shared_ids), f'wrote {output}']))
    return 0


def _pictures(output: Path, evaluation: RunEvaluation) -> dict[Path, bytes]:
    """Return the figures by their files."""
    from fej_slam_ros.evaluation import figures

    draw_all = figures.draw_trajectories, figures.draw_errors, figures.draw_nees
    return {output / name: figure(draw, evaluation) for name, draw in zip(FIGURES, draw_all)}


def _sources(arguments: argparse.Namespace) -> Sources:
    """Return the ground truth and the names: those in the options, by default those of the run."""
    run, given_truth = arguments.run, arguments.truth
    if given_truth is not None and not given_truth.exists():
        raise UserError(
            f'--truth: {given_truth} does not exist: give a rosbag2, or a folder of TUM files')
    is_bag = run_results.is_bag(run)
    if given_truth is not None and not is_bag and given_truth.samefile(run):
        raise UserError(
            f'--truth: {given_truth} is the run itself: give its ground truth, or leave --truth'
            ' out if that is in the bag of the run')
    # The bag of replay --bag lies in the folder whose summary names the input bag.
    folder = run.resolve().parent if is_bag else run
    truth = given_truth or run_results.bag_of(folder)
    bags = [path for path in (run, truth) if path is not None and run_results.is_bag(path)]
    given, stored = names_in(arguments, *bags), run_results.names_of(folder)
    run_names = given or TopicNames(namespace=stored.namespace)
    if given_truth is not None:
        return Sources(run_names, given_truth, given)
    if is_bag and recorded_truth.has_truth(run, run_names):
        return Sources(run_names, run, run_names)
    if truth is None:
        if not is_bag:
            run_results.refuse_other_folder(run)
        raise UserError(
            f'{run} has no ground truth, and its input bag is unknown or missing:'
            f' give the truth {recorded_truth.TRUTH_OR_NIS}')
    return Sources(run_names, truth, given or stored)


def _of_evaluation(output: Path) -> set[Path]:
    """Return the files in a folder that are of evaluations only; a run has <robot>.tum, too."""
    return {
        *(output / name for name in FIGURES), *output.glob('*_truth.tum'),
        *output.glob('*_covariance.csv')}


def _robot_contents(
    output: Path, name: str, matched: MatchedPoses, nees: Array | None
) -> dict[Path, bytes]:
    """Return the contents of the files of a robot."""
    stamps = matched.stamps.tolist()
    contents = {
        output / file: ''.join(
            f'{tum_line(stamp, pose)}\n' for stamp, pose in zip(stamps, poses)).encode()
        for file, poses in ((f'{name}.tum', matched.poses), (f'{name}_truth.tum', matched.true))}
    values = [np.nan] * len(stamps) if nees is None else nees.tolist()
    contents[output / f'{name}_covariance.csv'] = csv_bytes([COVARIANCE_HEADER, *(
        (stamp, *P[np.triu_indices(3)].tolist(), value if np.isfinite(value) else '')
        for stamp, P, value in zip(stamps, matched.P, values))])
    return contents


def _tables(report: Mapping[str, Any], shared_ids: bool) -> Iterator[str]:
    robots = report['robots']
    rows = {**robots, 'all': report['all']} if len(robots) > 1 else robots
    lengths = [*report['all']['rpe']]
    yield text_table(
        ('robot', 'poses', 'compared', 'APE [m]', 'team aligned', 'robot aligned', 'APE [rad]',
         'team aligned', *(f'RPE {length} m' for length in lengths)),
        (_error_row(name, row, lengths) for name, row in rows.items()))
    yield ''
    yield text_table(
        CONSISTENCY_HEADINGS,
        [*(_consistency_row(name, row) for name, row in rows.items()), EXPECTED])
    yield ''
    yield _map_line(report['landmarks'], shared_ids)
    for name, robot in robots.items():
        if robot['frame'] != 'map':
            yield f'{name} was never in map: it is compared only after its own alignment'
    if _is_in_another_frame(report['all']):
        yield (
            'The ground truth is probably in another frame than map: then only aligned errors and'
            ' RPE have a meaning.')
    yield 'Errors are RMSE. The band of NEES/3 is for the estimated number of independent poses.'


def _is_in_another_frame(total: Mapping[str, Any]) -> bool:
    """Return whether one motion of the team explains nearly all errors, and no covariance does."""
    unaligned, aligned, nees = total['ape'][UNALIGNED], total['ape'][TEAM_ALIGNED], total['nees']
    return None not in (unaligned, aligned, nees) and (
        unaligned['position']['rmse'] > OTHER_FRAME * aligned['position']['rmse']
        and nees['mean'] > OTHER_FRAME)


def _error_row(name: str, row: Mapping[str, Any], lengths: Sequence[str]) -> tuple[str, ...]:
    ape, rpe = row.get('ape', {}), row.get('rpe', {})
    return (
        name, str(row.get('poses', '')), str(row['compared']),
        *(_rmse(ape.get(kind), 'position') for kind in (UNALIGNED, TEAM_ALIGNED, ROBOT_ALIGNED)),
        *(_rmse(ape.get(kind), 'heading') for kind in (UNALIGNED, TEAM_ALIGNED)),
        *(_rmse(rpe.get(length), 'position') for length in lengths))


def _rmse(errors: Mapping[str, Any] | None, kind: str) -> str:
    return '-' if errors is None else f'{errors[kind]["rmse"]:.4f}'


def _consistency_row(name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    nees, nis = row.get('nees'), row['nis']
    nees_cells = ['-'] * 7 if nees is None else [
        f'{nees["mean"]:.2f}', interval(nees['band']), interval(nees['band_if_independent']),
        *(f'{100 * inside:.0f} %' for inside in nees['coverage'].values())]
    nis_cells = ['-'] * 2 if nis is None else [f'{nis["mean"]:.2f}', interval(nis['band'])]
    return name, *nees_cells, *nis_cells


def _map_line(landmarks: Mapping[str, Any], shared_ids: bool) -> str:
    if not landmarks['compared']:
        reason = '' if shared_ids else ': each robot has its own landmark IDs'
        return f'{landmarks["in_map"]} landmarks in map, none with ground truth{reason}'
    aligned, nees = landmarks[TEAM_ALIGNED], landmarks['nees']
    return (
        f'{landmarks["compared"]} of {landmarks["in_map"]} landmarks in map have ground truth:'
        f' RMSE {landmarks[UNALIGNED]["rmse"]:.4f} m'
        + ('' if aligned is None else f', {aligned["rmse"]:.4f} m with the team aligned')
        + ('' if nees is None else f', NEES/2 {nees["mean"]:.2f}'))
