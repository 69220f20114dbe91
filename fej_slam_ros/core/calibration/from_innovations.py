# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
By which factors the claimed noise is wrong, from the innovations of an estimator alone.

The mean of r^T S^-1 r is one equation for the noise of odometry and of observations. The likelihood,
the sum of -1/2 (r^T S^-1 r + log det S) over all updates, tells both.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
import math
from typing import Any

import numpy as np
from scipy.optimize import minimize

from fej_slam_ros.core.calibration.from_truth import Factor, GROSS
from fej_slam_ros.core.estimator import BrokenEstimateError, Estimator
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Odometry, PriorMap, Record, RobotScan, Scan
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import Settings

#: A record and when it was received [ns].
Received = tuple[Record, int | None]

#: Steps in the logarithms of factors: the first, and that with which the search ends and the
#: curvature is told.
FIRST_STEP, LAST_STEP = math.log(2.0), 0.1
#: So little log-likelihood is lost where a factor is off by its standard error.
LAST_DIFFERENCE = 0.5
#: No factor is beyond this, or below its inverse.
LARGEST = 100.0
#: So often are observations with gross errors left out at most, and factors found without them.
ROUNDS = 4


def with_scales(settings: Settings, scales: Mapping[str, float]) -> Settings:
    """Return settings with the same noise scales for all robots, given by kind."""
    named: dict[str, Any] = {f'{kind}_noise_scale': scale for kind, scale in scales.items()}
    robots = tuple(replace(robot, **named) for robot in settings.robots)
    return replace(settings, robots=robots, **named)


def run(
    settings: Settings, records: Iterable[Received], prior: PriorMap | None = None
) -> tuple[Estimator, list[Rejection]]:
    """Return an estimator that has had all records, and all that it refused on the way."""
    estimator = Estimator(settings, prior)
    rejected: list[Rejection] = []
    for record, received in records:
        estimator.add(record, received)
        for _ in estimator.take():
            rejected += estimator.statistics.rejections
            estimator.statistics.rejections.clear()
    for _ in estimator.close():
        rejected += estimator.statistics.rejections
        estimator.statistics.rejections.clear()
    return estimator, rejected


def by_innovations(
    settings: Settings, records: Sequence[Received], kinds: Sequence[str],
    prior: PriorMap | None = None, on_run: Callable[[], object] = lambda: None,
) -> dict[str, Factor]:
    """
    Return the factor of each kind that together are most likely.

    A gate would hide the large innovations of noise that is claimed too small, so there is none
    while factors are sought. Observations that are gross errors under these factors are left out
    afterwards, and the factors sought again.

    Parameters
    ----------
    settings : of the estimator; noise scales of other kinds stay as they are
    records : all with identities, as another number of matches would be no likelihood
    kinds : of noise, in the names of the parameters
    prior : landmarks that are known before
    on_run : called after each run of an estimator

    """
    # A scale must not decide who joins and which landmarks are mapped anew.
    ungated = replace(
        settings, gate_probability=1.0, join_probability=1.0, inflate_rejected_scans=False,
        moved_landmarks='ignore')
    gated = replace(ungated, gate_probability=1.0 - GROSS)

    def at(theta: Array) -> dict[str, float]:
        return dict(zip(kinds, np.exp(theta).tolist()))

    def unlikelihood(theta: Array) -> float:
        if np.abs(theta).max() > math.log(LARGEST):
            return math.inf
        try:
            estimator, _ = run(with_scales(ungated, at(theta)), records, prior)
        except BrokenEstimateError:
            return math.inf
        on_run()
        return -estimator.innovations.log_likelihood

    theta, information = _minimum(unlikelihood, np.zeros(len(kinds)), FIRST_STEP)
    for _ in range(ROUNDS):
        _, rejected = run(with_scales(gated, at(theta)), records, prior)
        on_run()
        outliers = {
            (r.robot, r.stamp, r.seen or r.id) for r in rejected if r.reason is RejectionReason.GATED}
        if not outliers:
            break
        records = [(_without(record, outliers), received) for record, received in records]
        theta, information = _minimum(unlikelihood, theta, LAST_STEP)
    samples = counts(records)
    return {
        kind: Factor(scale, error, samples[kind])
        for (kind, scale), error in zip(at(theta).items(), _errors(information).tolist())}


def counts(records: Iterable[Received]) -> Counter[str]:
    """Return how much there is of each kind of noise: odometry, and single observations."""
    found: Counter[str] = Counter()
    for record, _ in records:
        if isinstance(record, Odometry):
            found['odometry'] += 1
        elif isinstance(record, Scan):
            found['landmark'] += len(record.observations)
        elif isinstance(record, RobotScan):
            found['robot'] += len(record.observations)
    return found


def _minimum(
    f: Callable[[Array], float], theta: Array, step: float
) -> tuple[Array, Array]:
    """Return where f is least, searched from theta (d,) on, and its curvature (d, d) there."""
    d = len(theta)
    found = minimize(f, theta, method='Nelder-Mead', options={
        'initial_simplex': theta + np.vstack([np.zeros(d), step * np.eye(d)]),
        'xatol': LAST_STEP, 'fatol': LAST_DIFFERENCE})
    h = LAST_STEP * np.eye(d)
    above, below = (np.array([f(found.x + sign * e) for e in h]) for sign in (1.0, -1.0))
    curvature = np.diag(above + below - 2.0 * found.fun)
    for i, j in combinations(range(d), 2):
        both = f(found.x + h[i] + h[j])
        curvature[i, j] = curvature[j, i] = both - above[i] - above[j] + found.fun
    curvature /= LAST_STEP ** 2
    if not _is_definite(curvature):
        return found.x, curvature
    newton = np.linalg.solve(curvature, (above - below) / (2.0 * LAST_STEP))
    return found.x - np.clip(newton, -LAST_STEP, LAST_STEP), curvature


def _errors(information: Array) -> Array:
    """Return the standard errors (d,) that belong to an information matrix."""
    if not _is_definite(information):
        return np.full(len(information), math.inf)
    errors: Array = np.sqrt(np.diag(np.linalg.solve(information, np.eye(len(information)))))
    return errors


def _is_definite(information: Array) -> bool:
    return bool(np.isfinite(information).all() and np.linalg.eigvalsh(information)[0] > 0.0)


def _without(record: Record, outliers: Collection[tuple[str, int, str | int | None]]) -> Record:
    """Return a record without the observations that are outliers."""
    if isinstance(record, Scan):
        return replace(record, observations=tuple(
            s for s in record.observations if (record.robot, record.stamp, s.id) not in outliers))
    if isinstance(record, RobotScan):
        return replace(record, observations=tuple(
            s for s in record.observations if (record.robot, record.stamp, s.seen) not in outliers))
    return record
