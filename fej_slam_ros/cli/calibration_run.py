# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of parameters by the records of a bag: the values that correct them."""

import argparse
from collections.abc import Callable, Mapping, Sequence
import math
from typing import NamedTuple

from tqdm import tqdm

from fej_slam_ros.core.calibration.from_innovations import (
    comparable, counts, log_likelihood, most_likely_odometry_scales, most_likely_scales, run,
    with_scales, with_scans_apart)
from fej_slam_ros.core.calibration.from_truth import (
    DOF, ERROR_WINDOW, growth_by_truth, normalized_errors, odometry_sigmas)
from fej_slam_ros.core.calibration.innovation_ranges import growth_by_innovations
from fej_slam_ros.core.calibration.innovation_windows import scales_over_windows
from fej_slam_ros.core.calibration.matched_records import (
    are_without_ids, MatchedRecords, with_matched_ids)
from fej_slam_ros.core.calibration.robot_scales import NoiseScale
from fej_slam_ros.core.calibration.scales_of_errors import Errors, noise_scales
from fej_slam_ros.core.calibration.shown_errors import ErrorEstimate, MIN_GAIN
from fej_slam_ros.core.calibration.systematic_errors import (
    errors_by_truth, SystematicErrors, with_corrected_headings, with_errors_by_landmarks)
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.parameter_kinds import MAX_NOISE_SCALE
from fej_slam_ros.core.records import NS, Odometry, PriorMap, Received, TrueLandmarks
from fej_slam_ros.core.settings import Settings, Triple
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files.prior_map import prior_map

#: Maximum number of times that observations without IDs are matched, and the change of the
#: logarithm of a factor below which they are not matched again.
MAX_MATCHINGS, MAX_LOG_CHANGE = 8, 0.05

#: Ratio of the NIS of two robots above which they need scales of their own.
MAX_UNEVEN = 1.4
#: Sources of scales: without ground truth, innovations over some seconds and, of what these do not
#: determine, single ones.
TRUTH, INNOVATION_WINDOWS, INNOVATIONS = (
    'truth', f'innovations over {ERROR_WINDOW / NS:g} s', 'innovations')


class ScaleEstimate(NamedTuple):
    """Scales of one kind of noise by robot; '' is the scale of all robots."""

    source: str  #: one of the three above
    scales: Mapping[str, NoiseScale]


#: Estimates by kind of noise.
Estimates = Mapping[str, ScaleEstimate]


class Calibration(NamedTuple):
    """What was found, and the records from which."""

    values: Mapping[str, object]  #: the corrected parameters
    errors: SystematicErrors
    sigmas: Mapping[str, Triple]  #: new odometry_sigma of robots without covariance
    growth: float | None  #: of the noise of observations with the range [1/m], None if unknown
    estimates: Estimates
    matched: MatchedRecords

    def scales(self) -> dict[str, float]:
        """Return the scale of all robots that was written, by kind of noise."""
        return {
            kind: estimate.scales[''].scale for kind, estimate in self.estimates.items()
            if is_known(self.estimates, kind)}


def calibrated(
    arguments: argparse.Namespace, values: Mapping[str, object], records: Sequence[Received]
) -> Calibration:
    """Return the calibration of records; matches of observations without IDs depend on it."""
    if not are_without_ids(records):
        return _calibrated_by(arguments, values, MatchedRecords(records))
    settings, scales = parsed(values), dict[str, float]()
    for _ in range(MAX_MATCHINGS):
        with tqdm(desc='match', unit='step', disable=None) as bar:
            matched = with_matched_ids(
                settings.estimation, records, prior_map(settings), bar.update)
        found = _calibrated_by(arguments, values, matched)
        before, scales = scales, found.scales()
        if before.keys() == scales.keys() and all(
                abs(math.log(scales[kind] / before[kind])) < MAX_LOG_CHANGE for kind in scales):
            break
        settings = parsed(found.values)
    return found


def _calibrated_by(
    arguments: argparse.Namespace, values: Mapping[str, object], matched: MatchedRecords
) -> Calibration:
    """Return the calibration of records in which all observations have IDs."""
    settings, errors = parsed(values).estimation, SystematicErrors()
    if arguments.source != 'innovations':
        errors = errors_by_truth(matched.records, settings)
    if arguments.source != 'truth':
        errors = with_errors_by_landmarks(errors, matched.records, settings)
        beginning = _beginning(matched.records, arguments.seconds)
        with tqdm(desc='ranges', unit='run', disable=None) as bar:
            errors = _with_errors_of_ranges(errors, values, beginning, bar.update)
    records = with_corrected_headings(matched.records, errors.headings)
    corrected, growth, sigmas = _with_systematic_errors(values, errors), None, dict[str, Triple]()
    team = None
    if arguments.source != 'innovations':
        team = TeamRecords(records, settings)
        sigmas = odometry_sigmas(team, parsed(corrected).estimation)
        growth = growth_by_truth(team, parsed(corrected).estimation)
        corrected = _with_noise_growth(_with_odometry_sigmas(corrected, sigmas), growth)
    estimates = _estimate(arguments, corrected, records, team)
    if growth is None and arguments.source != 'truth':
        growth = _growth_by_innovations(arguments, corrected, estimates, records)
        before, corrected = corrected, _with_noise_growth(corrected, growth)
        if corrected != before:
            estimates = _estimate(arguments, corrected, records, team)
    return Calibration(
        _with_noise_scales(corrected, estimates), errors, sigmas, growth, estimates, matched)


