# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Judge a run against ground truth: errors of poses and map, and whether covariances can be believed.

The run is a folder that replay, smooth or a node wrote, or a bag with its output topics. The truth
is a bag with <robot>/ground_truth and ground_truth/landmarks, or a folder with <robot>.tum (t x y
z qx qy qz qw) and, of landmarks, landmarks.csv (id,x,y). Where stamps differ the truth is
interpolated, across 0.5 s at most. Poses count that are in the frame map.

APE and RPE are those of evo: APE as estimated, after one rigid motion of the whole team, and after
one of each robot (evo_ape --align); RPE over pieces of the estimated way (evo_rpe --delta_unit m).
NEES is e' P^-1 e / 3; its band is where the mean of a consistent estimate lies with 95 %, for as
many independent samples as the run counts: poses of one run share their errors.

Written are evaluation.json; for evo <robot>.tum and <robot>_truth.tum, the poses that were
compared, as estimated; <robot>_covariance.csv, their covariances and NEES; and three pictures.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.atomic_files import (
    refuse_existing, write_bytes, write_csv, write_json, write_text)
from fej_slam_ros.cli.run_table import format_table
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.evaluation.run_evaluation import (
    ROBOT_ALIGNED, RunEvaluation, TEAM_ALIGNED, UNALIGNED)
from fej_slam_ros.evaluation.run_result import MatchedPoses
from fej_slam_ros.ros.files import run_results
from fej_slam_ros.ros.files.run_files import tum_line

