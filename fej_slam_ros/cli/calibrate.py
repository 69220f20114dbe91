# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Calibrate odometry and noise in a bag, and write parameters that correct them.

Systematic errors of the odometry of each robot, odometry_scale and odometry_turn_bias, are
estimated from ground truth over 5 s, or else from landmarks that are observed again within 3 s.
So are those of its observations, observation_range_scale and observation_bearing_bias; without
ground truth, the former by the map that robots share, the latter by the direction of travel.

The growth of the noise of observations with the range, observation_noise_growth, is that of the
largest likelihood of their errors, or of innovations.

The noise scales are factors on standard deviations: odometry_noise_scale, landmark_noise_scale and
robot_noise_scale. With ground truth they are estimated from errors over 5 s of odometry and of
observations; a robot with enough data has its own scale. The other scales are those at which the
innovations of the estimator are consistent over 5 s; they are the same for all robots, but for
odometry of robots that differ from the others. Gross errors, beyond a chi-square probability of
0.999999, are ignored.

Observations without IDs are matched by the estimator, again and again with the parameters found.
"""

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from fej_slam_ros.atomic_files import write_text
from fej_slam_ros.cli.arguments import add_bag_and_parameters, integer_option
from fej_slam_ros.cli.bag_input import team_messages
from fej_slam_ros.cli.calibration_run import (
    calibrated, Calibration, Estimates, INNOVATIONS, is_known, nis_per_dof, parsed, TRUTH,
    uneven_robots, within_limits)
from fej_slam_ros.cli.run_table import matched_in_words
from fej_slam_ros.cli.topic_options import add_topic_names, names_in, node_names
from fej_slam_ros.core.calibration import observation_errors, odometry_errors
from fej_slam_ros.core.calibration.from_innovations import counts, run as run_estimator
from fej_slam_ros.core.calibration.from_truth import DOF
from fej_slam_ros.core.calibration.robot_scales import MAX_RELATIVE_ERROR, NoiseScale
from fej_slam_ros.core.calibration.shown_errors import ErrorEstimate
from fej_slam_ros.core.calibration.systematic_errors import SystematicErrors
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.records import Received
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
OBSERVATION_HEADINGS = (
    'observations of', 'range', 'standard error', 'bearing bias [rad]', 'standard error',
    'observations', 'from')

#: Factor on noise beyond which something else is probably wrong.
MAX_USUAL = 5.0
#: Ratio of a robot's noise of every kind to the least of the team from which its ground truth is
#: probably wrong.
MAX_EVERY_KIND = 1.3


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
    values = parameters.load_current_values(arguments.params, nodes)
    names = names_in(arguments, arguments.bag)
    messages = team_messages(arguments.bag, settings.estimation, names)
    # The filter that linearises about true landmarks needs their IDs.
    collector = collect(
        messages, settings, LINEARIZATIONS[settings.estimation.filter].needs_truth)
    if not counts(collector.records)['odometry']:
        raise UserError(
            f'{arguments.bag} has no valid odometry: replay it to see the rejection reasons')
    found = calibrated(arguments, values, collector.records)
    corrected = found.values
    if corrected == values and not any(
            is_known(found.estimates, kind) for kind in found.estimates):
        raise UserError(
            f'{arguments.bag} has too little data to calibrate any noise: record a longer run,'
            ' with ground truth or with more observations of the same landmarks')
    before = _scores('before', values, collector.records)
    after = _scores('after', corrected, collector.records)
    write_text(arguments.output, parameters.dump_values(corrected))
    print(_factor_table(found.estimates))
    print(text_table(SCORE_HEADINGS, (
        (robot, *(
            cell for scores in zip(before[robot].cells(), after[robot].cells())
            for cell in scores)) for robot in before)))
    if found.errors.odometry():
        print(text_table(ODOMETRY_HEADINGS, _error_rows(
            found.errors.odometry_by_truth, found.errors.odometry_by_landmarks)))
    if found.errors.observations():
        print(text_table(OBSERVATION_HEADINGS, _error_rows(
            found.errors.observations_by_truth, found.errors.observations_by_landmarks)))
    print('\n'.join([
        *_error_remarks(settings.estimation, found.errors), *_noise_remarks(found),
        *_remarks(collector, found),
        *_uneven(before, found.estimates), *_wrong_truth(found.estimates, before),
        f'wrote {arguments.output}']))
    return 0


class _Score(NamedTuple):
    """How consistent the estimate of a robot is."""

    nis_per_dof: float | None
    nees_per_dof: float | None
    gated: int  #: number of observations

    def cells(self) -> Sequence[str]:
        """Return the same for a table."""
        return (
            number(self.nis_per_dof, '.2f'), number(self.nees_per_dof, '.2f'), str(self.gated))


def _scores(
    name: str, values: Mapping[str, object], records: Sequence[Received]
) -> dict[str, _Score]:
    """Return the score of each robot; `name` is that of the progress bar."""
    settings = parsed(values)
    estimator, _ = run_estimator(
        settings.estimation, tqdm(records, name, unit='msg', disable=None),
        prior_map(settings))
    scores, nis = {}, nis_per_dof(estimator)
    for robot in estimator.robots:
        score = estimator.evaluation.scores.get(robot)
        rejected = estimator.statistics.rejection_counts[robot]
        scores[robot] = _Score(
            nis.get(robot), None if score is None else score.mean_nees_per_dof(),
            rejected[RejectionReason.GATED] + rejected[RejectionReason.MOVED_LANDMARK])
    return scores


def _uneven(scores: Mapping[str, _Score], estimates: Estimates) -> Iterator[str]:
    """Yield that robots differ so much that one scale for all of them cannot fit."""
    has_own = any(estimate.scales.keys() - {''} for estimate in estimates.values())
    of_all = [
        f'{kind}_noise_scale' for kind in estimates if is_known(estimates, kind) and not has_own]
    nis = {
        robot: score.nis_per_dof for robot, score in scores.items()
        if score.nis_per_dof is not None}
    uneven = uneven_robots(nis)
    if of_all and uneven is not None:
        largest, least = uneven
        yield (
            f'before, NIS/dof of {largest} is {nis[largest] / nis[least]:.1f} times that of'
            f' {least}: {" and ".join(of_all)} of all robots may be too large for some and too'
            f' small for others; record ground truth, or set larger ones of {largest} by hand')


def _wrong_truth(estimates: Estimates, robots: Iterable[str]) -> Iterator[str]:
    """Yield the robots that have more noise of every kind than others, by their ground truth."""
    by_truth = [
        estimate.scales for kind, estimate in estimates.items()
        if estimate.source == TRUTH and is_known(estimates, kind)]
    for robot in robots if len(by_truth) > 1 else ():
        ratio = _least_ratio(robot, by_truth)
        if ratio > MAX_EVERY_KIND:
            yield (
                f'{robot} has {ratio:.1f} times the noise of another robot or more, of every kind:'
                f' the ground truth of {robot} is probably wrong; compare it with the estimate, or'
                ' calibrate without it')


def _least_ratio(robot: str, scales: Sequence[Mapping[str, NoiseScale]]) -> float:
    """Return a robot's scale relative to the least in the team, the least of all kinds."""
    return min(
        of_kind.get(robot, of_kind['']).scale / min(noise.scale for noise in of_kind.values())
        for of_kind in scales)


