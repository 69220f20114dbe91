# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The gate: acceptance test of each observation by its innovation."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_limit, squared_distances
from fej_slam_ros.core.ekf.curved_errors import ITERATIONS
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.state import Landmark, Robot
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.records import AnyObservation

#: Median of chi-square with 2 degrees of freedom, that of the squared distances of correct data.
MEDIAN_D2 = chi_square_limit(2, 0.5)

#: Minimum number of known landmarks by which a scan distinguishes a wrong pose from a moved
#: landmark, and of trusted ones that decide alone: a lost robot is right about those it starts.
MIN_KNOWN = 3
MIN_TRUSTED = 2

#: Probability with which correct observations count as contradicting, and the squared distance
#: beyond which one contradicts the map. The gate alone is not enough: where an overconfident robot
#: closes a loop, whole scans fail.
CONTRADICTION_PROBABILITY = 1e-9
CONTRADICTION_D2 = chi_square_limit(2, CONTRADICTION_PROBABILITY)
#: Number of observations that must contradict the map before a robot restarts. Small scans also
#: fail where an overconfident robot closes a loop.
MIN_CONTRADICTIONS = 9

#: Halvings after which an interval of floats is empty but for rounding.
HALVINGS = 60


class Association(NamedTuple):
    """An observation with its observer and the landmark or robot that it is of."""

    observer: Robot
    observed: Landmark | Robot
    observation: AnyObservation


class RobotAssociation(Association):
    """An observation of a robot by another."""

    __slots__ = ()
    observed: Robot


class GatedObservation(NamedTuple):
    """A rejected or inflated observation: its squared Mahalanobis distance and the limit."""

    association: Association
    d2: float
    threshold: float
    on_arcs: float = np.inf  #: the squared distance if errors lie on arcs

    def passed(self) -> bool:
        """Return whether it passed the gate itself, so that only its scan is suspected."""
        return self.d2 <= self.threshold

    def contradicts(self) -> bool:
        """Return whether the observation contradicts the estimate."""
        return self.d2 > max(self.threshold, CONTRADICTION_D2)

    def least_d2(self) -> float:
        """Return the squared distance by linear errors or by those on arcs, whichever is less."""
        return min(self.d2, self.on_arcs)


class GateResult(NamedTuple):
    """Result of the gate on the observations of an update."""

    accepted: Sequence[Association]  #: observations to be used, with the noise to be used
    #: observations that failed, and all those of and by suspected robots
    rejected: Sequence[GatedObservation] = ()
    #: observations among the accepted ones that passed with inflated noise only
    inflated: Sequence[GatedObservation] = ()
    iterations: int = 1  #: least number of Gauss-Newton iterations of the update

    def is_linear(self) -> bool:
        """Return whether all observations passed as they are, by linear errors."""
        return not self.rejected and not self.inflated and self.iterations == 1


@dataclass(slots=True)
class ScanGateStatistics:
    """Number of known landmarks in a scan, and of those that contradict the estimate."""

    known: int = 0
    failed: int = 0
    trusted: int = 0  #: trusted landmarks among the known ones
    trusted_failed: int = 0  #: and among those that failed
    gated: int = 0  #: landmarks that failed the gate, whether they contradict the estimate or not
    trusted_gated: int = 0  #: trusted landmarks among these

    def add(self, robot: str, landmark: Landmark, failed: bool, gated: bool) -> None:
        """Add whether an observation of a landmark failed, if that concerns the robot's pose."""
        # A landmark that another robot has just started may be wrong itself.
        if not landmark.is_trusted and landmark.owner != robot:
            return
        self.known += 1
        self.failed += failed
        self.gated += gated
        if landmark.is_trusted:
            self.trusted += 1
            self.trusted_failed += failed
            self.trusted_gated += gated

    def is_conclusive(self) -> bool:
        """Return whether the scan distinguishes a wrong pose from a moved landmark."""
        return self.known >= MIN_KNOWN

    def can_clear(self) -> bool:
        """Return whether the scan can show that a suspected robot is where it is estimated."""
        return self.is_conclusive() or self.trusted >= MIN_TRUSTED

    def mostly_failed(self) -> bool:
        """Return whether the robot's pose, not a landmark, is suspected."""
        return self.is_conclusive() and self._are_most(self.failed, self.trusted_failed)

    def mostly_gated(self) -> bool:
        """Return whether most of it fails the gate, perhaps by an overconfident pose only."""
        return self.can_clear() and self._are_most(self.gated, self.trusted_gated)

    def confirms_pose(self) -> bool:
        """Return whether trusted landmarks confirm the robot's pose."""
        return self.trusted >= MIN_TRUSTED and 2 * self.trusted_gated < self.trusted

    def _are_most(self, count: int, trusted: int) -> bool:
        """Return whether a number of landmarks are most: of the trusted ones, if these decide."""
        if self.trusted >= MIN_TRUSTED:
            return 2 * trusted > self.trusted
        return 2 * count > self.known


#: The gate's results on the scans of an update, by robot.
StatisticsByRobot = Mapping[str, ScanGateStatistics]