def parsed(values: Mapping[str, object]) -> parameters.RunSettings:
    """Return the settings that parameters give."""
    # What is wrong in the file was written when it was loaded.
    return parameters.parse(values, parameters.no_warning)


def _with_errors_of_ranges(
    errors: SystematicErrors, values: Mapping[str, object], records: Sequence[Received],
    on_run: Callable[[], object],
) -> SystematicErrors:
    """
    Return errors in which wrong distances are wrong ranges where innovations show that.

    Distances by landmarks fit the ranges of the same robot. Only the map that it shares with
    others shows which of both is wrong.

    """
    def log_likelihood_of(errors: SystematicErrors) -> float:
        settings = parsed(_with_systematic_errors(values, errors))
        on_run()
        return log_likelihood(comparable(settings.estimation), records, prior_map(settings))

    wrong = {
        robot: abs(math.log(found.values[0]))
        for robot, found in errors.odometry_by_landmarks.items()
        if found.is_known[0] and found.values[0] != 1.0
        and robot not in errors.observations_by_truth}
    best = log_likelihood_of(errors) if wrong else 0.0
    for robot in sorted(wrong, key=wrong.__getitem__, reverse=True):
        other = errors.with_error_of_ranges(robot)
        found = log_likelihood_of(other)
        if found > best + MIN_GAIN:
            errors, best = other, found
    return errors


def _with_systematic_errors(
    values: Mapping[str, object], errors: SystematicErrors
) -> dict[str, object]:
    """Return parameters with the systematic errors that were found, where they are others."""
    corrected = dict(values)
    of_odometry, of_observations = errors.odometry(), errors.observations()
    for robot in parsed(values).estimation.robots:
        found: dict[str, object] = {}
        if robot.name in of_odometry:
            distance, turn, found['odometry_turn_bias'] = _rounded(of_odometry[robot.name])
            found['odometry_scale'] = (distance, turn)
        if robot.name in of_observations:
            found['observation_range_scale'], found['observation_bearing_bias'] = _rounded(
                of_observations[robot.name])
        for parameter, value in found.items():
            if value != getattr(robot, parameter):
                corrected[f'{robot.name}.{parameter}'] = (
                    [*value] if isinstance(value, tuple) else value)
    return corrected


def _growth_by_innovations(
    arguments: argparse.Namespace, values: Mapping[str, object], estimates: Estimates,
    records: Sequence[Received],
) -> float | None:
    """Return the growth of noise with the range under scales that were found without it."""
    settings = parsed(_with_noise_scales(values, estimates))
    beginning = _beginning(records, arguments.seconds)
    with tqdm(desc='growth', unit='run', disable=None) as bar:
        return growth_by_innovations(
            settings.estimation, beginning, prior_map(settings), bar.update)


def _with_odometry_sigmas(
    values: Mapping[str, object], sigmas: Mapping[str, Triple]
) -> dict[str, object]:
    """Return parameters with odometry_sigma of some robots."""
    return {**values, **{
        f'{robot}.odometry_sigma': [float(f'{x:.3g}') for x in sigma]
        for robot, sigma in sigmas.items()}}


def _with_noise_growth(values: Mapping[str, object], growth: float | None) -> dict[str, object]:
    """Return parameters with a growth of noise for all robots, unless they have it already."""
    robots = parsed(values).estimation.robots
    if growth is None or all(robot.observation_noise_growth == growth for robot in robots):
        return dict(values)
    name = 'observation_noise_growth'
    others = {key: x for key, x in values.items() if key.split('.')[-1] != name}
    return {**others, name: float(f'{growth:.3g}')}


def _rounded(errors: ErrorEstimate) -> list[float]:
    """Return the values; those that the data determine have four digits."""
    return [
        float(f'{value:.4g}') if is_determined else float(value)
        for value, is_determined in zip(errors.values, errors.is_known)]


def _estimate(
    arguments: argparse.Namespace, values: Mapping[str, object], records: Sequence[Received],
    team: TeamRecords | None,
) -> Estimates:
    """Return the scales of the requested sources, that by ground truth first."""
    settings, amounts = parsed(values), counts(records)
    errors: Mapping[str, Errors] = {}
    if team is not None:
        errors = normalized_errors(team, settings.estimation)
    if arguments.source == 'truth' and not errors:
        raise UserError(
            f'{arguments.bag} has no ground truth that covers an observation or'
            f' {ERROR_WINDOW / NS:g} s of odometry: leave out --from truth')
    estimates = {
        kind: ScaleEstimate(TRUTH, noise_scales(samples, DOF[kind]))
        for kind, samples in errors.items()}
    rest = [kind for kind in DOF if amounts[kind] and not is_known(estimates, kind)]
    has_innovations = bool(amounts['landmark'] or amounts['robot'])
    if not estimates and not has_innovations:
        raise UserError(
            f'{arguments.bag} has no usable observations, which calibration without ground truth'
            ' needs: record <robot>/ground_truth, or landmarks; doctor says why some are unused')
    if not rest or not has_innovations or arguments.source == 'truth':
        return estimates
    beginning = _beginning(records, arguments.seconds)
    with tqdm(desc='search', unit='run', disable=None) as bar:
        return _with_innovations(
            estimates, rest, values, beginning, prior_map(settings), bar.update)


