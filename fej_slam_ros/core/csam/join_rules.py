# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions for joining the maps of a team."""

from dataclasses import dataclass

from fej_slam_ros.core.chi_square import chi_square_quantile
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.point_consensus import OUTLIER_D2


@dataclass(frozen=True, slots=True)
class JoinRules:
    """Conditions for joining two maps."""

    min_shared: int = 3  #: smallest number of shared landmark keys that joins maps
    #: chi-square probability with which correct data is accepted; 1.0 accepts all
    probability: float = 1.0 - 1e-4
    #: variance of the residuals between maps, relative to that of the stated noise
    variance_factor: float = 1.0

    def limit(self, dof: int) -> float:
        """Return the largest chi-square of data that is accepted."""
        return self.variance_factor * chi_square_quantile(dof, self.probability)

    def landmark_limit(self) -> float:
        """Return the largest squared distance of a shared landmark from where others put it."""
        return self.variance_factor * OUTLIER_D2

    def inconsistency(self, chi_square: float, dof: int) -> JoinFailure | None:
        """Return a failure if chi-square exceeds its limit."""
        limit = self.limit(dof)
        if chi_square <= limit:
            return None
        return JoinFailure(
            f'inconsistent (chi-square {chi_square:.1f} with {dof} degrees of freedom, at most'
            f' {limit:.1f})')


#: Rules that accept correct data with probability 1 - 1e-4.
DEFAULT_RULES = JoinRules()
