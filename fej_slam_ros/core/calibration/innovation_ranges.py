# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Growth of the noise of observations with the range, from the innovations of an estimator.

An innovation r of one observation has the covariance S = H P H^T + R. Its d2 = r^T S^-1 r is taken
as an error of noise R. As S does not grow as R does, that gives too little growth; the next run
has it in R, until d2 does not depend on the range.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from fej_slam_ros.core.calibration.from_innovations import comparable, run
from fej_slam_ros.core.calibration.noise_growth import ErrorAtRange, noise_growth
from fej_slam_ros.core.calibration.scales_of_errors import inliers, OUTLIER_PROBABILITY
from fej_slam_ros.core.calibration.shown_errors import MIN_GAIN
from fej_slam_ros.core.chi_square import own_blocks, squared_distances
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import StatisticsByRobot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.innovation_monitor import InnovationMonitor
from fej_slam_ros.core.records import PriorMap, Received
from fej_slam_ros.core.settings import Settings, with_equal_noise

#: Largest number of runs, and the relative change of the growth after which there is no other.
MAX_RUNS, MAX_CHANGE = 5, 0.1


@dataclass(eq=False)
class InnovationRanges(InnovationMonitor):
    """Statistics of innovations, also of each at its range."""

    #: errors by type of the observations
    errors: defaultdict[type, list[ErrorAtRange]] = field(
        default_factory=lambda: defaultdict(list))

    def add(self, stamp: int, innovation: Innovation, statistics: StatisticsByRobot) -> None:
        """Add the innovation of one update, if it was not in blocks."""
        super().add(stamp, innovation, statistics)
        if innovation.S is not None:
            for kind, error in _errors(innovation, innovation.S):
                self.errors[kind].append(error)

    def kinds(self) -> list[list[ErrorAtRange]]:
        """Return the errors of each kind without outliers."""
        return [
            [*compress(of_kind, inliers(np.array([error.d2 for error in of_kind])))]
            for of_kind in self.errors.values()]


def _errors(innovation: Innovation, S: Array) -> Iterator[tuple[type, ErrorAtRange]]:
    """Yield the error of each observation, and its type."""
    d2 = squared_distances(innovation.r.reshape(-1, 2), own_blocks(S))
    for (_, _, observation), distance in zip(innovation.used, d2.tolist()):
        yield type(observation), ErrorAtRange(float(np.hypot(*observation.z)), distance)


def growth_by_innovations(
    settings: Settings, records: Sequence[Received], prior: PriorMap | None = None,
    on_run: Callable[[], object] = lambda: None,
) -> float | None:
    """Return the growth of noise [1/m], as of `noise_growth`; parameters as of `run`."""
    gated = replace(comparable(settings), gate_probability=1.0 - OUTLIER_PROBABILITY)
    growth = 0.0
    for _ in range(MAX_RUNS):
        innovations = InnovationRanges()
        run(
            with_equal_noise(gated, observation_noise_growth=growth), records, prior,
            innovations)
        on_run()
        found = noise_growth(innovations.kinds(), growth, MIN_GAIN)
        if found is None or abs(found - growth) <= MAX_CHANGE * growth:
            return found
        growth = found
    return growth
