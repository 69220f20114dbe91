# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise scale factors of observations from sums of innovations over some seconds.

Errors of cameras and detectors persist for longer than a scan: the innovations of one landmark by
one robot then have the same sign, and their sum is larger than that of independent ones. If the
noise is right, innovations r of different scans are independent, so that the sum e of those of a
window has the covariance V, the sum of S = H P H^T + R. With V_k, the part of V that is the noise
R of the observations of kind k,

    q_k = sum over windows of e^T V^-1 V_k V^-1 e / sum over windows of tr(V^-1 V_k)

is 1 for the right noise. In V, the observations of a window share errors of poses, which V^-1 sets
apart from R.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.calibration.from_innovations import (
    comparable, counts, LAST_STEP, run, with_scales)
from fej_slam_ros.core.calibration.from_truth import ERROR_WINDOW
from fej_slam_ros.core.calibration.robot_scales import NoiseScale
from fej_slam_ros.core.calibration.scales_of_errors import OUTLIER_PROBABILITY
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, StatisticsByRobot
from fej_slam_ros.core.ekf.state import Robot
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.innovation_monitor import InnovationMonitor
from fej_slam_ros.core.parameter_kinds import MAX_NOISE_SCALE
from fej_slam_ros.core.records import PointKey, PriorMap, Received
from fej_slam_ros.core.settings import Settings

#: Exponent of q_k by which the factor of kind k changes: since the filter follows the observations
#: less if their noise is larger, 1/2 would be too small a step.
EXPONENT = 0.75
#: Largest change of the logarithm of a factor in the last step, and number of steps after which
#: the factors count as not determined.
MAX_CHANGE, MAX_STEPS = 0.01, 12
#: Largest logarithm of a factor, so that a step beside it is still within the parameter's range.
#: Observations without any noise, as of some simulators, determine none.
MAX_LOG_FACTOR = math.log(MAX_NOISE_SCALE) - LAST_STEP


class Moments(NamedTuple):
    """The sums of which q is the ratio, by window and kind of noise."""

    numerators: Array  #: (windows, kinds) array
    denominators: Array  #: (windows, kinds) array

    def is_complete(self) -> bool:
        """Return whether there are observations of all kinds, with errors."""
        return bool((self.numerators.sum(axis=0) > 0.0).all())

    def log_q(self) -> Array:
        """Return log q (kinds,)."""
        log_q: Array = np.log(self.numerators.sum(axis=0) / self.denominators.sum(axis=0))
        return log_q

    def standard_errors(self, beside: Sequence['Moments']) -> Array:
        """Return those (kinds,) of log factors, given the moments with each larger by a step."""
        # Windows are independent: their scatter is that of log q, whose slope leads to factors.
        e = (self.numerators - self.denominators) / self.denominators.sum(axis=0)
        slope = np.array([(moved.log_q() - self.log_q()) / LAST_STEP for moved in beside]).T
        to_factors = np.linalg.pinv(slope)
        return np.sqrt(np.diag(to_factors @ e.T @ e @ to_factors.T))


#: Observer and observed landmark or robot.
Pair = tuple[str, PointKey | str]


@dataclass(eq=False)
class _Window:
    """Innovations of the updates in a window."""

    pairs: dict[Pair, int] = field(default_factory=dict)  #: place of each pair in the sums
    #: of each the elements (m, 2) of the sums, its innovation, and the lower triangle of S
    updates: list[tuple[Indices, Innovation, Array]] = field(default_factory=list)

    def add(self, innovation: Innovation, S: Array) -> None:
        places = [
            self.pairs.setdefault(_pair(association), len(self.pairs))
            for association in innovation.used]
        states = 2 * np.array(places)[:, None] + np.arange(2)
        self.updates.append((states, innovation, np.tril(S)))

    def moments(self, kinds: Sequence[str]) -> tuple[list[float], list[float]]:
        """Return the numerator and the denominator of q by kind."""
        d = 2 * len(self.pairs)
        e, V, R = np.zeros(d), np.zeros((d, d)), {kind: np.zeros((d, d)) for kind in kinds}
        for states, innovation, S in self.updates:
            of_update = states.ravel()
            # Two sensors may observe a landmark at one stamp: then states occur twice.
            np.add.at(e, of_update, innovation.r)
            np.add.at(V, np.ix_(of_update, of_update), S + np.tril(S, -1).T)
            for own, association in zip(states, innovation.used):
                kind = 'robot' if isinstance(association.observed, Robot) else 'landmark'
                if kind in R:
                    R[kind][np.ix_(own, own)] += association.observation.R
        V_inverse = np.linalg.inv(V)
        white = V_inverse @ e
        return (
            [float(white @ R[kind] @ white) for kind in kinds],
            [float((V_inverse * R[kind]).sum()) for kind in kinds])


def _pair(association: Association) -> Pair:
    observed = association.observed
    return association.observer.name, (
        observed.name if isinstance(observed, Robot) else observed.key)


@dataclass(eq=False)
class InnovationWindows(InnovationMonitor):
    """Statistics of innovations, also of their sums over windows."""

    windows: defaultdict[int, _Window] = field(default_factory=lambda: defaultdict(_Window))

    def add(self, stamp: int, innovation: Innovation, statistics: StatisticsByRobot) -> None:
        """Add the innovation of one update, if it was not in blocks."""
        super().add(stamp, innovation, statistics)
        if innovation.S is not None:
            self.windows[stamp // ERROR_WINDOW].add(innovation, innovation.S)

    def moments(self, kinds: Sequence[str]) -> Moments:
        """Return the numerators and denominators of q."""
        of_windows = [window.moments(kinds) for window in self.windows.values()]
        return Moments(*np.array(of_windows).reshape(-1, 2, len(kinds)).swapaxes(0, 1))


def scales_over_windows(
    settings: Settings, records: Sequence[Received], start: Mapping[str, float],
    prior: PriorMap | None = None, on_run: Callable[[], object] = lambda: None,
) -> dict[str, NoiseScale]:
    """
    Return the noise scale factors of observations by which their sums over windows are right.

    `start` has first guesses of the factors by kind, `landmark` and `robot`; the other parameters
    are those of `most_likely_scales`.

    """
    kinds = [*start]
    gated = replace(comparable(settings), gate_probability=1.0 - OUTLIER_PROBABILITY)

    def moments(theta: Array) -> Moments:
        windows = InnovationWindows()
        scales = dict(zip(kinds, np.exp(theta).tolist()))
        run(with_scales(gated, scales), records, prior, windows)
        on_run()
        return windows.moments(kinds)

    theta, errors = np.log([*start.values()]), np.full(len(kinds), math.inf)
    for _ in range(MAX_STEPS):
        found = moments(theta)
        if not found.is_complete():
            break
        step = EXPONENT * found.log_q()
        if np.abs(step).max() < MAX_CHANGE:
            errors = found.standard_errors([
                moments(theta + LAST_STEP * e) for e in np.eye(len(kinds))])
            break
        theta += step
        if np.abs(theta).max() > MAX_LOG_FACTOR:
            break
    samples = counts(records)
    return {
        kind: NoiseScale(scale, error, samples[kind])
        for kind, scale, error in zip(kinds, np.exp(theta).tolist(), errors.tolist())}
