# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Calibrate odometry and noise in a bag, and write parameters that correct them.

Systematic errors of the odometry of each robot, odometry_scale and odometry_turn_bias, are
estimated from ground truth over 5 s, or else from landmarks that are observed again within 3 s.

The noise scales are factors on standard deviations: odometry_noise_scale, landmark_noise_scale and
robot_noise_scale. With ground truth they are estimated from errors over 5 s of odometry and of
observations; a robot with enough data has its own scale. The other scales are maximum-likelihood
estimates from the innovations of the estimator without a gate, the same for all robots. Gross
errors, beyond a chi-square probability of 0.999999, are ignored.

Observations without IDs are matched by the estimator, again and again with the parameters found.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
import math
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from fej_slam_ros.atomic_files import write_text
from fej_slam_ros.cli.arguments import add_bag_and_parameters, integer_option
from fej_slam_ros.cli.bag_input import team_messages
from fej_slam_ros.cli.topic_options import add_topic_names, names_in, node_names
from fej_slam_ros.core.calibration.from_innovations import (
    counts, most_likely_scales, Received, run as run_estimator)
from fej_slam_ros.core.calibration.from_truth import (
    DOF, ERROR_WINDOW, Errors, MAX_RELATIVE_ERROR, noise_scales, NoiseScale, normalized_errors)
from fej_slam_ros.core.calibration.matched_ids import (
    are_without_ids, MatchedRecords, with_matched_ids)
from fej_slam_ros.core.calibration.odometry_errors import (
    fit_to_landmarks, fit_to_truth, MAX_ERROR, OdometryErrors)
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, Odometry, Scan, TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import claimed
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.session.record_collector import collect, RecordCollector
from fej_slam_ros.tables import number, text_table

SCORE_HEADINGS = (
    'robot', 'NIS/dof before', 'after', 'NEES/3 before', 'after', 'gated before', 'after')
FACTOR_HEADINGS = (
    'noise', 'robot', 'factor', 'standard error', 'samples', 'from', 'written')
ODOMETRY_HEADINGS = (
    'odometry of', 'distance', 'standard error', 'turn', 'standard error', 'turn bias [rad/s]',
    'standard error', 'pairs', 'from')

#: Range of the noise scale parameters.
MIN_SCALE, MAX_SCALE = 1e-3, 1e3
#: Factor on noise beyond which something else is wrong.
MAX_USUAL = 5.0
#: Maximum number of times that observations without IDs are matched, and the change of the
#: logarithm of a factor below which they are not matched again.
MAX_ROUNDS, MAX_CHANGE = 8, 0.05


class ScaleEstimate(NamedTuple):
    """Scales of one kind of noise by robot; '' is the scale of all robots."""

    source: str
    scales: Mapping[str, NoiseScale]


#: Estimates by kind of noise.
Estimates = Mapping[str, ScaleEstimate]
#: Source and systematic errors of the odometry of each robot with enough data.
RobotErrors = Mapping[str, tuple[str, OdometryErrors]]