LENGTHS = (1.0, 10.0)
PICTURES = ('ways.png', 'errors.png', 'nees.png')
COVARIANCE_HEADER = (
    'stamp_ns', 'cov_xx', 'cov_xy', 'cov_xyaw', 'cov_yy', 'cov_yyaw', 'cov_yawyaw', 'nees')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        'run', type=Path, metavar='DIR|BAG', help='what a run left: its folder, or its topics')
    parser.add_argument(
        '--truth', type=Path, metavar='BAG|DIR',
        help='the truth (default: BAG itself where it has any, else the bag that the run was made'
        ' from)')
    parser.add_argument(
        '--delta', type=_length, nargs='+', default=LENGTHS, metavar='LENGTH',
        help='lengths of the pieces of the way for RPE [m] (default: 1 10)')
    parser.add_argument(
        '--output', type=Path, metavar='DIR',
        help='folder for the results (default: DIR/evaluation, or BAG_evaluation)')
    parser.add_argument(
        '--no-plots', dest='plots', action='store_false', help='draw no pictures')
    parser.add_argument(
        '--force', action='store_true', help='replace the results of an earlier evaluation')


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the run, write the files and print the tables."""
    path: Path = arguments.run
    if not path.is_dir():
        raise UserError(f'{path} is no folder: give what replay or smooth wrote, or a rosbag2')
    if arguments.plots and find_spec('matplotlib') is None:
        raise UserError("matplotlib is missing: pip install '.[plot]', or give --no-plots")
    output = arguments.output or _output(path)
    refuse_existing([output / 'evaluation.json'], arguments.force)
    is_bag = run_results.is_bag(path)
    outcome = run_results.read_bag(path) if is_bag else run_results.read_folder(path)
    truth = _truth(arguments)
    judged = RunEvaluation(outcome, run_results.read_truth(truth), arguments.delta)
    told = {'run': str(path), 'truth': str(truth), **judged.figures()}
    for name, of in judged.compared.items():
        _write_robot(output, name, of, judged.ratings.get(name))
    if arguments.plots:
        _draw(output, judged)
    write_json(output / 'evaluation.json', told)
    print('\n'.join([*_tables(told, outcome.shared_ids), f'wrote {output}']))
    return 0


def _length(word: str) -> float:
    try:
        length = float(word)
    except ValueError:
        length = 0.0
    if not 0.0 < length < np.inf:
        raise UsageError(f'--delta: {word} is no length above 0 m')
    return length


def _output(path: Path) -> Path:
    if run_results.is_bag(path):
        return path.resolve().with_name(f'{path.resolve().name}_evaluation')
    return path / 'evaluation'


def _truth(arguments: argparse.Namespace) -> Path:
    """Return where the truth is."""
    if arguments.truth is not None:
        given: Path = arguments.truth
        if not given.is_dir():
            raise UserError(f'--truth: {given} is no folder: give a rosbag2, or TUM files in one')
        return given
    path: Path = arguments.run
    if run_results.is_bag(path) and run_results.has_truth(path):
        return path
    # The bag that replay --bag writes lies in the folder that tells from what it was made.
    source = run_results.bag_of(path.resolve().parent if run_results.is_bag(path) else path)
    if source is None:
        raise UserError(
            f'{path} has no ground truth and does not tell where it comes from, or that is gone:'
            ' give the truth with --truth')
    return source


def _write_robot(output: Path, name: str, of: MatchedPoses, ratings: np.ndarray | None) -> None:
    """Write what evo reads of a robot, and what it does not."""
    stamps = of.stamps.tolist()
    for file, poses in ((f'{name}.tum', of.poses), (f'{name}_truth.tum', of.true)):
        lines = (tum_line(stamp, pose) for stamp, pose in zip(stamps, poses))
        write_text(output / file, '\n'.join(lines) + '\n')
    rated = np.full(len(stamps), np.nan) if ratings is None else ratings
    write_csv(output / f'{name}_covariance.csv', [COVARIANCE_HEADER, *(
        (stamp, *P[np.triu_indices(3)].tolist(), nees if np.isfinite(nees) else '')
        for stamp, P, nees in zip(stamps, of.P, rated.tolist()))])


def _draw(output: Path, judged: RunEvaluation) -> None:
    from fej_slam_ros.evaluation import figures

    pictures = figures.draw_ways, figures.draw_errors, figures.draw_nees
    for name, draw in zip(PICTURES, pictures):
        picture = BytesIO()
        draw(picture, judged)
        write_bytes(output / name, picture.getvalue())


def _tables(told: Mapping[str, Any], shared_ids: bool) -> Iterator[str]:
    """Yield the tables of errors and of consistency, and what is to be said of the map."""
    rows = {**told['robots'], 'all': told['all']} if len(told['robots']) > 1 else told['robots']
    lengths = [*told['all']['rpe']]
    yield format_table([
        ('robot', 'poses', 'compared', 'APE [m]', 'team aligned', 'robot aligned', 'APE [rad]',
         'team aligned', *(f'RPE {length} m' for length in lengths)),
        *(_error_row(name, of, lengths) for name, of in rows.items())])
    yield ''
    yield format_table([
        ('robot', 'NEES/3', '95 % band', 'if independent', 'inside 1 sigma', '2', '3', '95 %',
         'NIS/dof', '95 % band'),
        *(_consistency_row(name, of) for name, of in rows.items())])
    yield ''
    yield _map_line(told['landmarks'], shared_ids)
    for name, of in told['robots'].items():
        if of['frame'] != 'map':
            yield f'{name} was never in map: it is compared only after an alignment of its own'
    yield 'errors are RMSE; the band is for as many independent poses as the run counts, about'


def _error_row(name: str, of: Mapping[str, Any], lengths: Sequence[str]) -> tuple[str, ...]:
    ape, rpe = of.get('ape', {}), of.get('rpe', {})
    return (
        name, str(of.get('poses', '')), str(of['compared']),
        *(_rmse(ape.get(kind), 'position') for kind in (UNALIGNED, TEAM_ALIGNED, ROBOT_ALIGNED)),
        *(_rmse(ape.get(kind), 'heading') for kind in (UNALIGNED, TEAM_ALIGNED)),
        *(_rmse(rpe.get(length), 'position') for length in lengths))


def _rmse(of: Mapping[str, Any] | None, kind: str) -> str:
    return '-' if of is None else f'{of[kind]["rmse"]:.4f}'


def _consistency_row(name: str, of: Mapping[str, Any]) -> tuple[str, ...]:
    nees, nis = of.get('nees'), of['nis']
    told = ['-'] * 7 if nees is None else [
        f'{nees["mean"]:.2f}', _band(nees['band']), _band(nees['band_if_independent']),
        *(f'{100 * inside:.0f} %' for inside in nees['coverage'].values())]
    return (
        name, *told,
        *(('-', '-') if nis is None else (f'{nis["mean"]:.2f}', _band(nis['band']))))


def _band(band: Sequence[float]) -> str:
    return f'{band[0]:.2f} to {band[1]:.2f}'


def _map_line(told: Mapping[str, Any], shared_ids: bool) -> str:
    if not told['compared']:
        why = '' if shared_ids else ": numbers are each robot's own"
        return f'{told["in_map"]} landmarks in map, none with a truth{why}'
    fitted = told[TEAM_ALIGNED]
    return (
        f'{told["compared"]} of {told["in_map"]} landmarks in map have a truth: RMSE'
        f' {told[UNALIGNED]["rmse"]:.4f} m'
        + ('' if fitted is None else f', {fitted["rmse"]:.4f} m with the team aligned')
        + ('' if told['nees'] is None else f', NEES/2 {told["nees"]["mean"]:.2f}'))
