# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy and consistency of estimates: RMSE, NEES, NIS, eq. (25) of [Liu]."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.geometry import Array

#: Number of latest observations of a robot in its NIS, and the probability with which the NIS of a
#: consistent filter lies in its band: a false alarm in a million.
NIS_WINDOW = 200
NIS_PROBABILITY = 0.999999


def nees(errors: Array, P: Array) -> Array:
    """
    Return NEES, e^T P^-1 e, whose mean is d for a consistent estimate; eq. (25) is NEES/d.

    Parameters
    ----------
    errors : (..., d) array, estimate - truth
    P : (..., d, d) array, the estimated covariances

    """
    whitened = np.linalg.solve(P, errors[..., None])[..., 0]
    values: Array = np.sum(errors * whitened, axis=-1)
    return values


def nees_per_dof(errors: Array, P: Array) -> Array:
    """Return NEES/dof, `nees` divided by d, whose mean is 1 for a consistent estimate."""
    values: Array = nees(errors, P) / errors.shape[-1]
    return values


def root_mean_square(errors: Array) -> float:
    """Return sqrt(mean |e|^2) over errors (k, d), NaN for no errors."""
    return math.sqrt(np.mean(np.sum(errors**2, axis=1))) if len(errors) else math.nan


@dataclass(eq=False)
class NisMonitor:
    """Normalised innovations squared (NIS) of one robot's observations."""

    total: float = 0.0  #: sum of r^T S^-1 r since the start
    dof: int = 0  #: degrees of freedom of the total
    outside_for: int = 0  #: time [ns] since the ratio of the latest observations left its band
    _inside_at: int | None = None
    _latest: deque[float] = field(default_factory=lambda: deque(maxlen=NIS_WINDOW))

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Add r^T S^-1 r of each observation of one update, with 2 degrees of freedom."""
        self.total += sum(values)
        self.dof += 2 * len(values)
        self._latest.extend(values)
        low, high = self.band()
        if self._inside_at is None or low <= self.nis_per_dof() <= high:
            self._inside_at = stamp
        self.outside_for = stamp - self._inside_at

    def nis_per_dof(self) -> float:
        """Return NIS/dof of the latest observations, above 1 if the filter is overconfident."""
        return sum(self._latest) / (2 * len(self._latest)) if self._latest else 1.0

    def band(self) -> tuple[float, float]:
        """Return the interval in which the ratio of a consistent filter lies."""
        dof = 2 * len(self._latest)
        return band_per_dof(dof, NIS_PROBABILITY) if dof else (0.0, 0.0)


def total_nis_per_dof(monitors: Iterable[NisMonitor]) -> float:
    """Return NIS/dof over all observations of some robots."""
    every = [*monitors]
    return sum(monitor.total for monitor in every) / sum(monitor.dof for monitor in every)
