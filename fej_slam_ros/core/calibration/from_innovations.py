# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Maximum-likelihood noise scale factors from the innovations of an estimator.

The mean of the normalised innovation squared r^T S^-1 r is one equation for the noise of odometry
and of observations; the log-likelihood, the sum of -1/2 (r^T S^-1 r + log det S) over all updates,
determines both.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
import math
import sys

import numpy as np
from scipy.optimize import minimize

from fej_slam_ros.core.calibration.from_truth import ERROR_WINDOW
from fej_slam_ros.core.calibration.robot_scales import different_robots, NoiseScale
from fej_slam_ros.core.calibration.scales_of_errors import OUTLIER_PROBABILITY
from fej_slam_ros.core.estimator import BrokenEstimateError, Estimator
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.innovation_monitor import InnovationMonitor
from fej_slam_ros.core.parameter_kinds import MAX_NOISE_SCALE
from fej_slam_ros.core.records import (
    MAX_LINEAR_HEADING_SIGMA, Odometry, PriorMap, Received, Record, RobotScan, Scan)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import Settings, with_equal_noise

#: Observer, stamp, and observed robot or landmark ID of an observation.
ObservedKey = tuple[str, int, str | int | None]

#: Filter of which errors of linearisation change innovations least. With FEJ, large corrections of
#: a heading would count as noise of observations.
FILTER = 'invariant'
#: First and last step of the search in the logarithms of the factors; the last one is also that of
#: the finite differences.
FIRST_STEP, LAST_STEP = math.log(2.0), 0.1
#: Tolerance of the log-likelihood: its decrease at one standard error from the maximum.
LAST_DIFFERENCE = 0.5
#: Maximum number of steps of a search for each robot, and the change of all factors' logarithms
#: after which it ends.
MAX_SEPARATE_STEPS, MAX_LAST_CHANGE = 10, 0.05
#: Information about a factor that no innovation depends on.
MIN_INFORMATION = 1e-6
#: Maximum number of further searches, each without the outliers of the previous one.
MAX_OUTLIER_ROUNDS = 4


def with_scales(settings: Settings, scales: Mapping[str, float]) -> Settings:
    """Return settings with noise scales, by kind, that are the same for all robots."""
    return with_equal_noise(
        settings, **{f'{kind}_noise_scale': scale for kind, scale in scales.items()})


def comparable(settings: Settings) -> Settings:
    """Return settings without a gate of which innovations at different noise are comparable."""
    # Joins and moved landmarks must not depend on the scales: observations of robots in different
    # frames have no innovations, so a later join would change the likelihood.
    return replace(
        settings, filter=FILTER, gate_probability=1.0, join_probability=1.0,
        inflate_rejected_scans=False, moved_landmarks='ignore',
        join_heading_sigma=max(settings.join_heading_sigma, MAX_LINEAR_HEADING_SIGMA))


def run(
    settings: Settings, records: Iterable[Received], prior: PriorMap | None = None,
    innovations: InnovationMonitor | None = None,
) -> tuple[Estimator, list[Rejection]]:
    """Return an estimator after all records, and the rejected observations."""
    estimator = Estimator(settings, prior, innovations)
    rejected: list[Rejection] = []
    for _ in estimator.run_received(records):
        rejected += estimator.statistics.rejections
        estimator.statistics.rejections.clear()
    return estimator, rejected


def log_likelihood(
    settings: Settings, records: Iterable[Received], prior: PriorMap | None
) -> float:
    """Return the log-likelihood of the innovations of an estimator with `comparable` settings."""
    try:
        estimator, _ = run(settings, records, prior)
    except BrokenEstimateError:
        return -math.inf
    return estimator.innovations.log_likelihood


def most_likely_scales(
    settings: Settings, records: Sequence[Received], kinds: Sequence[str],
    prior: PriorMap | None = None, on_run: Callable[[], object] = lambda: None,
) -> dict[str, NoiseScale]:
    """
    Return the maximum-likelihood noise scale factors by kind.

    A gate would remove the large innovations of understated noise, so the search
    uses none. Outliers under the factors found are then removed, and the search is repeated.

    Parameters
    ----------
    settings : of the estimator but for its filter; noise scales of other kinds are not changed
    records : observations must have IDs, as likelihoods of different matches are not comparable
    kinds : kinds of noise, as in the parameters ``<kind>_noise_scale``
    prior : map known before the run
    on_run : called with each run of an estimator

    """
    def scales(theta: Array) -> dict[str, float]:
        return dict(zip(kinds, np.exp(theta).tolist()))

    search = _Search(
        settings, lambda given, theta: with_scales(given, scales(theta)), prior, on_run)
    theta, information, records = search.most_likely(records, np.zeros(len(kinds)), _minimum)
    samples, errors = counts(records), _standard_errors(information)
    return {
        kind: NoiseScale(scale, error, samples[kind])
        for (kind, scale), error in zip(scales(theta).items(), errors.tolist())}


