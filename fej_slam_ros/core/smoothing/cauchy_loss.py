# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robust cost, by which outliers can be found."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array


@dataclass(frozen=True, slots=True)
class CauchyLoss:
    """
    The cost c^2 log(1 + d^2 / c^2) of an observation, so that outliers hardly count.

    Its square root has the same steps as d weighted by 1 / (1 + d^2 / c^2), so that the cost
    decreases with iteratively reweighted least squares.

    """

    c2: float  #: squared Mahalanobis distance d^2 from which an observation counts half or less

    def cost(self, d2: Array) -> float:
        """Return the cost of observations with squared Mahalanobis distances d2 (k,)."""
        return self.c2 * float(np.log1p(d2 / self.c2).sum())

    def weights(self, d2: Array) -> Array:
        """Return the weights of their squares, (k,)."""
        return 1.0 / (1.0 + d2 / self.c2)