def _error_rows(
    by_truth: Mapping[str, ErrorEstimate],
    by_landmarks: Mapping[str, ErrorEstimate],
) -> Iterator[tuple[str, ...]]:
    """Yield a row of each robot: its errors with their standard errors, number, and source."""
    of_others = {
        robot: errors for robot, errors in by_landmarks.items() if robot not in by_truth}
    for source, of_robots in ((TRUTH, by_truth), ('landmarks', of_others)):
        for robot, errors in of_robots.items():
            values = (
                cell for value, sigma, is_found in zip(
                    errors.values, errors.sigma, errors.is_known)
                for cell in (number(value if is_found else None, '.4f'), f'{sigma:.4f}'))
            yield robot, *values, str(errors.samples), source


def _error_remarks(settings: Settings, found: SystematicErrors) -> Iterator[str]:
    of_odometry = found.odometry()
    unknown = [robot.name for robot in settings.robots if robot.name not in of_odometry]
    if unknown:
        yield (
            'too little data to find systematic errors of the odometry of'
            f' {", ".join(unknown)}: odometry_scale and odometry_turn_bias are unchanged')
    distance, turn, bias = odometry_errors.LIMITS.max_error
    for robot, errors in of_odometry.items():
        if errors.is_at_limit.any():
            yield (
                f'odometry of {robot} is wrong by {100 * distance:.0f} % in distance,'
                f' {100 * turn:.0f} % in turns or {bias:.2g} rad/s, or more: check its units,'
                ' wheel radius and wheel base')
    for robot, (heading, _) in found.headings.items():
        yield (
            f'true headings of {robot} differ by {heading:.4f} rad from those by its direction of'
            ' travel, which are used: check the frame of its ground truth')
    for robot, (x, y) in found.sensor_positions.items():
        yield (
            f'the sensor of {robot} seems to be {x:+.2f} m further ahead and {y:+.2f} m further to'
            ' the left: correct its static transform or sensor_pose, and calibrate again')
    delays = {robot.name: robot.sensor_delay for robot in settings.robots}
    for robot, delay in found.sensor_delays.items():
        yield (
            f'stamps of the observations of {robot} seem to be {abs(delay):.2f} s too'
            f' {"late" if delay > 0.0 else "early"}: set {robot}.sensor_delay to'
            f' {delays[robot] + delay:.2f}, and calibrate again')
    range_, bearing = observation_errors.LIMITS.max_error
    for robot, of_observations in found.observations().items():
        if of_observations.is_at_limit.any():
            yield (
                f'observations of {robot} are wrong by {100 * range_:.0f} % in range or'
                f' {bearing:.2g} rad in bearing, or more: check their units and the sensor pose')