def most_likely_odometry_scales(
    settings: Settings, records: Sequence[Received], prior: PriorMap | None = None,
    on_run: Callable[[], object] = lambda: None,
) -> dict[str, NoiseScale]:
    """
    Return the maximum-likelihood factor of odometry noise under '', and those of other robots.

    These differ from all others, whose factor is then that under ''. The search begins at the
    scales of the settings; `samples` are of all robots. The parameters are those of
    `most_likely_scales`.

    """
    def scaled(given: Settings, theta: Array) -> Settings:
        return replace(given, robots=tuple(
            replace(robot, odometry_noise_scale=scale)
            for robot, scale in zip(given.robots, np.exp(theta).tolist())))

    search = _Search(settings, scaled, prior, on_run)
    start = np.log([robot.odometry_noise_scale for robot in settings.robots])
    theta, information, records = search.most_likely(records, start, _separate_minimum)
    samples, errors = counts(records)['odometry'], _standard_errors(information)
    own = {
        robot.name: NoiseScale(scale, error, samples)
        for robot, scale, error in zip(settings.robots, np.exp(theta).tolist(), errors.tolist())}
    different = different_robots(own, partial(_combined, own))
    return {'': _combined(own, {*different})} | {robot: own[robot] for robot in different}


def _combined(own: Mapping[str, NoiseScale], excluded: set[str]) -> NoiseScale:
    """Return the factor of all robots but the excluded ones, by theirs."""
    rest = [scale for robot, scale in own.items() if robot not in excluded]
    weights = np.array([scale.relative_error for scale in rest]) ** -2.0
    if not weights.sum():
        return NoiseScale(1.0, math.inf, 0)
    log_scale = weights @ np.log([scale.scale for scale in rest]) / weights.sum()
    return NoiseScale(
        math.exp(log_scale), float(weights.sum()) ** -0.5, rest[0].samples)


#: Searches the minimum of a function from a point (d,), with a first step, and returns it with the
#: Hessian (d, d) there.
Minimize = Callable[[Callable[[Array], float], Array, float], tuple[Array, Array]]


class _Search:
    """Runs of an estimator whose settings are `scaled` by the logarithms theta of factors."""

    def __init__(
        self, settings: Settings, scaled: Callable[[Settings, Array], Settings],
        prior: PriorMap | None, on_run: Callable[[], object],
    ) -> None:
        self._ungated = comparable(settings)
        self._gated = replace(self._ungated, gate_probability=1.0 - OUTLIER_PROBABILITY)
        self._scaled, self._prior, self._on_run = scaled, prior, on_run

    def most_likely(
        self, records: Sequence[Received], theta: Array, minimize: Minimize
    ) -> tuple[Array, Array, Sequence[Received]]:
        """Return the most likely theta (d,), the information, and the records without outliers."""
        theta, information = minimize(partial(self._cost, records), theta, FIRST_STEP)
        for _ in range(MAX_OUTLIER_ROUNDS):
            outliers = self._outliers(records, theta)
            if not outliers:
                break
            records = [(_without(record, outliers), received) for record, received in records]
            theta, information = minimize(partial(self._cost, records), theta, LAST_STEP)
        return theta, information, records

    def _cost(self, records: Iterable[Received], theta: Array) -> float:
        """Return the negative log-likelihood."""
        if np.abs(theta).max() > math.log(MAX_NOISE_SCALE):
            return math.inf
        self._on_run()
        return -log_likelihood(self._scaled(self._ungated, theta), records, self._prior)

    def _outliers(self, records: Iterable[Received], theta: Array) -> set[ObservedKey]:
        """Return the gated observations."""
        _, rejected = run(self._scaled(self._gated, theta), records, self._prior)
        self._on_run()
        gated = (r for r in rejected if r.reason is RejectionReason.GATED)
        return {(r.robot, r.stamp, r.observed or r.id) for r in gated}


