# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which sightings are believed."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fej_slam_ros.core.geometry import Array


class Gate:
    """
    A chi-square gate on each sighting by itself.

    Parameters
    ----------
    probability : a right sighting passes with this probability; 1.0 lets everything pass

    """

    def __init__(self, probability: float) -> None:
        self.threshold = float(chdtri(2, 1.0 - probability))

    def test(self, r: Array, S: Array) -> tuple[NDArray[np.bool_], Array]:
        """
        Return which of m sightings pass, and their squared Mahalanobis distances (m,).

        Parameters
        ----------
        r : (m, 2) array, innovations
        S : (2 m, 2 m) array, their joint covariance

        """
        m = len(r)
        blocks = S.reshape(m, 2, m, 2)[np.arange(m), :, np.arange(m)]
        d2: Array = np.einsum('mi,mi->m', r, np.linalg.solve(blocks, r[..., None])[..., 0])
        return d2 <= self.threshold, d2
