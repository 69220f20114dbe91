# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How good an estimate is: RMSE, NEES, NIS and chi-square bounds, eq. (25) of [Liu]."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.core.geometry import Array, wrap
from fej_slam_ros.core.ground_truth import RecordedTruth

#: So many observations of a robot are judged together, and a right filter's lie inside the band with
#: this probability.
NIS_WINDOW = 200
NIS_PROBABILITY = 0.999999

#: So many estimates of a robot wait for a ground truth that comes later.
WAITING = 1000

#: A correlation matrix with a smaller eigenvalue is singular but for rounding.
MIN_CORRELATION_EIGENVALUE = 1e-12


def nees(errors: Array, P: Array) -> Array:
    """
    Return e^T P^-1 e / d, which is 1 in the mean for a consistent estimate, eq. (25).

    Parameters
    ----------
    errors : (..., d) array, estimate - truth
    P : (..., d, d) array, the covariances that were claimed for them

    """
    whitened = np.linalg.solve(P, errors[..., None])[..., 0]
    rated: Array = np.sum(errors * whitened, axis=-1) / errors.shape[-1]
    return rated


def pose_error(estimate: Array, truth: Array) -> Array:
    """Return estimate - truth of a pose (3,), the heading wrapped."""
    error: Array = estimate - truth
    error[2] = wrap(error[2])
    return error


class NisMonitor:
    """
    Normalised innovations squared of one robot's observations.

    Attributes
    ----------
    total, dof : sum of r^T S^-1 r since the beginning, and its degrees of freedom
    outside_for : how long [ns] the latest observations have been outside of their band

    """

    def __init__(self) -> None:
        self.total = 0.0
        self.dof = 0
        self.outside_for = 0
        self._inside_at: int | None = None
        self._latest: deque[float] = deque(maxlen=NIS_WINDOW)

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Take in the observations of one update; each is chi-square with 2 degrees of freedom."""
        self.total += sum(values)
        self.dof += 2 * len(values)
        self._latest.extend(values)
        low, high = self.band()
        if self._inside_at is None or low <= self.ratio() <= high:
            self._inside_at = stamp
        self.outside_for = stamp - self._inside_at

    def ratio(self) -> float:
        """Return the mean over the latest observations: above 1 if the filter is overconfident."""
        return sum(self._latest) / (2 * len(self._latest)) if self._latest else 1.0

    def band(self) -> tuple[float, float]:
        """Return where the ratio of a consistent filter lies."""
        dof = 2 * len(self._latest)
        low, high = chi_square_band(dof, NIS_PROBABILITY) if dof else (0.0, 0.0)
        return low / max(dof, 1), high / max(dof, 1)


def mean_nis(monitors: Iterable[NisMonitor]) -> float:
    """Return the mean over all observations of some robots, divided by 2."""
    told = [*monitors]
    return sum(monitor.total for monitor in told) / sum(monitor.dof for monitor in told)


@dataclass(slots=True)
class PoseScore:
    """
    Errors of one robot's poses against ground truth, added up.

    Attributes
    ----------
    steps : number of poses compared
    rated : how many of them had a covariance to be rated by (an exactly known start has none)
    latest_nees : NEES of the last of these, divided by 3; None where there was none

    """

    steps: int = 0
    rated: int = 0
    latest_nees: float | None = None
    _position: float = 0.0
    _heading: float = 0.0
    _nees: float = 0.0

    def add(self, error: Array, P: Array) -> None:
        """Take in a pose error (3,) and the covariance that was claimed for it."""
        self.steps += 1
        self._position += float(error[:2] @ error[:2])
        self._heading += float(error[2]) ** 2
        if is_definite(P):
            self.rated += 1
            self.latest_nees = float(nees(error, P))
            self._nees += self.latest_nees

    def position_rmse(self) -> float:
        """Return the root mean square position error [m] over the steps."""
        return float(np.sqrt(self._position / self.steps))

    def heading_rmse(self) -> float:
        """Return the root mean square heading error [rad] over the steps."""
        return float(np.sqrt(self._heading / self.steps))

    def mean_nees(self) -> float | None:
        """Return the mean NEES over the steps, divided by 3; None where no pose was uncertain."""
        return self._nees / self.rated if self.rated else None


def is_definite(P: Array) -> bool:
    """Return whether P is positive definite beyond rounding, whatever its units."""
    variances = P.diagonal()
    if variances.min() <= 0.0:
        return False
    sigma = np.sqrt(variances)
    correlation = P / (sigma[:, None] * sigma) - MIN_CORRELATION_EIGENVALUE * np.eye(len(P))
    return int(dpotrf(correlation, lower=1)[1]) == 0


class PoseEvaluation:
    """
    Scores poses in ``map`` against ground truth, as soon as the truth at their stamps is known.

    Parameters
    ----------
    truth : the ground truth, which is forgotten behind the newest estimate of each robot

    """

    def __init__(self, truth: RecordedTruth) -> None:
        self._truth = truth
        self._waiting: dict[str, deque[tuple[int, Array, Array]]] = {}
        self.scores: dict[str, PoseScore] = {}

    def add(self, robot: str, stamp: int, pose: Array, P: Array) -> None:
        """Take in an estimate."""
        waiting = self._waiting.setdefault(robot, deque(maxlen=WAITING))
        waiting.append((stamp, pose, P))
        newest = self._truth.newest(robot)
        while waiting and newest is not None and waiting[0][0] <= newest:
            self._score(robot, *waiting.popleft())

    def _score(self, robot: str, stamp: int, pose: Array, P: Array) -> None:
        if self._truth.covers(robot, stamp):
            score = self.scores.setdefault(robot, PoseScore())
            score.add(pose_error(pose, self._truth.pose(robot, stamp)), P)
            self._truth.forget_before(robot, stamp)