def _with_innovations(
    estimates: Estimates, kinds: Sequence[str], values: Mapping[str, object],
    records: Sequence[Received], prior: PriorMap | None, on_run: Callable[[], object],
) -> Estimates:
    """Return estimates with those of other kinds of noise, over some seconds if possible."""
    start = dict.fromkeys(kinds, 1.0)
    if 'odometry' in kinds:
        apart = with_scans_apart(records)
        found = most_likely_scales(
            _estimation(values, estimates), apart, kinds, prior, on_run)
        if found['odometry'].is_known():
            start = {kind: scale.scale for kind, scale in found.items()}
            estimates = {**estimates, 'odometry': _of_robots(
                found['odometry'], with_scales(_estimation(values, estimates), start), apart,
                prior, on_run)}
    observed = {kind: start[kind] for kind in kinds if kind != 'odometry'}
    if is_known(estimates, 'odometry') and observed:
        found = scales_over_windows(
            _estimation(values, estimates), records, observed, prior, on_run)
        estimates = {**estimates, **{
            kind: _over_windows(scale) for kind, scale in found.items()}}
    rest = [kind for kind in kinds if not is_known(estimates, kind)]
    if rest:
        found = most_likely_scales(
            _estimation(values, estimates), records, rest, prior, on_run)
        estimates = {**estimates, **{
            kind: ScaleEstimate(INNOVATIONS, {'': scale}) for kind, scale in found.items()}}
    return estimates


def _of_robots(
    of_all: NoiseScale, settings: Settings, records: Sequence[Received],
    prior: PriorMap | None, on_run: Callable[[], object],
) -> ScaleEstimate:
    """Return the scale of odometry, and those of robots that differ, by scans far apart."""
    estimator, _ = run(comparable(settings), records, prior)
    on_run()
    if uneven_robots(nis_per_dof(estimator)) is None:
        return _over_windows(of_all)
    own = most_likely_odometry_scales(settings, records, prior, on_run)
    # A scale of all by one search is better than one combined of many.
    return ScaleEstimate(INNOVATION_WINDOWS, own) if len(own) > 1 else _over_windows(of_all)


def nis_per_dof(estimator: Estimator) -> dict[str, float]:
    """Return NIS/dof of each robot that has innovations."""
    return {
        robot: nis.total / nis.dof for robot, nis in estimator.innovations.nis.items() if nis.dof}


def uneven_robots(nis: Mapping[str, float]) -> tuple[str, str] | None:
    """Return the robots of the largest and the least NIS/dof if one scale cannot fit both."""
    largest, least = (choose(nis, key=nis.__getitem__, default='') for choose in (max, min))
    return (largest, least) if nis and nis[largest] > MAX_UNEVEN * nis[least] else None


def _estimation(values: Mapping[str, object], estimates: Estimates) -> Settings:
    """Return the settings with the noise scales that are known."""
    return parsed(_with_noise_scales(values, estimates)).estimation


def _over_windows(scale: NoiseScale) -> ScaleEstimate:
    return ScaleEstimate(INNOVATION_WINDOWS, {'': scale})


def _beginning(records: Sequence[Received], seconds: int) -> list[Received]:
    """Return the records up to a time after the first odometry, and the true landmarks."""
    first = min(record.stamp for record, _ in records if isinstance(record, Odometry))
    return [
        (record, received) for record, received in records
        if isinstance(record, TrueLandmarks) or record.stamp <= first + seconds * NS]


def _with_noise_scales(values: Mapping[str, object], estimates: Estimates) -> dict[str, object]:
    """Return parameters with the noise scales that are known, instead of all others of a kind."""
    corrected = dict(values)
    for kind in estimates:
        if is_known(estimates, kind):
            name = f'{kind}_noise_scale'
            corrected = {key: x for key, x in corrected.items() if key.split('.')[-1] != name}
            for robot, noise in estimates[kind].scales.items():
                scale = within_limits(noise.scale)
                corrected[f'{robot}.{name}'.lstrip('.')] = float(f'{scale:.4g}')
    return corrected


def within_limits(scale: float) -> float:
    """Return the noise scale that is written: parameters have limits."""
    return min(max(scale, 1.0 / MAX_NOISE_SCALE), MAX_NOISE_SCALE)


def is_known(estimates: Estimates, kind: str) -> bool:
    """Return whether there was enough data for a kind of noise."""
    return kind in estimates and estimates[kind].scales[''].is_known()