def counts(records: Iterable[Received]) -> Counter[str]:
    """Return the number of odometry messages and of observations, by kind of noise."""
    samples: Counter[str] = Counter()
    for record, _ in records:
        if isinstance(record, Odometry):
            samples['odometry'] += 1
        elif isinstance(record, Scan):
            samples['landmark'] += len(record.observations)
        elif isinstance(record, RobotScan):
            samples['robot'] += len(record.observations)
    return samples


def with_scans_apart(records: Iterable[Received]) -> list[Received]:
    """Return records with one scan of each kind and robot in a window, those of one stamp."""
    latest: dict[tuple[type[Record], str], int] = {}
    kept: list[Received] = []
    for record, received in records:
        if isinstance(record, (Scan, RobotScan)):
            key = type(record), record.robot
            before = latest.get(key, record.stamp)
            if not record.observations or 0 < abs(record.stamp - before) < ERROR_WINDOW:
                continue
            latest[key] = record.stamp
        kept.append((record, received))
    return kept


def _minimum(f: Callable[[Array], float], theta: Array, step: float) -> tuple[Array, Array]:
    """Return the minimum of f, searched from theta (d,), and the Hessian (d, d) there."""
    d = len(theta)

    def finite(x: Array) -> float:
        # The search subtracts values, also where the estimate breaks down.
        return min(f(x), sys.float_info.max)

    found = minimize(finite, theta, method='Nelder-Mead', options={
        'initial_simplex': theta + np.vstack([np.zeros(d), step * np.eye(d)]),
        'xatol': LAST_STEP, 'fatol': LAST_DIFFERENCE})
    h = LAST_STEP * np.eye(d)
    above, below = (np.array([f(found.x + sign * e) for e in h]) for sign in (1.0, -1.0))
    if not np.isfinite([above, below]).all():
        return found.x, np.full((d, d), math.inf)
    curvature = np.diag(above + below - 2.0 * found.fun)
    for i, j in combinations(range(d), 2):
        both = f(found.x + h[i] + h[j])
        curvature[i, j] = curvature[j, i] = both - above[i] - above[j] + found.fun
    curvature /= LAST_STEP ** 2
    if not _is_definite(curvature):
        return found.x, curvature
    newton = np.linalg.solve(curvature, (above - below) / (2.0 * LAST_STEP))
    return found.x - np.clip(newton, -LAST_STEP, LAST_STEP), curvature


def _separate_minimum(
    f: Callable[[Array], float], theta: Array, step: float
) -> tuple[Array, Array]:
    """Return the minimum as `_minimum`, of a function whose variables hardly depend on others."""
    for _ in range(MAX_SEPARATE_STEPS):
        above, below = (
            np.array([f(theta + sign * e) for e in LAST_STEP * np.eye(len(theta))])
            for sign in (1.0, -1.0))
        middle = f(theta)
        if not np.isfinite([middle, *above, *below]).all():
            return theta, np.diag(np.full(len(theta), math.inf))
        curvature = (above + below - 2.0 * middle) / LAST_STEP ** 2
        slope = (above - below) / (2.0 * LAST_STEP)
        # Far from the minimum the curvature may have the wrong sign.
        change = np.clip(-slope / np.maximum(np.abs(curvature), LAST_DIFFERENCE), -step, step)
        theta = theta + change
        if np.abs(change).max() < MAX_LAST_CHANGE:
            break
    # Variables that change nothing are not known, whatever the others are.
    return theta, np.diag(np.maximum(curvature, MIN_INFORMATION))


def _standard_errors(information: Array) -> Array:
    """Return the standard errors (d,), infinite if the information is not definite."""
    d = len(information)
    if not _is_definite(information):
        return np.full(d, math.inf)
    return np.sqrt(np.diag(np.linalg.solve(information, np.eye(d))))


def _is_definite(information: Array) -> bool:
    return bool(np.isfinite(information).all() and np.linalg.eigvalsh(information)[0] > 0.0)


def _without(record: Record, outliers: Collection[ObservedKey]) -> Record:
    if isinstance(record, Scan):
        return replace(record, observations=tuple(
            o for o in record.observations if (record.robot, record.stamp, o.id) not in outliers))
    if isinstance(record, RobotScan):
        return replace(record, observations=tuple(
            o for o in record.observations
            if (record.robot, record.stamp, o.observed) not in outliers))
    return record