def _factor_table(estimates: Estimates) -> str:
    return text_table(FACTOR_HEADINGS, (
        (kind, robot or 'all', f'{noise.scale:.3f}', f'{noise.scale * noise.relative_error:.3f}',
         str(noise.samples), estimate.source, 'yes' if is_known(estimates, kind) else 'no')
        for kind, estimate in estimates.items() for robot, noise in estimate.scales.items()))


def _noise_remarks(found: Calibration) -> Iterator[str]:
    """Yield what was found about noise beside its scales."""
    for robot in parsed(found.values).estimation.robots:
        if robot.name in found.sigmas:
            yield (
                f'odometry of {robot.name} has no covariance, and one factor does not fit its'
                ' errors of positions and of turns: odometry_sigma'
                f' {[*robot.odometry_sigma]} is written')
    if found.growth:
        yield (
            f'noise of observations grows with the range: observation_noise_growth'
            f' {found.growth:.3g}, so that standard deviations at 10 m are'
            f' {(1.0 + 10.0 * found.growth) / (1.0 + found.growth):.1f} times those at 1 m')


def _remarks(collector: RecordCollector, found: Calibration) -> Iterator[str]:
    estimates, amounts = found.estimates, counts(found.matched.records)
    for kind in DOF:
        if amounts[kind] and not is_known(estimates, kind):
            yield (
                f'too little data to know {kind}_noise_scale to {100 * MAX_RELATIVE_ERROR:.0f} %:'
                ' it is unchanged')
    of_innovations = [
        f'{kind}_noise_scale' for kind, estimate in estimates.items()
        if estimate.source == INNOVATIONS and is_known(estimates, kind)]
    if of_innovations:
        yield (
            f'{", ".join(of_innovations)} from innovations cover no errors that persist for'
            ' seconds, as those of wheels and cameras do: if the former noise covers them, the'
            ' filter becomes overconfident; give more --seconds of a longer run, or ground truth')
    for kind, estimate in estimates.items():
        scale = within_limits(estimate.scales[''].scale)
        if is_known(estimates, kind) and not 1.0 / MAX_USUAL < scale < MAX_USUAL:
            invented = ', and for constants in twist.covariance' if kind == 'odometry' else ''
            yield (
                f'{kind}_noise_scale {scale:.3g} is written, but measured noise is seldom wrong by'
                f' more than a factor of {MAX_USUAL:g}: before you use it, look for errors of'
                f' units, frames and sensor poses{invented}; doctor names some')
    if found.matched.counts:
        yield matched_in_words(found.matched.counts)
    without_id = collector.statistics.total(RejectionReason.NO_IDENTITY)
    if without_id:
        yield f'{without_id} observations without ID were left out, also of NIS and NEES'