def scan_gate_statistics(
    results: Iterable[tuple[Association, bool, bool]]
) -> StatisticsByRobot:
    """
    Return the statistics of each robot's scan.

    The results are observations, whether they contradict the estimate, and whether they failed
    the gate. A landmark that several sensors observe counts once, by most of its observations.

    """
    statistics: dict[str, ScanGateStatistics] = {}
    # Numbers of observations, of those that contradict the estimate, and that failed the gate.
    tallies: dict[tuple[str, Landmark], tuple[int, int, int]] = {}
    for a, failed, gated in results:
        robot, observed = a.observer.name, a.observed
        if robot not in statistics:
            statistics[robot] = ScanGateStatistics()
        if isinstance(observed, Landmark):
            n, n_failed, n_gated = tallies.get((robot, observed), (0, 0, 0))
            tallies[robot, observed] = n + 1, n_failed + failed, n_gated + gated
    for (robot, landmark), (n, n_failed, n_gated) in tallies.items():
        statistics[robot].add(robot, landmark, 2 * n_failed > n, 2 * n_gated > n)
    return statistics


class Gate:
    """
    A chi-square gate on each observation by itself.

    If most of a robot's scan fails, its pose is suspected: then none of its observations is used,
    nor any of the robot by others.

    Parameters
    ----------
    probability : a correct observation passes with this probability; with 1.0 all pass

    """

    def __init__(self, probability: float) -> None:
        self.threshold = chi_square_limit(2, 1.0 - probability)

    def apply(
        self, observations: Sequence[Association], r: Array, S: Array,
        curved_distances: Callable[[], Array],
    ) -> GateResult:
        """
        Return the observations to use.

        Parameters
        ----------
        observations : m observations
        r : (m, 2) array, their innovations
        S : (m, 2, 2) array, the covariance of each
        curved_distances : function to their squared distances (m,) if errors lie on arcs, by which
            those that fail may pass, too

        """
        d2 = KERNEL.squared_distances(r, S)
        passed = d2 <= self.threshold
        if all(passed.tolist()):
            return GateResult(observations)
        on_arcs = curved_distances()
        are_curved = ~passed & (on_arcs <= self.threshold)
        passed, d2 = passed | are_curved, np.where(are_curved, on_arcs, d2)
        failed, gated = (
            (d2 > limit).tolist()
            for limit in (max(self.threshold, CONTRADICTION_D2), self.threshold))
        statistics = scan_gate_statistics(zip(observations, failed, gated))
        suspected = [name for name, scan in statistics.items() if self._is_suspected(scan)]
        observations, used = self._selected(observations, r, S, passed, suspected)
        results = [
            GatedObservation(a, *distances)
            for a, *distances in zip(
                observations, d2.tolist(), repeat(self.threshold), on_arcs.tolist())]
        return GateResult(
            [a for a, is_used in zip(observations, used) if is_used],
            [g for g, is_used in zip(results, used) if not is_used],
            [g for g, is_used, inside in zip(results, used, passed) if is_used and not inside],
            ITERATIONS if are_curved.any() else 1)

    def _selected(
        self, observations: Sequence[Association], r: Array, S: Array, passed: Flags,
        suspected: Sequence[str],
    ) -> tuple[Sequence[Association], Flags]:
        """Return the observations and which of them to use, given the suspected robots."""
        return observations, passed & ~_involve(suspected, observations)

    def _is_suspected(self, scan: ScanGateStatistics) -> bool:
        """Return whether a scan is not used as it is."""
        return scan.mostly_failed()


class InflatingGate(Gate):
    """
    A gate that inflates the noise of a scan of which most landmark observations fail it.

    The noise of the whole scan is scaled until the median of its squared distances is that of
    chi-square, and the gate is applied again. A lost robot so recovers by observations of little
    weight.

    """

    def _selected(
        self, observations: Sequence[Association], r: Array, S: Array, passed: Flags,
        suspected: Sequence[str],
    ) -> tuple[Sequence[Association], Flags]:
        """Return the observations, with inflated noise where needed, and which of them to use."""
        if not suspected:
            return observations, passed
        robots = np.array([
            a.observer.name if isinstance(a.observed, Landmark) else '' for a in observations])
        R = np.array([a.observation.R for a in observations])
        scale = np.ones((len(observations), 1, 1))
        for name in suspected:
            scan = robots == name
            scale[scan] = _noise_scale(r[scan], S[scan], R[scan])
        inflated = [
            a._replace(observation=replace(a.observation, R=noise))
            for a, noise in zip(observations, scale * R)]
        d2 = squared_distances(r, S + (scale - 1.0) * R)
        return inflated, passed | (d2 <= self.threshold)

    def _is_suspected(self, scan: ScanGateStatistics) -> bool:
        """Return whether a scan of three known landmarks or more mostly fails the gate."""
        return scan.is_conclusive() and scan.mostly_gated()


def _involve(robots: Container[str], observations: Sequence[Association]) -> Flags:
    """Return which observations are by or of some robots."""
    return np.array([
        a.observer.name in robots or (isinstance(a.observed, Robot) and a.observed.name in robots)
        for a in observations], bool)


def _noise_scale(r: Array, blocks: Array, R: Array) -> float:
    """Return the factor on R, which is part of the blocks, that gives the median of chi-square."""
    # With the noise alone, without the prior, the distances are larger: an upper bound.
    low, high = 1.0, max(1.0, float(np.median(squared_distances(r, R))) / MEDIAN_D2)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if np.median(squared_distances(r, blocks + (middle - 1.0) * R)) > MEDIAN_D2:
            low = middle
        else:
            high = middle
    return high
