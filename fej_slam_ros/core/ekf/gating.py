# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which observations are believed."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from fej_slam_ros.core.chi_square import own_blocks, squared_distances
from fej_slam_ros.core.ekf.state import Landmark, Robot
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.records import Observation, RobotObservation

#: Half of all right observations have a smaller squared distance.
MEDIAN = float(chdtri(2, 0.5))

#: A scan of fewer known landmarks does not tell whether the robot or a landmark is wrong.
MIN_KNOWN = 3

#: After so many halvings an interval of floats is empty but for rounding.
HALVINGS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """An observation with the robot that made it and the landmark or robot that it is of."""

    robot: Robot
    seen: Landmark | Robot
    observation: Observation | RobotObservation


@dataclass(frozen=True, slots=True, eq=False)
class GatedObservation:
    """An observation beyond the gate: its squared Mahalanobis distance and the limit."""

    association: Association
    d2: float
    threshold: float


@dataclass(frozen=True, slots=True, eq=False)
class GateResult:
    """
    What a gate makes of some observations.

    Attributes
    ----------
    believed : those to be used, with the noise to be used
    gated : those that are refused
    relaxed : those beyond the gate that are believed all the same, with more noise

    """

    accepted: Sequence[Association]
    gated: Sequence[GatedObservation]
    inflated: Sequence[GatedObservation]


@dataclass(slots=True)
class ScanGateStatistics:
    """How many known landmarks a scan shows, and how many of these are beyond the gate."""

    known: int = 0
    failed: int = 0

    def tells(self) -> bool:
        """Return whether the scan tells if the robot is wrong, or what it sees."""
        return self.known >= MIN_KNOWN

    def mostly_failed(self) -> bool:
        """Return whether rather the robot is wrong."""
        return self.tells() and 2 * self.failed > self.known


def scan_gate_statistics(
    accepted: Iterable[Association], gated: Iterable[GatedObservation], inflated: Iterable[GatedObservation]
) -> dict[str, ScanGateStatistics]:
    """Return how the scan of landmarks of each robot was found."""
    found: defaultdict[str, ScanGateStatistics] = defaultdict(ScanGateStatistics)
    for association in [*accepted, *(g.association for g in gated)]:
        found[association.robot.name].known += isinstance(association.seen, Landmark)
    for association in (g.association for g in [*gated, *inflated]):
        found[association.robot.name].failed += isinstance(association.seen, Landmark)
    return dict(found)


class Gate:
    """
    A chi-square gate on each observation by itself.

    Parameters
    ----------
    probability : a right observation passes with this probability; 1.0 lets everything pass

    """

    def __init__(self, probability: float) -> None:
        self.threshold = float(chdtri(2, 1.0 - probability))

    def test(self, r: Array, S: Array) -> tuple[Flags, Array]:
        """
        Return which of m observations pass, and their squared Mahalanobis distances (m,).

        Parameters
        ----------
        r : (m, 2) array, innovations
        S : (2 m, 2 m) array, their joint covariance

        """
        d2 = squared_distances(r, own_blocks(S))
        return d2 <= self.threshold, d2

    def apply(self, seen: Sequence[Association], r: Array, S: Array) -> GateResult:
        """Return which observations to use, given their innovations as in `test`."""
        passed, d2 = self.test(r, S)
        if passed.all():
            return GateResult(seen, (), ())
        seen, used = self._look_again(seen, r, S, passed)
        found = [GatedObservation(a, float(far), self.threshold) for a, far in zip(seen, d2)]
        return GateResult(
            [a for a, taken in zip(seen, used) if taken],
            [g for g, taken in zip(found, used) if not taken],
            [g for g, taken, inside in zip(found, used, passed) if taken and not inside])

    def _look_again(
        self, seen: Sequence[Association], r: Array, S: Array, passed: Flags
    ) -> tuple[Sequence[Association], Flags]:
        """Return the observations and which of them to use: those that have passed."""
        return seen, passed


class InflatingGate(Gate):
    """
    A gate that looks again at a scan of landmarks of which it would refuse most.

    The noise of all its observations is scaled until the median of their squared distances is that of
    chi-square. So a robot that is lost finds back slowly, by observations that weigh little.

    """

    def _look_again(
        self, seen: Sequence[Association], r: Array, S: Array, passed: Flags
    ) -> tuple[Sequence[Association], Flags]:
        """Return the observations with the noise to use, and which of them to use."""
        robots = np.array([a.robot.name if isinstance(a.seen, Landmark) else '' for a in seen])
        R = np.array([a.observation.R for a in seen])
        blocks, scale = own_blocks(S), np.ones((len(seen), 1, 1))
        for name in np.setdiff1d(robots, ['']):
            scan = robots == name
            if ScanGateStatistics(int(scan.sum()), int((scan & ~passed).sum())).mostly_failed():
                scale[scan] = _noise_scale(r[scan], blocks[scan], R[scan])
        if (scale == 1.0).all():
            return seen, passed
        noisier = [
            replace(a, observation=replace(a.observation, R=noise)) for a, noise in zip(seen, scale * R)]
        d2 = squared_distances(r, blocks + (scale - 1.0) * R)
        return noisier, passed | (d2 <= self.threshold)


def _noise_scale(r: Array, blocks: Array, R: Array) -> float:
    """Return the scale of the noise R within the blocks that makes the median distance right."""
    # The noise alone makes the distances longer than noise and prior.
    low, high = 1.0, max(1.0, float(np.median(squared_distances(r, R))) / MEDIAN)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if np.median(squared_distances(r, blocks + (middle - 1.0) * R)) > MEDIAN:
            low = middle
        else:
            high = middle
    return high