class Calibration(NamedTuple):
    """What was found, and the records from which."""

    values: Mapping[str, object]  #: the corrected parameters
    odometry: RobotErrors
    estimates: Estimates
    matched: MatchedRecords

    def scales(self) -> dict[str, float]:
        """Return the scale of all robots that was written, by kind of noise."""
        return {
            kind: estimate.scales[''].scale for kind, estimate in self.estimates.items()
            if _is_known(self.estimates, kind)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_and_parameters(parser)
    parser.add_argument(
        '--output', type=Path, required=True, metavar='FILE.yaml',
        help='the same parameters, corrected')
    parser.add_argument(
        '--from', dest='source', choices=('truth', 'innovations'),
        help='use only this source (default: ground truth, and innovations where it is missing)')
    parser.add_argument(
        '--seconds', metavar='N', type=integer_option('--seconds', 1), default=120,
        help='use the innovations of the first N s; takes 30 to 100 runs (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='replace an existing FILE.yaml')
    add_topic_names(parser)


def run(arguments: argparse.Namespace) -> int:
    """Estimate the scales, write them, and print them with the scores before and after."""
    with claimed(arguments.output, arguments.force):
        return _calibrate(arguments)


def _calibrate(arguments: argparse.Namespace) -> int:
    nodes = node_names(arguments, 'estimator')
    settings = parameters.load(arguments.params, nodes)
    values = parameters.load_values(arguments.params, nodes, parameters.no_warning)
    names = names_in(arguments, arguments.bag)
    messages = team_messages(arguments.bag, settings.estimation, names)
    # The filter that linearises about true landmarks needs their IDs.
    collector = collect(
        messages, settings, LINEARIZATIONS[settings.estimation.filter].needs_truth)
    if not counts(collector.records)['odometry']:
        raise UserError(
            f'{arguments.bag} has no valid odometry: replay it to see the rejection reasons')
    found = _calibrated(arguments, values, collector.records)
    corrected, odometry, estimates = found.values, found.odometry, found.estimates
    if corrected == values:
        raise UserError(
            f'{arguments.bag} has too little data to calibrate any noise: record a longer run,'
            ' with ground truth or with more observations of the same landmarks')
    before = _scores('before', values, collector.records)
    after = _scores('after', corrected, collector.records)
    write_text(arguments.output, parameters.dump_values(corrected))
    print(_factor_table(estimates))
    print(text_table(SCORE_HEADINGS, (
        (robot, *(cell for cells in zip(before[robot], after[robot]) for cell in cells))
        for robot in before)))
    if odometry:
        print(_odometry_table(odometry))
    print('\n'.join([
        *_odometry_remarks(settings.estimation, odometry), *_remarks(collector, found),
        f'wrote {arguments.output}']))
    return 0


def _calibrated(
    arguments: argparse.Namespace, values: Mapping[str, object], records: Sequence[Received]
) -> Calibration:
    """Return the calibration of records; matches of observations without IDs depend on it."""
    if not are_without_ids(records):
        return _calibrated_by(arguments, values, MatchedRecords(records))
    settings, scales = _parsed(values), dict[str, float]()
    for _ in range(MAX_ROUNDS):
        matched = with_matched_ids(settings.estimation, records, prior_map(settings))
        found = _calibrated_by(arguments, values, matched)
        before, scales = scales, found.scales()
        if before.keys() == scales.keys() and all(
                abs(math.log(scales[kind] / before[kind])) < MAX_CHANGE for kind in scales):
            break
        settings = _parsed(found.values)
    return found


def _calibrated_by(
    arguments: argparse.Namespace, values: Mapping[str, object], matched: MatchedRecords
) -> Calibration:
    """Return the calibration of records in which all observations have IDs."""
    odometry = _odometry_errors(arguments.source, _parsed(values).estimation, matched.records)
    corrected = _with_odometry_errors(values, odometry)
    estimates = _estimate(arguments, corrected, matched.records)
    return Calibration(_corrected(corrected, estimates), odometry, estimates, matched)


def _parsed(values: Mapping[str, object]) -> parameters.RunSettings:
    # What is wrong in the file was written when it was loaded.
    return parameters.parse(values, parameters.no_warning)


def _odometry_errors(
    source: str | None, settings: Settings, records: Sequence[Received]
) -> RobotErrors:
    """Return source and systematic errors of the odometry of each robot with enough data."""
    truth, robots = RecordedTruth(), {robot.name: robot for robot in settings.robots}
    of_robots: dict[str, tuple[list[Odometry], list[Scan]]] = {
        robot: ([], []) for robot in robots}
    for record, _ in records:
        if isinstance(record, TruePose):
            truth.add(record)
        elif isinstance(record, Odometry):
            of_robots[record.robot][0].append(record)
        elif isinstance(record, Scan):
            of_robots[record.robot][1].append(record)
    found = {}
    for robot, (odometry, scans) in of_robots.items():
        given = np.array([*robots[robot].odometry_scale, robots[robot].odometry_turn_bias])
        fit = None if source == 'innovations' else fit_to_truth(odometry, truth, given)
        if fit is not None:
            found[robot] = 'truth', fit
        elif source != 'truth':
            fit = fit_to_landmarks(odometry, sorted(scans, key=attrgetter('stamp')), given)
            if fit is not None:
                found[robot] = 'landmarks', fit
    return found


def _with_odometry_errors(
    values: Mapping[str, object], found: RobotErrors
) -> dict[str, object]:
    """Return parameters with the systematic errors that were found, where they are others."""
    corrected = dict(values)
    present = {robot.name: robot for robot in _parsed(values).estimation.robots}
    for robot, (_, errors) in found.items():
        distance, turn, bias = (
            float(f'{value:.4g}') if is_known else float(value)
            for value, is_known in zip(errors.values, errors.is_known))
        if (distance, turn) != present[robot].odometry_scale:
            corrected[f'{robot}.odometry_scale'] = [distance, turn]
        if bias != present[robot].odometry_turn_bias:
            corrected[f'{robot}.odometry_turn_bias'] = bias
    return corrected


def _estimate(
    arguments: argparse.Namespace, values: Mapping[str, object], records: Sequence[Received]
) -> Estimates:
    """Return the scales of the requested sources, ground truth first."""
    settings, amounts = _parsed(values), counts(records)
    errors: Mapping[str, Errors] = {}
    if arguments.source != 'innovations':
        errors = normalized_errors([record for record, _ in records], settings.estimation)
    if arguments.source == 'truth' and not errors:
        raise UserError(
            f'{arguments.bag} has no ground truth that covers an observation or'
            f' {ERROR_WINDOW / NS:g} s of odometry: leave out --from truth')
    estimates = {
        kind: ScaleEstimate('truth', noise_scales(samples, DOF[kind]))
        for kind, samples in errors.items()}
    rest = [kind for kind in DOF if amounts[kind] and not _is_known(estimates, kind)]
    has_innovations = bool(amounts['landmark'] or amounts['robot'])
    if not estimates and not has_innovations:
        raise UserError(
            f'{arguments.bag} has no observations, which calibration without ground truth needs:'
            ' record <robot>/ground_truth, or landmarks')
    if not rest or not has_innovations or arguments.source == 'truth':
        return estimates
    corrected = _parsed(_corrected(values, estimates)).estimation
    with tqdm(desc='search', unit='run', disable=None) as bar:
        likeliest = most_likely_scales(
            corrected, _beginning(records, arguments.seconds), rest,
            prior_map(settings), bar.update)
    return estimates | {
        kind: ScaleEstimate('innovations', {'': noise}) for kind, noise in likeliest.items()}


def _beginning(records: Sequence[Received], seconds: int) -> list[Received]:
    """Return the records up to a time after the first odometry, and the true landmarks."""
    first = min(record.stamp for record, _ in records if isinstance(record, Odometry))
    return [
        (record, received) for record, received in records
        if isinstance(record, TrueLandmarks) or record.stamp <= first + seconds * NS]


def _corrected(values: Mapping[str, object], estimates: Estimates) -> dict[str, object]:
    corrected = dict(values)
    for kind in estimates:
        if _is_known(estimates, kind):
            name = f'{kind}_noise_scale'
            corrected = {key: x for key, x in corrected.items() if key.split('.')[-1] != name}
            for robot, noise in estimates[kind].scales.items():
                scale = min(max(noise.scale, MIN_SCALE), MAX_SCALE)
                corrected[f'{robot}.{name}'.lstrip('.')] = float(f'{scale:.4g}')
    return corrected


def _is_known(estimates: Estimates, kind: str) -> bool:
    return kind in estimates and estimates[kind].scales[''].is_known()


def _scores(
    name: str, values: Mapping[str, object], records: Sequence[Received]
) -> dict[str, tuple[str, str, str]]:
    """Return NIS/dof, NEES/3 and the number of gated observations of each robot, as text."""
    settings = _parsed(values)
    estimator, _ = run_estimator(
        settings.estimation, tqdm(records, name, unit='msg', disable=None),
        prior_map(settings))
    scores = {}
    for robot in estimator.robots:
        nis, score = estimator.innovations.nis[robot], estimator.evaluation.scores.get(robot)
        rejected = estimator.statistics.rejection_counts[robot]
        gated = rejected[RejectionReason.GATED] + rejected[RejectionReason.MOVED_LANDMARK]
        scores[robot] = (
            number(nis.total / nis.dof if nis.dof else None, '.2f'),
            number(None if score is None else score.mean_nees_per_dof(), '.2f'), str(gated))
    return scores


def _odometry_table(found: RobotErrors) -> str:
    return text_table(ODOMETRY_HEADINGS, (
        (robot, *(
            cell for value, sigma, is_known in zip(errors.values, errors.sigma, errors.is_known)
            for cell in (number(value if is_known else None, '.4f'), f'{sigma:.4f}')),
         str(errors.pairs), source)
        for robot, (source, errors) in found.items()))


def _odometry_remarks(
    settings: Settings, found: RobotErrors
) -> Iterator[str]:
    unknown = [robot.name for robot in settings.robots if robot.name not in found]
    if unknown:
        yield (
            'too little data to find systematic errors of the odometry of'
            f' {", ".join(unknown)}: odometry_scale and odometry_turn_bias are unchanged')
    distance, turn, bias = MAX_ERROR
    for robot, (_, errors) in found.items():
        if errors.is_at_limit:
            yield (
                f'odometry of {robot} is wrong by {100 * distance:.0f} % in distance,'
                f' {100 * turn:.0f} % in turns or {bias:.2g} rad/s, or more: check its units,'
                ' wheel radius and wheel base')


def _factor_table(estimates: Estimates) -> str:
    return text_table(FACTOR_HEADINGS, (
        (kind, robot or 'all', f'{noise.scale:.3f}', f'{noise.scale * noise.relative_error:.3f}',
         str(noise.samples), estimate.source, 'yes' if _is_known(estimates, kind) else 'no')
        for kind, estimate in estimates.items() for robot, noise in estimate.scales.items()))


def _remarks(collector: RecordCollector, found: Calibration) -> Iterator[str]:
    estimates, amounts = found.estimates, counts(found.matched.records)
    for kind in DOF:
        if amounts[kind] and not _is_known(estimates, kind):
            yield (
                f'too little data to know {kind}_noise_scale to {100 * MAX_RELATIVE_ERROR:.0f} %:'
                ' it is unchanged')
    for kind, estimate in estimates.items():
        if not 1.0 / MAX_USUAL < estimate.scales[''].scale < MAX_USUAL:
            yield (
                f'{kind}_noise_scale {estimate.scales[""].scale:.3g} is more than wrong noise'
                ' explains: check units, frames and sensor poses, doctor names some of them')
    if found.matched.counts:
        yield (
            '{matched} observations without ID matched landmarks, {new} began some, {doubtful} may'
            ' be of several and were left out'.format_map(found.matched.counts))
    without_id = collector.statistics.total(RejectionReason.NO_IDENTITY)
    if without_id:
        yield f'{without_id} observations without ID were left out, also of NIS and NEES'
